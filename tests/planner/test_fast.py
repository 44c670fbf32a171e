"""The fast planner: never worse than the baselines, never below a bound, the same for the same seed."""

from __future__ import annotations

import pytest
from random_missions import part_way, tiny_mission
from team_cases import scaled, search

from malipp_field.bench.instances import Specification, build
from malipp_field.mission import Mission
from malipp_field.plan import Plan
from malipp_field.planner import Progress, method_for, solve, verify
from malipp_field.planner.repair import first_plan
from malipp_field.planner.search.walks import Walks


def team(robots: int, candidates: int, seed: int = 0) -> Mission:
    return build(Specification(robots, candidates, seed), 22.0)


def information(plan: Plan) -> float:
    assert plan.objective is not None, plan.reason
    return plan.objective.information


@pytest.mark.parametrize("seed", range(4))
def test_it_is_never_worse_than_seq_lipp_nor_below_the_bound(seed: int) -> None:
    mission = team(5, 14, seed)
    fast = solve(mission, method="fast", time_limit_s=6.0, work_limit=3)
    assert fast.method == "fast"
    assert not verify(mission, fast)
    assert information(fast) < information(solve(mission, method="seq"))
    assert fast.bound.information is not None
    assert fast.bound.information <= information(fast)


@pytest.mark.parametrize("partly", [False, True])
@pytest.mark.parametrize("seed", range(12))
def test_it_finds_the_optimum_of_tiny_missions(seed: int, partly: bool) -> None:
    mission = tiny_mission(seed, robots=2, candidates=3)
    state = part_way(mission, seed) if partly else None
    exact = solve(mission, state=state, method="exact")
    fast = solve(mission, state=state, method="fast", time_limit_s=20.0, work_limit=2)
    assert (fast.status == "infeasible") == (exact.status == "infeasible")
    if exact.robots:
        assert information(fast) == pytest.approx(information(exact), rel=1e-5)
        assert not verify(mission, fast, state)
        assert fast.bound.information is not None
        assert fast.bound.information <= information(exact) * (1.0 + 1e-9)


def test_the_same_seed_and_rounds_give_the_same_plan() -> None:
    mission = tiny_mission(2, robots=3, candidates=5)
    plans = [solve(mission, method="fast", seed=3, work_limit=2, threads=2) for _ in range(2)]
    assert plans[0].robots == plans[1].robots


def test_walks_do_not_hang_on_which_core_is_quicker() -> None:
    problem, _ = scaled(team(6, 18))
    found = []
    for seed in (3, 3, 4):
        walks = Walks(problem, seed, 2)
        start = first_plan(problem, None, search()).team
        assert start is not None
        rounds = walks.rounds(start, search(limit_s=120.0).effort)
        found.append([next(rounds).routes, next(rounds).routes])
    assert found[0] == found[1]
    assert found[0] != found[2]


def test_without_handoffs_there_are_no_drops_and_no_better_plan() -> None:
    mission = team(5, 14)
    with_drops = solve(mission, method="fast", work_limit=4, time_limit_s=9.0)
    without = solve(mission, method="fast", handoffs=False, work_limit=4, time_limit_s=9.0)
    assert with_drops.handoffs > 0
    assert without.handoffs == 0
    assert information(with_drops) < information(without)


def test_auto_takes_the_exact_search_for_small_teams_only() -> None:
    small, large = tiny_mission(1), team(6, 18)
    assert method_for(small)[0] == "exact"
    assert "6 robots times 18 candidates are 108" in method_for(large)[1]
    assert solve(small).status == "optimal"
    plan = solve(large, work_limit=1, time_limit_s=4.0)
    assert (plan.method, plan.status) == ("fast", "feasible")


def test_plans_are_told_as_they_are_found_and_only_get_better() -> None:
    told: list[Progress] = []
    plan = solve(team(5, 14), method="fast", time_limit_s=9.0, work_limit=3, on_progress=told.append)
    found = [entry.incumbent for entry in told if entry.incumbent is not None]
    assert len(found) == 4  # the first plan, and one after each round
    assert found == sorted(found, reverse=True)
    assert found[-1] == pytest.approx(information(plan))


def test_a_warm_start_is_never_lost() -> None:
    mission = team(6, 18)
    best = solve(mission, method="fast", work_limit=4, time_limit_s=4.0)
    again = solve(mission, method="fast", work_limit=1, time_limit_s=3.0, warm_start=best, seed=9)
    assert information(again) <= information(best)


def test_cancelled_at_once_there_is_still_a_plan() -> None:
    plan = solve(team(5, 14), method="fast", cancelled=lambda: True)
    assert plan.robots
    assert not verify(team(5, 14), plan)


def test_more_walks_are_never_worse_than_the_first_of_them_alone() -> None:
    problem, _ = scaled(team(5, 14))
    one, three = Walks(problem, 0, 1), Walks(problem, 0, 3)
    start = first_plan(problem, None, search()).team
    assert start is not None
    effort = search(limit_s=120.0).effort
    assert next(three.rounds(start, effort)).rank <= next(one.rounds(start, effort)).rank


def test_a_large_team_is_searched_in_groups_and_has_a_bound() -> None:
    mission = team(18, 36)
    plan = solve(mission, method="fast", time_limit_s=60.0, work_limit=3)
    assert not verify(mission, plan)
    first = solve(mission, method="fast", cancelled=lambda: True)
    assert information(plan) < information(first)
    assert plan.bound.information is not None
    assert 0.0 < plan.bound.information < information(plan)
    assert plan.status == "feasible"
