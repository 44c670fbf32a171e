"""What an explanation says, held against missions planned with the change made by hand."""

from __future__ import annotations

import time
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from random_missions import part_way, tiny_mission

from malipp_field.errors import PlanError
from malipp_field.mission import Mission, initial_state, read_mission
from malipp_field.plan import Plan
from malipp_field.planner import explain as explain_module
from malipp_field.planner import solve
from malipp_field.planner.bounds import relaxation
from malipp_field.planner.bounds.relaxation import relaxed_values
from malipp_field.planner.bounds.relaxation_rows import Polytope
from malipp_field.planner.explain import explain
from malipp_field.planner.explanation import Explanation, Kind, Resource
from malipp_field.planner.problem import Problem, build_problem
from malipp_field.planner.usage import drops_by_node, left_out, usage

MISSIONS = Path(__file__).parents[2] / "missions"
FEW = settings(max_examples=4, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))


def corridor() -> Mission:
    return read_mission(MISSIONS / "corridor.yaml")


def information(plan: Plan) -> float:
    assert plan.objective is not None
    return plan.objective.information


def changed(mission: Mission, robot_id: str, **changes: Any) -> Mission:
    robots = tuple(r.model_copy(update=changes) if r.id == robot_id else r for r in mission.team.robots)
    return mission.model_copy(update={"team": mission.team.model_copy(update={"robots": robots})})


Case = tuple[Mission, Plan, Explanation]


@cache
def case(seed: int) -> Case:
    mission = tiny_mission(seed, candidates=3)
    plan = solve(mission, method="exact")
    assert plan.status == "optimal"
    assert plan.handoffs
    return mission, plan, explain(mission, plan, time_limit_s=60.0)


def small() -> Case:
    """Return two robots with one drop: r0 is short of room, r1 of energy and slots."""
    return case(137)


def resource(explanation: Explanation, robot: str, kind: Kind) -> Resource:
    (found,) = (r for r in explanation.resources if (r.use.robot, r.use.kind) == (robot, kind))
    return found


@pytest.mark.parametrize("robot", ["r0", "r1"])
@pytest.mark.parametrize(
    ("kind", "key"),
    [("energy", "energy_budget_j"), ("room", "payload_capacity"), ("slots", "samples_per_node")],
)
def test_more_is_worth_what_a_mission_with_more_of_it_gains(robot: str, kind: Kind, key: str) -> None:
    mission, plan, explanation = small()
    found = resource(explanation, robot, kind)
    assert found.trial is not None
    assert found.trial.proven
    more = getattr(mission.robot(robot), key) + (
        found.trial.step if kind == "energy" else int(found.trial.step)
    )
    richer = solve(changed(mission, robot, **{key: more}), method="exact")
    gained = information(plan) - information(richer)
    assert found.trial.fall == pytest.approx(gained, abs=2e-4 * information(plan))
    assert found.verdict == ("binds" if gained > 2e-4 * information(plan) else "slack")
    assert found.value == pytest.approx(found.trial.fall / found.trial.step)


def test_each_kind_of_scarcity_is_seen() -> None:
    _, _, explanation = small()
    scarce = {(r.use.robot, r.use.kind) for r in explanation.resources if r.verdict == "binds"}
    assert scarce == {("r0", "room"), ("r1", "energy"), ("r1", "slots")}


def test_each_place_is_worth_what_closing_it_costs() -> None:
    mission, plan, explanation = case(128)
    assert {drop.place.node for drop in explanation.places} == set(drops_by_node(plan))
    for drop in explanation.places:
        without = solve(mission, method="exact", closed={drop.place.node})
        assert drop.trial is not None
        assert drop.place.left_out is not None
        assert -drop.trial.fall == pytest.approx(information(without) - information(plan), abs=1e-3)
        assert 0.0 <= -drop.trial.fall <= drop.place.left_out + 1e-9
    alone = solve(mission, method="exact", handoffs=False)
    assert explanation.without_drops is not None
    assert -explanation.without_drops.fall == pytest.approx(information(alone) - information(plan), abs=1e-3)


def test_the_smallest_step_of_energy_that_helps_is_told() -> None:
    mission = tiny_mission(1, robots=1, candidates=3)
    plan = solve(mission, method="exact")
    budget = mission.robot("r0").energy_budget_j
    falls = {
        share: information(plan)
        - information(solve(changed(mission, "r0", energy_budget_j=(1 + share) * budget), method="exact"))
        for share in (0.01, 0.05, 0.1)
    }
    energy = resource(explain(mission, plan), "r0", "energy")
    helpful = [share for share, fall in falls.items() if fall > 2e-4 * information(plan)]
    assert energy.verdict == ("binds" if helpful else "slack")
    assert energy.trial is not None
    expected = helpful[0] if helpful else 0.1
    assert energy.trial.step == pytest.approx(expected * budget)
    assert energy.trial.fall == pytest.approx(falls[expected], abs=2e-4 * information(plan))


def with_energy_needed_for_the_next_sample(mission: Mission) -> Mission:
    """Return the mission of one robot with 0.5 % less than a plan with one sample more takes."""
    rich = solve(mission, method="exact")
    assert rich.objective is not None
    return changed(mission, "r0", energy_budget_j=0.995 * rich.objective.energy_j)


def test_one_per_cent_is_told_where_one_per_cent_is_enough() -> None:
    mission = with_energy_needed_for_the_next_sample(tiny_mission(1, robots=1, candidates=3))
    energy = resource(explain(mission, solve(mission, method="exact")), "r0", "energy")
    assert energy.verdict == "binds"
    assert energy.trial is not None
    assert energy.trial.step == pytest.approx(0.01 * energy.use.has)


def test_it_explains_the_rest_of_a_mission_from_its_state() -> None:
    mission = tiny_mission(3, candidates=3, energy_budget_j=60.0)
    state = part_way(mission, 3)
    plan = solve(mission, state=state, method="exact")
    assert plan.status == "optimal"
    explanation = explain(mission, plan, state=state, time_limit_s=20.0)
    assert len(explanation.resources) == 6
    assert all(r.verdict != "open" for r in explanation.resources)
    energy = resource(explanation, "r0", "energy")
    assert energy.use.has == state.robot("r0").energy_left_j


def test_what_cannot_be_asked_in_time_is_open_and_the_relaxation_speaks() -> None:
    mission = read_mission(MISSIONS / "quarry.yaml")
    plan = solve(mission, method="exact", time_limit_s=1.0)
    assert plan.status == "feasible"
    before = time.monotonic()
    # fifteen questions about three robots, and some about drops: too many for this, however many the drops
    explanation = explain(mission, plan, time_limit_s=2.0)
    assert time.monotonic() - before < 5.0
    assert {r.verdict for r in explanation.resources} == {"open"}
    assert all(r.trial is None for r in explanation.resources)
    assert explanation.relaxed is not None
    assert set(explanation.relaxed) == {robot.id for robot in mission.team.robots}
    assert not explanation.proven


def test_a_better_plan_found_on_the_way_is_not_put_down_to_what_was_changed() -> None:
    mission, plan, certain = small()
    poor = solve(mission, method="exact", handoffs=False)
    modest = poor.model_copy(update={"status": "feasible", "method": "exact", "gap": 0.5})
    explanation = explain(mission, modest, time_limit_s=60.0)
    assert explanation.searched_j == pytest.approx(information(poor) - information(plan), abs=1e-3)
    assert explanation.searched_j > 0.1
    assert explanation.proven
    assert len(explanation.places) == 1
    for now, before in zip(explanation.resources, certain.resources, strict=True):
        assert now.trial is not None
        assert before.trial is not None
        assert now.trial.fall == pytest.approx(before.trial.fall, abs=1e-3)


def test_a_proven_j_is_enough_even_where_energy_is_open() -> None:
    mission, plan, _ = small()
    explanation = explain(
        mission, plan.model_copy(update={"status": "feasible"}), solve=lambda *_, **__: plan, time_limit_s=9.0
    )
    assert explanation.proven
    assert explanation.relaxed is None
    assert {r.verdict for r in explanation.resources} == {"slack"}


def test_cancelled_it_asks_nothing_more() -> None:
    mission, plan, _ = small()
    heard: list[str] = []
    explanation = explain(
        mission, plan, on_progress=heard.append, cancelled=lambda: len(heard) > 1, time_limit_s=60.0
    )
    assert explanation.asked == 2
    assert [r.trial for r in explanation.resources] == [None] * 6
    assert "no drops at all (1 of at most" in heard[0]


def test_every_question_has_its_share_and_the_options_given() -> None:
    mission, plan, _ = small()
    asked: list[dict[str, Any]] = []

    def unhelpful(_: Mission, **options: Any) -> Plan:
        asked.append(options)
        return plan

    explanation = explain(mission, plan, time_limit_s=30.0, solve=partial(unhelpful, seed=7))
    assert {options["seed"] for options in asked} == {7}
    assert len(asked) == explanation.asked
    assert asked[0]["time_limit_s"] == pytest.approx(30.0 / 12, rel=0.1)
    assert {r.verdict for r in explanation.resources} == {"slack"}


def test_a_plan_without_routes_is_refused() -> None:
    mission, plan, _ = small()
    with pytest.raises(PlanError, match="no routes to explain"):
        explain(mission, plan.model_copy(update={"robots": (), "objective": None}))


@pytest.mark.parametrize(
    ("method", "options"),
    [
        ("no-handoffs", {"method": "exact", "handoffs": False}),
        ("seq", {"method": "seq"}),
        ("arcs", {"method": "arcs"}),
        ("lns", {"method": "lns"}),
        ("miqp", {"method": "exact"}),
        ("exact", {"method": "exact"}),
    ],
)
def test_a_plan_is_explained_by_the_method_that_made_it(method: str, options: dict[str, Any]) -> None:
    _, plan, _ = small()
    assert explain_module.settings(plan.model_copy(update={"method": method})) == options


def test_the_most_on_board_counts_what_is_taken_before_it_is_dropped() -> None:
    mission, plan, _ = small()
    energy, room, slots = usage(mission, plan, initial_state(mission), "r1")
    assert room.uses == 2
    assert energy.uses == plan.robot("r1").energy_j
    assert slots.uses == 1


def test_samples_left_out_take_their_drops_with_them() -> None:
    mission = corridor()
    plan, state = solve(mission), initial_state(mission)
    rest = left_out(mission, plan, state, ["hub"])
    assert rest is not None
    assert set(drops_by_node(rest)) == set(drops_by_node(plan)) - {"hub"}
    none = left_out(mission, plan, state, list(drops_by_node(plan)))
    assert none is not None
    assert none.handoffs == 0
    taken = sum(route.collected for route in plan.robots)
    dropped = sum(count for drops in drops_by_node(plan).values() for _, _, count in drops)
    assert sum(route.collected for route in none.robots) == taken - dropped


@FEW
@given(st.integers(100, 400).filter(lambda seed: seed % 5 != 4))
def test_a_closed_node_sees_no_drops_and_lies_between_all_and_none(seed: int) -> None:
    mission = tiny_mission(seed, candidates=3)
    free = solve(mission, method="arcs", mip_gap=1e-7)
    if free.objective is None or not free.handoffs:
        return
    node = next(iter(drops_by_node(free)))
    without = solve(mission, method="arcs", mip_gap=1e-7, closed={node}, warm_start=free)
    alone = solve(mission, method="arcs", mip_gap=1e-7, handoffs=False, warm_start=free)
    assert node not in drops_by_node(without)
    assert alone.handoffs == 0
    assert information(free) - 1e-6 <= information(without) <= information(alone) + 1e-6


def test_with_every_node_closed_it_is_the_ablation() -> None:
    mission = corridor()
    closed = [node.id for node in mission.site.nodes]
    everywhere, none = solve(mission, closed=closed), solve(mission, handoffs=False)
    assert everywhere.handoffs == 0
    assert information(everywhere) == pytest.approx(information(none), rel=2e-4)


def test_closed_nodes_are_left_out_of_what_robots_share() -> None:
    mission = corridor()
    problem = build_problem(mission)
    hub = problem.nodes.index("hub")
    assert hub in problem.shared(0, 1)
    assert hub not in build_problem(mission, closed=["hub"]).shared(0, 1)
    assert build_problem(mission, handoffs=False).shared(0, 1) == []


@pytest.mark.parametrize("seed", [1, 2])
def test_the_values_of_the_relaxation_are_its_slopes(seed: int) -> None:
    mission = tiny_mission(seed, candidates=4, energy_budget_j=14.0, payload_capacity=2)
    problem, values = build_problem(mission), relaxed_values(mission)
    assert values is not None
    for r, robot in enumerate(problem.robots):
        step = 1e-3 * robot.budget_j
        rich = replace(robot, budget_j=robot.budget_j + step)
        richer = replace(problem, robots=(*problem.robots[:r], rich, *problem.robots[r + 1 :]))
        slope = (relaxed_j(problem) - relaxed_j(richer)) / step
        assert values[robot.id].per_joule == pytest.approx(slope, rel=0.05, abs=1e-6)
        assert values[robot.id].per_sample >= 0.0
    assert max(value.per_joule for value in values.values()) > 1e-3


def relaxed_j(problem: Problem) -> float:
    most = relaxation._most_precision(problem)
    answer = relaxation._solve(Polytope(problem), most, 60.0)
    assert answer is not None
    return problem.information.value(answer.precision)
