"""From schedules to plans: what comes out keeps every rule and takes what the schedules take."""

from __future__ import annotations

import numpy as np
import pytest
from circle_cases import circle
from random_missions import part_way, tiny_mission
from team_cases import alike, listed, scaled, search, some_teams

from malipp_field.mission import Mission, TeamState
from malipp_field.planner import verify
from malipp_field.planner.exact.realise import realise
from malipp_field.planner.exact.stages import plan_of_precision
from malipp_field.planner.extract import Verdict, plan_file, team_plan
from malipp_field.planner.problem import build_problem

_VERDICT = Verdict(
    method="exact", status="feasible", bound=None, gap=None, solve_time_s=0.0, seed=0, version=1
)


def _cases() -> dict[str, tuple[Mission, TeamState | None]]:
    cases: dict[str, tuple[Mission, TeamState | None]] = {
        "two robots": (tiny_mission(202, candidates=3), None),
        "three robots": (tiny_mission(312, robots=3, candidates=2), None),
        "alike": (alike(5, candidates=2, samples_per_node=2), None),
    }
    for seed in (60, 62, 65):
        mission = tiny_mission(seed, candidates=2)
        cases[f"part-way {seed}"] = (mission, part_way(mission, seed))
    return cases


_CASES = _cases()


@pytest.mark.parametrize("name", _CASES)
def test_plans_keep_every_rule_and_take_what_the_schedules_take(name: str) -> None:
    mission, state = _CASES[name]
    problem, _ = scaled(mission, state)
    in_joules = build_problem(mission, state)
    robots, good = listed(problem), 0
    for chosen, team in some_teams(problem, robots, 300, seed=3):
        if team is None:
            continue
        good += 1
        exact = team_plan(in_joules, team.routes)
        assert exact is not None
        assert not verify(mission, plan_file(mission.name, in_joules, exact, _VERDICT), state)
        for robot, codes, route in zip(robots, chosen, team.routes, strict=True):
            taken = robot.taken_of[codes + robot.capacity]
            exchange = robot.exchange_of[codes + robot.capacity]
            expected = {robot.places[w]: int(taken[w]) for w in np.flatnonzero(taken)}
            assert {visit.node: visit.collect for visit in route if visit.collect} == expected
            for visit in route:
                if visit.drop:
                    assert sum(visit.drop.values()) <= -exchange[robot.places.index(visit.node)]
                if visit.pick or visit.fetch:
                    picked = sum(visit.pick.values()) + sum(visit.fetch.values())
                    assert picked <= exchange[robot.places.index(visit.node)]
    assert good


def test_a_circle_is_not_realised_and_proven_impossible() -> None:
    problem, _ = scaled(circle())
    robots = listed(problem)
    precise = problem.robots[0].precision
    both = [
        (team, codes)
        for codes, team in some_teams(problem, robots, 400, seed=0)
        if all(robot.taken_of[own + robot.capacity].any() for robot, own in zip(robots, codes, strict=True))
    ]
    assert both
    assert all(team is None for team, _ in both)
    team, impossible = plan_of_precision(problem, search(), np.full(len(problem.candidates), precise))
    assert team is None
    assert impossible


def test_robots_without_anything_to_do_stay_or_go_home() -> None:
    mission = tiny_mission(202, candidates=3)
    problem, _ = scaled(mission)
    robots = listed(problem)
    team = realise(problem, robots, [np.zeros(len(robot.places), dtype=np.int16) for robot in robots])
    assert team is not None
    assert team.information == pytest.approx(problem.information.prior)
    assert all(len(route) <= 2 for route in team.routes)
