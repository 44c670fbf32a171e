"""One robot alone: all it could do, listed, against the exact search."""

from __future__ import annotations

from dataclasses import replace

import pytest
from random_missions import part_way, tiny_mission
from team_cases import search

from malipp_field.mission import TeamState
from malipp_field.planner import verify
from malipp_field.planner.exact.lexicographic import solve_arcs
from malipp_field.planner.extract import Verdict, plan_file
from malipp_field.planner.paper import alone, sequential
from malipp_field.planner.paper.alone import options_of, plan_alone
from malipp_field.planner.paper.sequential import solve_sequential
from malipp_field.planner.problem import Problem, build_problem


def single(seed: int, *, partly: bool = False) -> Problem:
    mission = tiny_mission(seed, robots=1, candidates=4)
    state: TeamState | None = part_way(mission, seed) if partly else None
    return build_problem(mission, state, handoffs=False)


@pytest.mark.parametrize("partly", [False, True])
@pytest.mark.parametrize("seed", range(12))
def test_it_finds_what_the_exact_search_finds(seed: int, partly: bool) -> None:
    problem = single(seed, partly=partly)
    options = options_of(problem)
    assert options is not None
    found = plan_alone(problem, options)
    exact = solve_arcs(problem, search()).team
    assert (found is None) == (exact is None)
    if found is not None and exact is not None:
        assert found.information == pytest.approx(exact.information, rel=1e-6)
        assert found.energy_j == pytest.approx(exact.energy_j, rel=1e-6, abs=1e-9)


def test_a_listing_serves_whatever_has_been_gained_since() -> None:
    problem = single(1)
    options = options_of(problem)
    assert options is not None
    for i in range(len(problem.candidates)):
        gained = problem.gained.copy()
        gained[i] += 50.0
        later = replace(problem, gained=gained)
        found, exact = plan_alone(later, options), solve_arcs(later, search()).team
        assert found is not None
        assert exact is not None
        assert found.information == pytest.approx(exact.information, rel=1e-6)


def test_without_room_for_the_listing_ruin_and_recreate_plans(monkeypatch: pytest.MonkeyPatch) -> None:
    mission = tiny_mission(4, robots=2, candidates=4)
    problem = build_problem(mission, handoffs=False)
    listed = solve_sequential(problem, search())
    monkeypatch.setattr(alone, "_ROOM", 3)
    assert options_of(single(1)) is None
    searched = solve_sequential(problem, search())
    assert listed is not None
    assert searched is not None
    assert searched.information == pytest.approx(listed.information, rel=1e-6)


@pytest.mark.parametrize("block", range(3))
def test_searched_plans_of_missions_part_way_are_verified(
    block: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sequential, "options_of", lambda _: None)
    planned = fetched = 0
    for seed in range(700 + 8 * block, 708 + 8 * block):
        mission = tiny_mission(seed, robots=3, candidates=5, energy_budget_j=40.0)
        state = part_way(mission, seed)
        problem = build_problem(mission, state, handoffs=False)
        team = solve_sequential(problem, search())
        if team is None:
            continue
        planned += 1
        fetched += sum(bool(visit.fetch) for route in team.routes for visit in route)
        plan = plan_file(mission.name, problem, team, Verdict("seq", "feasible", None, None, 0.0, 0, 1))
        assert not verify(mission, plan, state)
        assert team.information <= problem.information.value(problem.gained)
    assert planned >= 4
    assert fetched
