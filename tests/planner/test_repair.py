"""Replanning begins with the plan in force: kept where it stands, mended where it does not, never lost."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from random_missions import part_way, tiny_mission

from malipp_field.bench.instances import Specification, build
from malipp_field.mission import Cache, Mission, RobotState, TeamState
from malipp_field.plan import Plan, advance, rest_of
from malipp_field.planner import solve, verify
from malipp_field.planner.draft import ON_BOARD, draft_of
from malipp_field.planner.exact.stages import plan_of_precision
from malipp_field.planner.extract import TeamPlan, Verdict, plan_file
from malipp_field.planner.follow import followed
from malipp_field.planner.linear import Effort
from malipp_field.planner.problem import Problem, build_problem
from malipp_field.planner.progress import Search
from malipp_field.planner.repair import first_plan, repaired
from malipp_field.planner.search.improver import Improver

SEARCH = Search(Effort(deadline=math.inf), gap=1e-4)


def as_plan(mission: Mission, problem: Problem, team: TeamPlan) -> Plan:
    return plan_file(mission.name, problem, team, Verdict("fast", "feasible", None, None, 0.0, 0, 1))


def planned(mission: Mission, state: TeamState | None = None, iterations: int = 400) -> Plan | None:
    """Return a plan of middling quality, which is what plans in force are."""
    problem = build_problem(mission, state)
    improver = Improver(problem, 1)
    start = improver.construct()
    if start is None:
        return None
    return as_plan(mission, problem, improver.improve(start, iterations, SEARCH.effort))


def poorer(state: TeamState, seed: int, most: float) -> TeamState:
    """Return a state in which every robot has lost up to so large a share of what it had left."""
    shares = 1.0 - most * np.random.default_rng(seed).uniform(0.0, 1.0, len(state.robots))
    robots = tuple(
        robot.model_copy(update={"energy_left_j": robot.energy_left_j * float(share)})
        for robot, share in zip(state.robots, shares, strict=True)
    )
    return state.model_copy(update={"robots": robots})


def is_possible(problem: Problem) -> bool:
    """Ask the arc model whether anything can be planned at all: what must come home, and no sampling."""
    if any(not robot.depots for robot in problem.robots):
        return False
    team, impossible = plan_of_precision(problem, SEARCH, problem.gained)
    assert (team is None) == impossible
    return team is not None


def in_a_row(budgets_j: tuple[float, float], *, handoffs_at_m: float = 3.0) -> tuple[Mission, TeamState]:
    """Return two robots, the first with a sample on board 6 m from the depot, the other at the depot."""
    places = {"far": (6.0, "candidate"), "near": (handoffs_at_m, "candidate"), "home": (0.0, "depot")}
    robot: dict[str, Any] = {
        "start": "home", "depots": ["home"], "empty_mass_kg": 1.0, "payload_capacity": 2,
        "samples_per_node": 1, "noise_variance": 0.1, "energy_per_kg_m": 1.0, "speed_m_s": 1.0,
        "energy_budget_j": 99.0,
    }  # fmt: skip
    mission = Mission.model_validate(
        {
            "format": "malipp-mission/1",
            "name": "row",
            "site": {
                "nodes": [{"id": k, "x_m": x, "y_m": 0.0, "role": role} for k, (x, role) in places.items()],
                "complete": True,
            },
            "field": {
                "kernel": {"family": "rbf", "length_scale_m": 2.0},
                "test_points": [{"x_m": 3.0, "y_m": 0.0}],
            },
            "team": {
                "sample_mass_kg": 1.0,
                "robots": [{**robot, "id": "scout"}, {**robot, "id": "mule"}],
            },
        }
    )
    state = TeamState(
        robots=(
            RobotState(id="scout", node="far", energy_left_j=budgets_j[0], on_board=1, collected={"far": 1}),
            RobotState(id="mule", node="home", energy_left_j=budgets_j[1]),
        )
    )
    return mission, state


def straight_home(mission: Mission, state: TeamState) -> Plan:
    """Return the plan of a scout that brings its sample home itself, while the other robot stays."""
    plan = solve(mission, state=state, method="exact", handoffs=False)
    assert [stop.unload for stop in plan.robot("scout").route][-1] >= 1
    return plan


def test_collected_samples_change_hands_where_their_way_home_no_longer_fits() -> None:
    mission, rich = in_a_row((12.0, 12.0))
    old = straight_home(mission, rich)
    _, poor = in_a_row((9.5, 9.5))  # 12 J loaded, 6 J empty: the sample has to change hands on the way
    problem = build_problem(mission, poor)
    team = repaired(problem, old, 0)
    assert team is not None
    assert not verify(mission, as_plan(mission, problem, team), poor)
    (tail,) = [sample for sample in draft_of(problem, team).samples if sample.kind == ON_BOARD]
    assert [problem.robots[receiver].id for _, receiver in tail.hops] == ["mule"]


def test_a_team_that_cannot_bring_a_sample_home_is_told_so() -> None:
    mission, rich = in_a_row((12.0, 12.0))
    _, poor = in_a_row((8.0, 6.0))  # the mule gets to the near node and back empty, not loaded
    plan = solve(mission, state=poor, warm_start=straight_home(mission, rich))
    assert plan.status == "infeasible"
    assert plan.reason is not None
    assert "J more" in plan.reason


def test_a_tail_ends_at_the_nearest_depot_instead() -> None:
    mission, rich = in_a_row((12.0, 0.0))
    old = straight_home(mission, rich)
    record = mission.model_dump(mode="json", by_alias=True, exclude_none=True)
    record["site"]["nodes"].append({"id": "tent", "x_m": 7.0, "y_m": 0.0, "role": "depot"})
    record["team"]["robots"][0]["depots"] = ["home", "tent"]
    wider = Mission.model_validate(record)
    poor = poorer(rich, 0, 0.9)
    problem = build_problem(wider, poor)
    team = repaired(problem, old, 0)
    assert team is not None
    assert problem.nodes[team.routes[0][-1].node] == "tent"


@pytest.mark.parametrize("block", range(4))
def test_feasible_just_where_the_arc_model_is(block: int) -> None:
    answers = []
    for seed in range(25 * block, 25 * block + 25):
        mission = tiny_mission(seed, robots=2 + seed % 3, candidates=3 + seed % 4)
        state = part_way(mission, seed)
        old = planned(mission, state, 50)
        if old is None:
            continue
        poor = poorer(state, seed, 0.2 + 0.1 * (seed % 8))
        problem = build_problem(mission, poor)
        possible = is_possible(problem)
        found = first_plan(problem, old, SEARCH) if all(r.depots for r in problem.robots) else None
        answers.append(possible)
        assert (found is not None and found.team is not None) == possible
        if found is not None and found.team is not None:
            assert not verify(mission, as_plan(mission, problem, found.team), poor)
        else:
            assert found is None or found.infeasible
    assert set(answers) == {True, False}


@pytest.mark.parametrize("seed", range(4))
def test_a_plan_in_force_that_stands_is_kept_stop_by_stop(seed: int) -> None:
    mission = build(Specification(4, 14, seed=seed), 25.0)
    plan = planned(mission)
    assert plan is not None
    assert plan.objective is not None
    for share in (0.0, 0.2, 0.4, 0.6, 0.9):
        time_s = share * plan.objective.makespan_s
        state = advance(mission, plan, time_s)
        problem = build_problem(mission, state)
        team = repaired(problem, rest_of(plan, time_s), seed)
        assert team is not None
        assert team.information == pytest.approx(plan.objective.information, rel=1e-9)
        assert team.energy_j <= sum(stop.energy_j for stop in rest_of(plan, time_s).robots) * (1.0 + 1e-9)
        assert not verify(mission, as_plan(mission, problem, team), state)


@pytest.mark.parametrize("seed", range(3))
def test_the_result_is_never_worse_than_the_plan_in_force(seed: int) -> None:
    mission = build(Specification(4, 12, seed=seed), 25.0)
    plan = planned(mission, iterations=3000)
    assert plan is not None
    assert plan.objective is not None
    time_s = 0.4 * plan.objective.makespan_s
    again = solve(
        mission, state=advance(mission, plan, time_s), warm_start=rest_of(plan, time_s), time_limit_s=0.2
    )
    assert again.objective is not None
    assert again.objective.information <= plan.objective.information * (1.0 + 1e-9)


def test_stock_whose_carrier_is_lost_is_fetched_by_another() -> None:
    mission, _ = in_a_row((99.0, 99.0))
    home: dict[str, Any] = {"node": "home", "energy_left_j": 30.0}
    lying = Cache(node="near", sender="scout", count=2, available_s=5.0)
    begin = TeamState(robots=(RobotState(id="scout", **home), RobotState(id="mule", **home)), caches=(lying,))
    old = solve(mission, state=begin, method="exact")
    carrier = next(robot.id for robot in old.robots if any(stop.pick for stop in robot.route))
    robots = tuple(
        robot.model_copy(update={"energy_left_j": 0.0 if robot.id == carrier else robot.energy_left_j})
        for robot in begin.robots
    )
    after = begin.model_copy(update={"robots": robots})
    problem = build_problem(mission, after)
    team = repaired(problem, old, 0)
    assert team is not None
    assert not verify(mission, as_plan(mission, problem, team), after)


def test_a_drop_that_is_not_there_is_not_fetched() -> None:
    mission, _ = in_a_row((99.0, 99.0))
    home: dict[str, Any] = {"node": "home", "energy_left_j": 30.0}
    robots = (RobotState(id="scout", **home), RobotState(id="mule", **home))
    lying = Cache(node="near", sender="scout", count=2)
    old = solve(mission, state=TeamState(robots=robots, caches=(lying,)), method="exact")
    empty = TeamState(robots=robots)
    draft, left = followed(build_problem(mission, empty), old)
    assert not left
    assert all(sample.kind != 2 for sample in draft.samples)
    again = solve(mission, state=empty, method="exact", warm_start=old)
    assert again.status == "optimal"


def test_advice_about_others_is_passed_over() -> None:
    mission, state = in_a_row((12.0, 12.0))
    old = straight_home(mission, state)
    stranger = old.robots[0].model_copy(update={"id": "stranger"})
    odd = old.model_copy(update={"robots": (stranger,)})
    problem = build_problem(mission, state)
    team = repaired(problem, odd, 0)
    assert team is not None
    assert not verify(mission, as_plan(mission, problem, team), state)


def test_the_same_seed_gives_the_same_repair() -> None:
    mission = build(Specification(4, 14, seed=2), 25.0)
    plan = planned(mission)
    assert plan is not None
    assert plan.objective is not None
    time_s = 0.3 * plan.objective.makespan_s
    poor = poorer(advance(mission, plan, time_s), 1, 0.1)
    problem = build_problem(mission, poor)
    first, second = (repaired(problem, rest_of(plan, time_s), 7) for _ in range(2))
    assert first is not None
    assert second is not None
    assert first.routes == second.routes
