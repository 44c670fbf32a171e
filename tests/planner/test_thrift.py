"""The last stages over whole schedules: what the arc model finds, and never another J."""

from __future__ import annotations

import numpy as np
import pytest
from circle_cases import circle
from random_missions import part_way, tiny_mission
from schedule_cases import every_schedule, free_gain, master_gain, random_actor, value_of
from team_cases import alike, listed, scaled, search, some_teams
from test_labels import priced

from malipp_field.mission import Mission, TeamState
from malipp_field.planner import verify
from malipp_field.planner.exact import economy, thrift
from malipp_field.planner.exact.choices import Choice
from malipp_field.planner.exact.chosen import cheapest_order
from malipp_field.planner.exact.economy import Economy
from malipp_field.planner.exact.labels import Actor, complete_schedules, completion, enumerate_labels
from malipp_field.planner.exact.stages import arc_stages
from malipp_field.planner.exact.thrift import last_stages
from malipp_field.planner.extract import TeamPlan, Verdict, plan_file, team_plan
from malipp_field.planner.problem import Problem, build_problem
from malipp_field.planner.progress import Search

_ROOM = 100_000
_VERDICT = Verdict(
    method="exact", status="feasible", bound=None, gap=None, solve_time_s=0.0, seed=0, version=1
)


def taxed(seed: int) -> Actor:
    return random_actor(seed, ties=seed % 3 == 0)._replace(toll=0.1 + 0.2 * (seed % 4))


# a toll on energy


@pytest.mark.parametrize("seed", range(24))
def test_a_threshold_after_toll_keeps_all_schedules_worth_it(seed: int) -> None:
    actor = taxed(seed)
    gain = free_gain(np.random.default_rng(seed), actor)
    every = every_schedule(actor)
    worth = {vector: value_of(actor, gain, vector) - actor.toll * energy for vector, energy in every.items()}
    least = max(worth.values()) - 0.6
    count, codes, mask, place, load, energy, _ = enumerate_labels(actor, gain, least, _ROOM)
    label, spent = complete_schedules(actor, count, codes, mask, place, load, energy)
    found = {tuple(codes[k].tolist()): float(e) for k, e in zip(label, spent, strict=True)}
    worthy = {vector: every[vector] for vector in every if worth[vector] >= least + 1e-9}
    assert worthy.keys() <= found.keys()
    assert {vector: found[vector] for vector in worthy} == pytest.approx(worthy, abs=1e-9)
    assert len(found) < len(every) or len(every) < 20


@pytest.mark.parametrize("seed", range(24))
def test_pricing_after_toll_finds_the_best(seed: int) -> None:
    actor = taxed(seed)
    gain = master_gain(np.random.default_rng(seed), actor)
    every = every_schedule(actor)
    best = max(value_of(actor, gain, vector) - actor.toll * energy for vector, energy in every.items())
    rest, found = priced(actor, gain)
    assert rest == -100.0
    assert max(found.values(), default=-100.0) == pytest.approx(best, abs=1e-8)
    for vector, value in found.items():
        assert value <= value_of(actor, gain, vector) - actor.toll * every[vector] + 1e-9


@pytest.mark.parametrize("seed", range(12))
def test_completion_counts_the_toll_and_stays_above_the_truth(seed: int) -> None:
    actor = taxed(seed)
    gain = free_gain(np.random.default_rng(seed), actor)
    free, *_ = completion(actor._replace(toll=0.0), gain)
    bound, *_ = completion(actor, gain)
    assert (bound <= free).all()
    every = every_schedule(actor)
    best = max(value_of(actor, gain, vector) - actor.toll * energy for vector, energy in every.items())
    first = max(
        gain[0, code + actor.capacity] for code in {vector[0] for vector in every}
    )  # the most the start may add
    assert bound[0].max() + first >= best - 1e-9


# the last two stages


def some_plans(mission: Mission, state: TeamState | None, many: int) -> tuple[Problem, list[TeamPlan]]:
    """Return plans whose samples are anybody's, made without thought of energy."""
    problem, _ = scaled(mission, state)
    teams = some_teams(problem, listed(problem), 60, seed=7)
    plans = [team for _, team in teams if team is not None]
    wanted = sorted(plans, key=lambda plan: -len({v.node for route in plan.routes for v in route if v.drop}))
    return problem, wanted[:many]


def check(mission: Mission, state: TeamState | None, problem: Problem, start: TeamPlan) -> None:
    """Compare both ways to the last stages from a plan, and ask the verifier."""
    found, proven = last_stages(problem, search(), start)
    expected, expected_proven = arc_stages(problem, search(), start)
    assert proven
    assert expected_proven
    assert found.precision == pytest.approx(start.precision, rel=1e-9)
    assert found.energy_j == pytest.approx(expected.energy_j, rel=1e-6, abs=1e-6)
    assert found.makespan_s == pytest.approx(expected.makespan_s, rel=1e-6, abs=1e-6)
    in_joules = build_problem(mission, state)
    exact = team_plan(in_joules, found.routes)
    assert exact is not None
    assert not verify(mission, plan_file(mission.name, in_joules, exact, _VERDICT), state)


@pytest.mark.parametrize("seed", range(400, 412))
def test_it_agrees_with_the_arc_model(seed: int) -> None:
    mission = tiny_mission(seed, robots=2 + seed % 2, candidates=4 - seed % 2)
    state = part_way(mission, seed) if seed % 4 == 3 else None
    problem, plans = some_plans(mission, state, 2)
    for plan in plans:
        check(mission, state, problem, plan)


@pytest.mark.parametrize("seed", range(5))
def test_robots_that_are_alike_are_chosen_for_together(seed: int) -> None:
    mission = alike(seed, robots=3, candidates=3, samples_per_node=1 + seed % 2)
    problem, plans = some_plans(mission, None, 1)
    for plan in plans:
        assert len(Economy(problem, plan).kinds) == 1
        check(mission, None, problem, plan)


def test_robots_of_different_speed_are_not_alike() -> None:
    mission = alike(3, robots=2, candidates=3)
    one, other = mission.team.robots
    faster = other.model_copy(update={"speed_m_s": 3.0})
    mission = mission.model_copy(update={"team": mission.team.model_copy(update={"robots": (one, faster)})})
    problem, plans = some_plans(mission, None, 2)
    for plan in plans:
        assert len(Economy(problem, plan).kinds) == 2
        check(mission, None, problem, plan)


def test_choices_that_wait_in_a_circle_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    refused = []

    def asked(economy: Economy, search: Search, choice: Choice) -> tuple[TeamPlan | None, bool]:
        refused.append(choice)
        return cheapest_order(economy, search, choice)

    monkeypatch.setattr(thrift, "cheapest_order", asked)
    mission = circle(budget_j=30.0)  # the cheapest schedules with both samples hand over in a circle
    problem, plans = some_plans(mission, None, 60)
    both = [plan for plan in plans if (plan.precision > 0.0).sum() == 2]
    check(mission, None, problem, max(both, key=lambda plan: plan.energy_j))
    assert refused


def test_a_plan_that_is_the_best_stays() -> None:
    problem, plans = some_plans(tiny_mission(404, candidates=4), None, 1)
    found, _ = last_stages(problem, search(), plans[0])
    assert last_stages(problem, search(), found) == (found, True)


@pytest.mark.parametrize(
    ("room", "limit"), [(economy, "_LIST_ROOM"), (economy, "_MOST_LISTED"), (thrift, "_MOST_CHOICES")]
)
def test_with_too_many_schedules_or_choices_the_arc_model_takes_over(
    monkeypatch: pytest.MonkeyPatch, room: object, limit: str
) -> None:
    mission = tiny_mission(406, candidates=4)
    problem, plans = some_plans(mission, None, 1)
    monkeypatch.setattr(room, limit, 1 if room is economy else 0)
    check(mission, None, problem, plans[0])


def test_the_soonest_of_plans_that_may_not_be_the_cheapest_is_not_proven(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    problem, plans = some_plans(tiny_mission(404, candidates=4), None, 1)
    found, proven = last_stages(problem, search(), plans[0], arcs=False)
    assert proven
    monkeypatch.setattr(thrift, "_cheapest", lambda economy, effort, plan: (plan, False))
    assert last_stages(problem, search(), found, arcs=False) == (found, False)


def test_without_time_the_plan_stays_unproven() -> None:
    problem, plans = some_plans(tiny_mission(404, candidates=4), None, 1)
    found, proven = last_stages(problem, search(limit_s=0.0), plans[0])
    assert not proven
    assert found.rank <= plans[0].rank


def test_a_team_that_need_not_move_spends_nothing() -> None:
    problem, plans = some_plans(tiny_mission(401, energy_budget_j=0.0, start="d0", depots=["d0"]), None, 1)
    found, proven = last_stages(problem, search(), plans[0])
    assert proven
    assert found.energy_j == 0.0
