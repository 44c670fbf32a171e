"""The paper's LNS: where it begins, which pairs it tries, what a pair may change, when it ends."""

from __future__ import annotations

import time
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from random_missions import part_way, tiny_mission
from street_case import BASE, A, C, street
from team_cases import quickest

from malipp_field.mission import Cache, Mission, TeamState, initial_state, read_mission
from malipp_field.plan import Plan
from malipp_field.planner import Progress, solve, verify
from malipp_field.planner.exact.tree import ColumnStage
from malipp_field.planner.extract import TeamPlan, Visit, team_plan
from malipp_field.planner.linear import Effort
from malipp_field.planner.paper import lns
from malipp_field.planner.paper.frozen import ground
from malipp_field.planner.paper.pairs import energy_slack, pairs_of, ranked, shared_nodes
from malipp_field.planner.problem import Problem, build_problem
from malipp_field.planner.progress import Result, Search

MISSIONS = Path(__file__).parents[2] / "missions"
TEAM = [100, 103, 131]
"""Seeds of missions with three robots in which pairs gain more than 5 % on Seq-LIPP."""


def team_of_three(seed: int, **changes: Any) -> Mission:
    return tiny_mission(seed, robots=3, candidates=4, **changes)


def information(plan: Plan) -> float:
    assert plan.objective is not None
    return plan.objective.information


def search(seconds: float = 60.0, **options: Any) -> Search:
    return Search(effort=Effort(time.monotonic() + seconds), gap=1e-4, **options)


def without_time(plan: Plan) -> Plan:
    return plan.model_copy(update={"solve_time_s": 0.0})


# the whole


@pytest.mark.parametrize("seed", TEAM)
def test_better_than_seq_lipp_and_not_than_the_optimum(seed: int) -> None:
    mission = team_of_three(seed)
    plan = solve(mission, method="lns")
    assert (plan.method, plan.status) == ("lns", "feasible")
    assert information(plan) < 0.95 * information(solve(mission, method="seq"))
    exact = solve(mission, method="exact")
    assert information(plan) >= information(exact) * (1 - 2e-4)
    assert plan.bound.information is not None
    assert plan.bound.information <= information(exact) + 1e-9


def test_with_two_robots_the_pair_is_the_team() -> None:
    mission = read_mission(MISSIONS / "corridor.yaml")
    plan = solve(mission, method="lns")
    assert information(plan) == pytest.approx(information(solve(mission, method="exact")), rel=1e-4)
    assert plan.handoffs > 0
    assert solve(mission, method="lns", handoffs=False).handoffs == 0


def test_a_single_robot_is_a_neighbourhood_of_its_own() -> None:
    mission = tiny_mission(101, robots=1)
    exact = solve(mission, method="exact")
    assert information(solve(mission, method="lns")) == pytest.approx(information(exact), rel=1e-4)


@pytest.mark.parametrize("seed", range(200, 206))
def test_missions_part_way(seed: int) -> None:
    mission = team_of_three(seed)
    state = part_way(mission, seed)
    plan = solve(mission, state=state, method="lns")
    exact = solve(mission, state=state, method="exact")
    assert (plan.status == "infeasible") == (exact.status == "infeasible")
    if plan.robots:
        assert verify(mission, plan, state) == []
        assert information(plan) >= information(exact) * (1 - 2e-4)


def test_a_warm_start_is_never_made_worse() -> None:
    mission = team_of_three(TEAM[0])
    exact = solve(mission, method="exact")
    again = solve(mission, method="lns", warm_start=exact, work_limit=1)
    assert information(again) <= information(exact) * (1 + 1e-12)


def test_incumbents_are_told_as_they_come() -> None:
    heard: list[Progress] = []
    plan = solve(team_of_three(TEAM[0]), method="lns", on_progress=heard.append)
    told = [progress.incumbent for progress in heard if progress.incumbent is not None]
    assert told
    assert all(later <= before * (1 + 1e-9) for before, later in pairwise(told))
    assert all(later.elapsed_s >= before.elapsed_s for before, later in pairwise(heard))
    assert told[-1] == pytest.approx(information(plan))
    assert {progress.bound for progress in heard} == {None}


# limits


def test_the_time_limit_is_kept_and_cancelling_leaves_a_plan() -> None:
    mission = read_mission(MISSIONS / "quarry.yaml")
    plan, took_s = quickest(lambda: solve(mission, method="lns", time_limit_s=1.0), 4.0)
    assert took_s < 4.0
    assert plan.status == "feasible"
    assert solve(mission, method="lns", cancelled=lambda: True).status == "feasible"


def test_a_limit_on_work_counts_pairs_and_gives_the_same_plan_again() -> None:
    heard: list[Progress] = []
    mission = team_of_three(TEAM[0])
    plans = [
        solve(mission, method="lns", work_limit=2, seed=4, time_limit_s=600.0, on_progress=heard.append)
        for _ in range(2)
    ]
    assert without_time(plans[0]) == without_time(plans[1])
    assert max(progress.rounds for progress in heard) == 2


# initialisation


def test_direct_ways_to_a_depot_where_seq_lipp_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lns, "solve_sequential", lambda *_: None)
    problem = build_problem(team_of_three(TEAM[0]))
    routes = lns.direct_routes(problem)
    for robot, route in zip(problem.robots, routes, strict=True):
        cost = robot.closure.energy_per_kg[robot.start]
        assert route[0].node == robot.start
        assert cost[route[-1].node] == min(cost[list(robot.depots)])
    monkeypatch.setattr(lns, "UNRESTRICTED_SHARE", 0.0)
    first = lns.first_incumbent(problem, search())
    assert first.team is not None
    for r, (robot, route) in enumerate(zip(problem.robots, routes, strict=True)):
        walk = ground(problem, robot, [visit.node for visit in route])
        assert is_along([visit.node for visit in first.team.routes[r]], walk)
    assert information(solve(team_of_three(TEAM[0]), method="lns")) < first.team.information


def off_the_way() -> tuple[Mission, TeamState]:
    """Return a mission with a sample that lies on no direct way home."""
    mission = tiny_mission(101, energy_budget_j=60.0, start="d0", depots=["d0"])
    return mission, initial_state(mission).model_copy(
        update={"caches": (Cache(node="v2", sender="r1", count=1),)}
    )


def test_an_unrestricted_search_where_direct_ways_fail_too(monkeypatch: pytest.MonkeyPatch) -> None:
    mission, state = off_the_way()
    problem = build_problem(mission, state)
    monkeypatch.setattr(lns, "solve_sequential", lambda *_: None)
    assert lns.first_incumbent(problem, search()).team is not None
    monkeypatch.setattr(lns, "UNRESTRICTED_SHARE", 0.0)
    monkeypatch.setattr(lns, "ColumnStage", _gives_up_on_free_robots(problem))
    assert lns.first_incumbent(problem, search()).team is None
    assert solve(mission, state=state, method="lns").status == "no_plan"


def _gives_up_on_free_robots(whole: Problem) -> Any:
    """Return a first stage that finds nothing where no route stands."""

    class Stage:
        def __init__(self, problem: Problem, search: Search, start: TeamPlan | None) -> None:
            self.problem, self.inner = problem, ColumnStage(problem, search, start)

        def run(self) -> Result:
            same = [robot.stops for robot in self.problem.robots] == [robot.stops for robot in whole.robots]
            return Result(None, 0.0, proven=False) if same else self.inner.run()

    return Stage


def test_no_plan_at_all_is_proven() -> None:
    mission = tiny_mission(101, robots=2, energy_budget_j=12.0, payload_capacity=1, start="d0", depots=["d0"])
    caches = (Cache(node="v0", sender="r1", count=1), Cache(node="v1", sender="r1", count=1),
              Cache(node="v2", sender="r0", count=1))  # fmt: skip
    state = initial_state(mission).model_copy(update={"caches": caches})
    assert solve(mission, state=state, method="exact").status == "infeasible"
    plan = solve(mission, state=state, method="lns")
    assert (plan.status, bool(plan.reason)) == ("infeasible", True)


# pairs


def is_along(stops: list[int], walk: list[int]) -> bool:
    places = iter(walk)
    return all(stop in places for stop in stops)


@pytest.mark.parametrize("seed", TEAM)
def test_in_a_pair_all_other_robots_keep_to_their_routes(seed: int) -> None:
    problem = build_problem(team_of_three(seed))
    best = lns.first_incumbent(problem, search()).team
    assert best is not None
    for pair in pairs_of(problem):
        result = lns.pair_plan(problem, search(), best, pair)
        assert result.team is not None
        assert result.team.information <= best.information * (1 + 1e-9)
        for r in set(range(3)) - set(pair):
            walk = ground(problem, problem.robots[r], [visit.node for visit in best.routes[r]])
            assert is_along([visit.node for visit in result.team.routes[r]], walk)
        assert team_plan(problem, result.team.routes) is not None


def test_pairs_are_ranked_by_slack_shared_nodes_and_failures() -> None:
    problem = build_problem(team_of_three(101, energy_budget_j=40.0, start="d0", depots=["d0"]))
    home = problem.robots[0].start
    busy, stay = (Visit(home), Visit(problem.robots[0].stops[0]), Visit(home)), (Visit(home),)
    plan = team_plan(problem, (stay, busy, stay))
    assert plan is not None
    assert energy_slack(problem, 0, stay) == 1.0
    assert 0.0 < energy_slack(problem, 1, busy) < 1.0
    assert len({shared_nodes(problem, pair) for pair in pairs_of(problem)}) == 1
    assert ranked(problem, plan, {}) == [(0, 1), (1, 2), (0, 2)]  # 0 and 2 have the same slack
    assert ranked(problem, plan, {(0, 1): 1}) == [(1, 2), (0, 2), (0, 1)]
    near = problem.robots[0].places[:2]
    fewer = [*problem.robots]
    fewer[2] = replace(fewer[2], stops=tuple(v for v in near if v != fewer[2].start))
    assert ranked(replace(problem, robots=tuple(fewer)), plan, {})[0] == (0, 1)


def test_only_a_fall_of_more_than_epsilon_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = build_problem(team_of_three(TEAM[0]))
    first = lns.first_incumbent(problem, search()).team
    assert first is not None
    assert lns.PairwiseSearch(problem, search(), first).run().information < first.information
    monkeypatch.setattr(lns, "EPSILON", 1.0)
    pairwise_search = lns.PairwiseSearch(problem, search(), first)
    assert pairwise_search.run() is first
    assert pairwise_search.solved == 3  # one sweep that gives nothing is the last


def test_a_pair_proven_to_give_nothing_is_not_tried_again() -> None:
    problem = build_problem(team_of_three(TEAM[0]))
    first = lns.first_incumbent(problem, search()).team
    assert first is not None
    done = lns.PairwiseSearch(problem, search(), first)
    best = done.run()
    solved = done.solved
    assert done.run() is best
    assert done.solved == solved


# refinement


@pytest.mark.parametrize("seed", TEAM)
def test_refinement_saves_energy_and_leaves_j_alone(seed: int) -> None:
    problem = build_problem(team_of_three(seed))
    first = lns.first_incumbent(problem, search()).team
    assert first is not None
    last = lns.refined(problem, search(), first)
    assert last.information == pytest.approx(first.information, rel=1e-12)
    assert last.energy_j <= first.energy_j * (1 + 1e-6)
    for robot, before, after in zip(problem.robots, first.routes, last.routes, strict=True):
        walk = ground(problem, robot, [visit.node for visit in before])
        assert is_along([visit.node for visit in after], walk)


def test_refinement_gives_a_sample_to_whoever_passes_on_the_way_home() -> None:
    problem = street()
    out = (Visit(BASE), Visit(A, collect=1), Visit(C, collect=1), Visit(BASE, unload=2))
    plan = team_plan(problem, (out, (Visit(C), Visit(BASE))))
    assert plan is not None
    near, far = lns.refined(problem, search(), plan).routes
    assert A not in [visit.node for visit in near]
    assert Visit(A, collect=1) in far
