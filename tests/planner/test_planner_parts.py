"""The pieces of the planner on their own: closure, cuts, order of drops, what is left out of a problem."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from random_missions import part_way, tiny_mission

from malipp_field.field import information_model
from malipp_field.mission import Mission, Passage, initial_state
from malipp_field.planner.closure import closure
from malipp_field.planner.draft import COLLECTED, Draft, Sample, draft_of
from malipp_field.planner.exact.cuts import diagonal_share, split_information
from malipp_field.planner.exact.lexicographic import solve_exact
from malipp_field.planner.exact.milp import TeamModel
from malipp_field.planner.exact.timing import add_timing, horizon_s
from malipp_field.planner.extract import Visit, read_routes, start_point, team_plan
from malipp_field.planner.linear import Effort
from malipp_field.planner.problem import build_problem
from malipp_field.planner.progress import Search
from malipp_field.planner.search.improver import Improver

FOREVER = Effort(deadline=math.inf)
seeds = st.integers(0, 10_000)


def square(**changes: Any) -> Mission:
    """Return two robots at one depot and two candidates, everything within reach."""
    robot: dict[str, Any] = {
        "start": "d0",
        "depots": ["d0"],
        "energy_budget_j": 99.0,
        "samples_per_node": 1,
        "payload_capacity": 2,
    }
    return tiny_mission(1, candidates=2, **(robot | changes))


def test_among_equally_cheap_ways_the_closure_takes_the_faster() -> None:
    edges = [
        Passage("a", "b", 1.0, 1.0, 9.0), Passage("b", "d", 1.0, 1.0, 9.0),
        Passage("a", "c", 1.0, 0.5, 1.0), Passage("c", "d", 1.0, 1.5, 1.0),
    ]  # fmt: skip
    found = closure(edges, ["a", "b", "c", "d"], [0, 3])
    assert found.paths[0, 3] == ("a", "c", "d")
    assert (found.energy_per_kg[0, 3], found.time_s[0, 3]) == (2.0, 2.0)
    assert np.isinf(found.energy_per_kg[3, 0])
    assert (3, 0) not in found.paths
    assert found.energy_per_kg[0, 0] == 0.0


@settings(max_examples=25, deadline=None, derandomize=True)
@given(seeds)
def test_cuts_touch_j_where_they_are_made_and_are_never_above_it(seed: int) -> None:
    rng = np.random.default_rng(seed)
    information = information_model(tiny_mission(seed, candidates=5))
    groups = split_information(information, np.ones(5, dtype=bool), 30.0)
    here, there = rng.uniform(0.0, 60.0, (2, 5)) * (rng.uniform(size=(2, 5)) < 0.6)
    touching, below = 0.0, 0.0
    for group in groups:
        value, gradient = group.information.value_and_gradient(group.scaled(here))
        touching += value
        below += value + float(gradient @ (group.scaled(there) - group.scaled(here)))
    assert touching == pytest.approx(information.value(here), rel=1e-6)
    assert below <= information.value(there) + 1e-6


def test_the_diagonal_share_leaves_the_covariance_positive_and_fixed_entries_alone() -> None:
    k_vv = information_model(tiny_mission(3, candidates=6)).k_vv
    free = np.array([True, False, True, True, True, True])
    share = diagonal_share(k_vv, np.ones(6), free, 30.0)
    assert np.linalg.eigvalsh(k_vv - np.diag(share))[0] >= -1e-9
    assert share[1] == 0.0
    assert share[free].min() > 0.0
    assert not diagonal_share(np.ones((3, 3)), np.ones(3), np.ones(3, dtype=bool), 30.0).any()


def test_drops_that_wait_for_each_other_are_found_and_timed_away() -> None:
    problem = build_problem(square())
    v0, v1, depot = (problem.nodes.index(node) for node in ("v0", "v1", "d0"))
    routes = [[depot, v1, v0, depot], [depot, v0, v1, depot]]
    # r0 leaves a sample at v0, and picks one at v1 before; r1 the other way round
    knot = [Sample(COLLECTED, v0, 0, ((v0, 1),)), Sample(COLLECTED, v1, 1, ((v1, 0),))]
    assert team_plan(problem, Draft(problem, routes, knot).visits()) is None
    assert team_plan(problem, Draft(problem, routes, knot[:1]).visits()) is not None


def test_the_model_with_timing_has_no_solution_for_a_circle_of_drops() -> None:
    problem = build_problem(square())
    v0, v1 = (problem.nodes.index(node) for node in ("v0", "v1"))
    depot, n = problem.nodes.index("d0"), len(problem.nodes)
    for timed in (False, True):
        model = TeamModel(problem)
        if timed:
            add_timing(model, horizon_s(problem))
        columns = model.columns
        used = [
            columns.x[0][depot, v1], columns.x[0][v1, v0], columns.x[0][v0, n + depot],
            columns.x[1][depot, v0], columns.x[1][v0, v1], columns.x[1][v1, n + depot],
            columns.delta[0, 1, v0], columns.delta[1, 0, v1],
        ]  # fmt: skip
        for column in used:
            model.linear.row([(column, 1.0)], lower=1.0)
        assert model.linear.solve(FOREVER, gap=1e-4).status == ("infeasible" if timed else "optimal")


@settings(max_examples=15, deadline=None, derandomize=True)
@given(seeds)
def test_a_plan_survives_the_way_into_the_model_and_into_a_draft(seed: int) -> None:
    mission = tiny_mission(seed, candidates=3)
    state = part_way(mission, seed) if seed % 2 else initial_state(mission)
    problem = build_problem(mission, state)
    team = Improver(problem, seed).construct()
    if team is None:
        return
    team = Improver(problem, seed).improve(team, 30, FOREVER)
    assert draft_of(problem, team).visits() == team.routes
    point = start_point(TeamModel(problem), team)
    assert point is not None
    assert read_routes(TeamModel(problem), point) == team.routes


def test_a_start_point_is_accepted_by_every_row() -> None:
    mission = square()
    problem = build_problem(mission)
    result = solve_exact(problem, Search(FOREVER, 1e-6))
    assert result.team is not None
    model = TeamModel(problem)
    point = start_point(model, result.team)
    assert point is not None
    assert model.add_cuts(point) == 0
    model.linear.objective([])
    for column, value in enumerate(point):
        model.linear.row([(column, 1.0)], value - 1e-6, value + 1e-6)
    assert model.linear.solve_relaxed(FOREVER).status == "optimal"


def test_what_cannot_appear_is_left_out() -> None:
    near = build_problem(square(energy_budget_j=1.0))
    assert [robot.stops for robot in near.robots] == [(), ()]
    far = build_problem(square())
    assert all(len(robot.stops) == 2 for robot in far.robots)
    idle = build_problem(square(samples_per_node=0), handoffs=False)
    assert [robot.stops for robot in idle.robots] == [(), ()]


def test_an_idle_stop_is_left_out_of_a_route() -> None:
    problem = build_problem(square())
    v0, depot = problem.nodes.index("v0"), problem.nodes.index("d0")
    draft = Draft(problem, [[depot, v0, depot], [depot, depot]], [])
    draft.tidy()
    assert draft.routes[0] == [depot, depot]
    assert draft.visits() == ((Visit(depot),), (Visit(depot),))


def test_ruin_and_recreate_is_reproducible_and_never_worse() -> None:
    problem = build_problem(tiny_mission(6, candidates=4, samples_per_node=1))
    start = Improver(problem, 0).construct()
    assert start is not None
    once, again = (Improver(problem, 5).improve(start, 60, FOREVER) for _ in range(2))
    assert once.routes == again.routes
    assert once.rank < start.rank
    assert Improver(problem, 5).improve(start, 60, replace(FOREVER, cancelled=lambda: True)) is start
