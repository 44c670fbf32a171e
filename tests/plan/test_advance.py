"""Where a team stands when its plan has gone well for a while, and what is left of the plan."""

from __future__ import annotations

import math

import pytest

from malipp_field.bench.instances import Specification, build
from malipp_field.mission import Mission, initial_state
from malipp_field.plan import Plan, advance, rest_of
from malipp_field.planner.extract import Verdict, plan_file
from malipp_field.planner.linear import Effort
from malipp_field.planner.problem import build_problem
from malipp_field.planner.search.improver import Improver


@pytest.fixture(scope="module")
def planned() -> tuple[Mission, Plan]:
    """Return a mission and a plan with drops."""
    mission = build(Specification(4, 14, seed=1), 30.0)
    problem = build_problem(mission)
    improver = Improver(problem, 0)
    start = improver.construct()
    assert start is not None
    team = improver.improve(start, 800, Effort(deadline=math.inf))
    plan = plan_file(mission.name, problem, team, Verdict("fast", "feasible", None, None, 0.0, 0, 1))
    assert plan.handoffs
    return mission, plan


def test_at_the_end_all_samples_are_on_their_last_way(planned: tuple[Mission, Plan]) -> None:
    mission, plan = planned
    state = advance(mission, plan, 1e9)
    assert not state.caches
    assert [robot.node for robot in state.robots] == [robot.route[-1].node for robot in plan.robots]
    assert [robot.on_board for robot in state.robots] == [robot.route[-1].unload for robot in plan.robots]


@pytest.mark.parametrize("share", [0.2, 0.35, 0.5, 0.65, 0.8])
def test_two_steps_lead_where_one_does(planned: tuple[Mission, Plan], share: float) -> None:
    mission, plan = planned
    assert plan.objective is not None
    later_s = share * plan.objective.makespan_s
    at_once = advance(mission, plan, later_s)
    for part in (0.3, 0.6, 0.9):
        half_way = advance(mission, plan, part * later_s)
        in_steps = advance(mission, rest_of(plan, part * later_s), later_s, half_way)
        assert sorted(map(str, in_steps.caches)) == sorted(map(str, at_once.caches))
        for one, other in zip(in_steps.robots, at_once.robots, strict=True):
            assert one.energy_left_j == pytest.approx(other.energy_left_j, abs=1e-9)
            assert one.model_copy(update={"energy_left_j": 0.0}) == other.model_copy(
                update={"energy_left_j": 0.0}
            )


def test_samples_are_never_lost_or_made(planned: tuple[Mission, Plan]) -> None:
    mission, plan = planned
    assert plan.objective is not None
    for k in range(12):
        time_s = k / 11 * plan.objective.makespan_s
        state, rest = advance(mission, plan, time_s, initial_state(mission)), rest_of(plan, time_s)
        there = sum(robot.on_board for robot in state.robots) + sum(cache.count for cache in state.caches)
        to_come = sum(stop.collect for robot in rest.robots for stop in robot.route)
        assert there + to_come == sum(stop.unload for robot in rest.robots for stop in robot.route)
