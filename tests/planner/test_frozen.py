"""Routes that stand: where a robot may stop on them, what driving on costs, and what is left free."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from random_missions import tiny_mission
from street_case import BASE, A, B, C, street

from malipp_field.planner.extract import Visit, team_plan
from malipp_field.planner.paper.frozen import freeze, ground
from malipp_field.planner.problem import build_problem


def test_a_robot_may_stop_where_its_route_leads_it_on_the_last_pass() -> None:
    problem = street()
    near, far = problem.robots
    assert ground(problem, near, [BASE, C, BASE]) == [BASE, C, B, A, BASE]
    assert ground(problem, far, [C, BASE]) == [C, B, A, BASE]
    assert ground(problem, near, [BASE, B, C, BASE]) == [BASE, B, C, A, BASE]
    assert ground(problem, near, [BASE]) == [BASE]


def test_driving_on_costs_what_the_route_costs_and_there_is_no_other_way() -> None:
    problem = street()
    stay = (Visit(BASE),)
    routes = ((Visit(BASE), Visit(B), Visit(C), Visit(BASE)), stay)
    robot = freeze(problem, routes, [1]).robots[0]
    cost, time_s = robot.closure.energy_per_kg, robot.closure.time_s
    assert robot.stops == (A, B, C)
    assert [cost[BASE, v] for v in (B, C, A)] == pytest.approx([2.0, 3.0, 5.0])  # a comes on the way back
    assert [cost[v, BASE] for v in (B, C, A)] == pytest.approx([4.0, 3.0, 1.0])
    assert np.isinf([cost[C, B], cost[A, C], cost[A, B]]).all()
    assert time_s[BASE, A] == pytest.approx(10.0)
    assert robot.closure.paths[BASE, A] == ("base", "a", "b", "c", "b", "a")


def test_a_robot_that_stays_has_nowhere_to_go_and_a_free_one_is_as_it_was() -> None:
    problem = street()
    frozen = freeze(problem, ((Visit(BASE),), (Visit(C), Visit(BASE))), [1])
    assert frozen.robots[0].stops == ()
    assert frozen.robots[0].closure.energy_per_kg[BASE, BASE] == 0.0
    assert frozen.robots[1] is problem.robots[1]
    assert frozen.arcs(0) == [(BASE, len(problem.nodes) + BASE)]


def test_a_plan_costs_the_same_on_its_own_routes() -> None:
    problem = street()
    out = (Visit(BASE), Visit(C, collect=1), Visit(A, collect=1), Visit(BASE, unload=2))
    routes = (out, (Visit(C), Visit(BASE)))
    plan, same = team_plan(problem, routes), team_plan(freeze(problem, routes), routes)
    assert plan is not None
    assert same is not None
    assert same.rank == pytest.approx(plan.rank)


@pytest.mark.parametrize("seed", [100, 103, 105, 111])
def test_parts_of_cheapest_ways_are_cheapest_ways(seed: int) -> None:
    problem = build_problem(tiny_mission(seed, candidates=4))
    for robot in problem.robots:
        for depot in robot.depots:
            for stop in robot.stops:
                if stop == depot:
                    continue
                nodes = [robot.start, stop, depot]
                walk = ground(problem, robot, nodes)
                cost = robot.closure.energy_per_kg
                whole = sum(float(cost[u, v]) for u, v in pairwise(walk))
                assert whole == pytest.approx(float(cost[robot.start, stop] + cost[stop, depot]))
