"""Seq-LIPP of teams too large to be listed, or in too little time: what is cut, and that a plan remains."""

from __future__ import annotations

from typing import Any

import pytest
from random_missions import part_way, tiny_mission
from team_cases import alike, search

from malipp_field.bench.instances import Specification, build
from malipp_field.mission import Mission
from malipp_field.planner import fast, solve, verify
from malipp_field.planner.bounds import quick as bounds
from malipp_field.planner.bounds import relaxation
from malipp_field.planner.bounds.quick import is_relaxable
from malipp_field.planner.bounds.relaxation import relaxed_values
from malipp_field.planner.exact.schedules import robots_of
from malipp_field.planner.paper import sequential
from malipp_field.planner.paper.sequential import solve_sequential
from malipp_field.planner.problem import Problem, build_problem
from malipp_field.planner.progress import Progress
from malipp_field.planner.search.focus import Focus
from malipp_field.planner.search.walks import Walks

SOME_SEARCHED = "sequential, some robots searched"


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch) -> dict[str, int]:
    """Count listings and plans from them."""
    counts = {"options_of": 0, "plan_alone": 0}

    def count(name: str) -> None:
        original = getattr(sequential, name)

        def counted(*arguments: Any) -> Any:
            counts[name] += 1
            return original(*arguments)

        monkeypatch.setattr(sequential, name, counted)

    count("options_of")
    count("plan_alone")
    return counts


def team() -> Problem:
    return build_problem(tiny_mission(4, robots=4, candidates=6), handoffs=False)


def no_cone(*_: object) -> float:
    raise AssertionError("a cone program for a team too large for it")


def test_when_time_is_up_nothing_is_listed_and_all_robots_still_have_plans(calls: dict[str, int]) -> None:
    heard: list[Progress] = []
    problem = team()
    found = solve_sequential(problem, search(limit_s=-1.0, on_progress=heard.append))
    assert found is not None
    assert calls["options_of"] == 0
    assert len(found.routes) == len(heard) == len(problem.robots)
    assert {progress.stage for progress in heard} == {SOME_SEARCHED}


def test_what_is_listed_is_bounded_for_the_whole_team(
    calls: dict[str, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    heard: list[Progress] = []
    problem = team()
    whole = solve_sequential(problem, search(on_progress=heard.append))
    assert calls["options_of"] > 1
    assert {progress.stage for progress in heard} == {"sequential"}
    calls["options_of"] = 0
    monkeypatch.setattr(sequential, "_MOST_CODES", 1)
    some = solve_sequential(problem, search(on_progress=heard.append))
    assert calls["options_of"] == 1
    assert heard[-1].stage == SOME_SEARCHED
    assert whole is not None
    assert some is not None
    assert some.information == pytest.approx(whole.information, rel=1e-6)


def test_robots_that_could_stand_in_for_each_other_are_listed_once(calls: dict[str, int]) -> None:
    problem = build_problem(alike(1, robots=3), handoffs=False)
    assert {robot.twins for robot in robots_of(problem)} == {(0, 1, 2)}
    assert solve_sequential(problem, search()) is not None
    assert calls["options_of"] == 1


def test_robots_with_other_shares_of_the_stock_are_listed_apart(calls: dict[str, int]) -> None:
    for seed in range(700, 704):
        mission = tiny_mission(seed, robots=3, candidates=5, energy_budget_j=40.0)
        problem = build_problem(mission, part_way(mission, seed), handoffs=False)
        shares = sequential.share_stock(problem, search())
        calls["options_of"] = 0
        if shares is None or solve_sequential(problem, search()) is None:
            continue
        views = {(r.start, r.depots, r.budget_j, r.capacity, r.precision) for r in problem.robots}
        assert calls["options_of"] >= max(len(views), len(set(shares)))


def test_on_large_sites_a_robot_looks_at_what_is_nearest(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(sequential, "_MOST_NODES", 3)
    mission = build(Specification(3, 12), 60.0)
    problem = build_problem(mission, handoffs=False)
    (robot, *_) = robots = sequential._robots(problem, [()] * 3, search().effort)
    assert all(len(one.positions) == 3 for one in robots)
    view = problem.robots[0]
    cost = view.closure.energy_per_kg
    way = [float(cost[view.start, v] + min(cost[v, d] for d in view.depots)) for v in problem.candidates]
    assert set(robot.positions.tolist()) == {way.index(one) for one in sorted(way)[:3]}
    monkeypatch.setattr(sequential, "_MOST_NODES", 1)
    planned = 0
    for seed in range(700, 704):
        mission = tiny_mission(seed, robots=3, candidates=5, energy_budget_j=40.0)
        state = part_way(mission, seed)
        plan = solve(mission, state=state, method="seq")
        planned += bool(plan.robots) and not verify(mission, plan, state)
    assert planned >= 2


def test_once_time_gets_short_only_who_promises_most_is_planned_anew(
    calls: dict[str, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    problem = build_problem(build(Specification(5, 12), 40.0), handoffs=False)
    eager = solve_sequential(problem, search())
    often, calls["plan_alone"] = calls["plan_alone"], 0
    monkeypatch.setattr(sequential, "_EAGER_SHARE", 0.0)
    lazy = solve_sequential(problem, search())
    assert len(problem.robots) <= calls["plan_alone"] < often
    assert eager is not None
    assert lazy is not None
    assert lazy.information == pytest.approx(eager.information, rel=0.02)


def test_large_teams_get_the_quick_bound_and_no_cone_program(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(relaxation, "relaxation_bound", no_cone)
    monkeypatch.setattr(relaxation, "Polytope", no_cone)
    mission = build(Specification(6, 60), 100.0)
    assert not is_relaxable(build_problem(mission))
    assert relaxed_values(mission) is None
    plan = solve(mission, method="seq", time_limit_s=3.0)
    assert not verify(mission, plan)
    assert plan.objective is not None
    assert plan.bound.information is not None
    assert 0.0 <= plan.bound.information < plan.objective.information


def test_few_robots_with_very_many_places_are_searched_in_groups() -> None:
    wide, narrow = build(Specification(10, 100), 280.0), build(Specification(12, 45), 60.0)
    assert isinstance(fast._searcher(build_problem(wide), search()), Focus)
    assert isinstance(fast._searcher(build_problem(narrow), search()), Walks)


def test_the_quick_bound_of_seq_holds_for_plans_with_handoffs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bounds, "_MOST_PAIRS", 0)
    tight = 0
    for seed in range(300, 304):
        mission: Mission = tiny_mission(seed)
        plan, best = solve(mission, method="seq"), solve(mission, method="exact")
        if plan.objective and best.objective and plan.bound.information is not None:
            assert plan.bound.information <= best.objective.information * (1.0 + 1e-6)
            tight += plan.bound.information > 0.5 * best.objective.information
    assert tight
