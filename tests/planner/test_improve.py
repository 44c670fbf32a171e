"""Ruin and recreate: every plan out is verified, never worse, the same for a seed however it is split."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from brute_force import optimum
from random_missions import part_way, tiny_mission

from malipp_field.bench.instances import Specification, build
from malipp_field.mission import Mission, TeamState, initial_state, read_mission
from malipp_field.planner import verify
from malipp_field.planner.draft import COLLECTED, Draft, Sample, draft_of
from malipp_field.planner.extract import TeamPlan, Verdict, leg_energies, payloads, plan_file, team_plan
from malipp_field.planner.linear import Effort
from malipp_field.planner.problem import Problem, build_problem
from malipp_field.planner.search.improver import Improver
from malipp_field.planner.search.kernel import FAILED, Kernel
from malipp_field.planner.search.state import State, case_of, load, most_samples, unloaded

FOREVER = Effort(deadline=math.inf)
CORRIDOR = Path(__file__).parents[2] / "missions" / "corridor.yaml"


def case(seed: int, **changes: Any) -> tuple[Mission, TeamState]:
    """Return a mission of 2 to 4 robots, for every odd seed part-way."""
    mission = tiny_mission(seed, robots=2 + seed % 3, candidates=3 + seed % 5, **changes)
    return mission, part_way(mission, seed) if seed % 2 else initial_state(mission)


def verified(mission: Mission, problem: Problem, team: TeamPlan, state: TeamState) -> TeamPlan:
    plan = plan_file(mission.name, problem, team, Verdict("exact", "feasible", None, None, 0.0, 0, 1))
    assert not verify(mission, plan, state)
    return team


def state_of(problem: Problem, team: TeamPlan) -> State:
    """Return a plan as the kernel sees it."""
    case_, draft = case_of(problem), draft_of(problem, team)
    hops = max((len(sample.hops) for sample in draft.samples), default=2)
    kernel = Kernel(case_, most_samples(problem, case_), hops, 0)
    load(kernel.best, draft)
    assert kernel.begin()
    return kernel.best


@pytest.mark.parametrize("block", range(6))
def test_every_plan_is_verified_and_never_worse(block: int) -> None:
    for seed in range(400 + 12 * block, 412 + 12 * block):
        mission, state = case(seed)
        closed = ("v1",) if seed % 11 == 0 else ()
        problem = build_problem(mission, state, handoffs=seed % 7 != 0, closed=closed)
        improver = Improver(problem, seed)
        team = improver.construct()
        if team is None:
            continue
        for iterations in (1, 10, 150):
            found = improver.improve(verified(mission, problem, team, state), iterations, FOREVER)
            assert found.rank <= team.rank
            team = found
        drops = {visit.node for route in team.routes for visit in route if visit.drop}
        assert not drops & problem.closed
        assert problem.handoffs or not drops
        verified(mission, problem, team, state)


@pytest.mark.parametrize("size", [(2, 10), (4, 14), (6, 18)])
def test_benchmark_instances_are_improved_and_verified(size: tuple[int, int]) -> None:
    mission = build(Specification(*size, seed=1), 30.0)
    problem = build_problem(mission)
    improver = Improver(problem, 3)
    bare = improver.construct()
    assert bare is not None
    team = verified(mission, problem, improver.improve(bare, 300, FOREVER), initial_state(mission))
    assert team.information < 0.8 * bare.information
    assert improver.improve(team, 200, FOREVER).rank <= team.rank


def test_a_long_call_and_many_short_ones_find_the_same() -> None:
    problem = build_problem(build(Specification(4, 14, seed=2), 25.0))
    start = Improver(problem, 0).construct()
    assert start is not None
    long = Improver(problem, 5).improve(start, 1200, FOREVER)
    improver, short = Improver(problem, 5), start
    for iterations in (1, 199, 400, 600):
        short = improver.improve(short, iterations, FOREVER)
    assert short.routes == long.routes
    once, other = (Improver(problem, seed).improve(start, 1, FOREVER) for seed in (5, 6))
    assert once.routes != other.routes


def test_nothing_is_done_when_time_is_up() -> None:
    problem = build_problem(tiny_mission(6, candidates=4, samples_per_node=1))
    improver = Improver(problem, 0)
    start = improver.construct()
    assert start is not None
    assert improver.improve(start, 1000, replace(FOREVER, cancelled=lambda: True)) is start
    assert improver.improve(start, 1000, Effort(deadline=-math.inf)) is start


def test_a_better_plan_from_elsewhere_is_taken_up() -> None:
    problem = build_problem(build(Specification(3, 12, seed=0), 25.0))
    start = Improver(problem, 0).construct()
    assert start is not None
    good = Improver(problem, 1).improve(start, 800, FOREVER)
    improver = Improver(problem, 2)
    early = improver.improve(start, 1, FOREVER)
    assert good.rank < early.rank
    assert improver.improve(good, 1, FOREVER).rank <= good.rank
    # from now on it knows the better plan, whatever it is given
    assert improver.improve(start, 1, FOREVER).rank <= good.rank


def test_the_corridor_is_solved_within_ten_thousand_iterations() -> None:
    mission = read_mission(CORRIDOR)
    problem = build_problem(mission)
    for seed in range(3):
        improver = Improver(problem, seed)
        team = improver.construct()
        assert team is not None
        team = improver.improve(team, 2000, FOREVER)
        assert verified(mission, problem, team, initial_state(mission)).information < 1.82118


@pytest.mark.parametrize("seed", [0, 1, 2, 3, 10, 11, 40, 41, 44])
def test_tiny_missions_are_solved_within_ten_thousand_iterations(seed: int) -> None:
    robots = 1 if seed >= 40 else 2
    mission = tiny_mission(seed, robots=robots, candidates=4 if seed >= 40 else 2 + seed % 2)
    truth = optimum(mission)
    problem = build_problem(mission)
    improver = Improver(problem, seed)
    team = improver.construct()
    assert (team is None) == (truth is None)
    if team is not None and truth is not None:
        found = improver.improve(team, 10_000, FOREVER)
        assert (found.information, found.energy_j) == pytest.approx(truth, rel=1e-6, abs=1e-6)


@pytest.mark.parametrize("seed", [60, 61, 62, 63, 65, 66, 67, 69])
def test_tiny_missions_part_way_are_solved_within_ten_thousand_iterations(seed: int) -> None:
    mission = tiny_mission(seed, candidates=2)
    state = part_way(mission, seed)
    truth = optimum(mission, state)
    problem = build_problem(mission, state)
    improver = Improver(problem, seed)
    team = improver.construct()
    assert (team is None) == (truth is None)
    if team is not None and truth is not None:
        found = improver.improve(team, 10_000, FOREVER)
        assert (found.information, found.energy_j) == pytest.approx(truth, rel=1e-6, abs=1e-6)


def test_a_full_robot_unloads_on_its_way_to_what_lies_elsewhere() -> None:
    mission = tiny_mission(81, robots=2, candidates=4)
    state = part_way(mission, 81)  # both robots are full, and one sample waits in a drop
    problem = build_problem(mission, state)
    team = Improver(problem, 0).construct()
    assert team is not None
    verified(mission, problem, team, state)
    assert sum(sum(visit.fetch.values()) for route in team.routes for visit in route) == 1


@pytest.mark.parametrize("seed", range(430, 442))
def test_loads_energies_order_and_j_are_those_of_the_plan(seed: int) -> None:
    mission, begin = case(seed, energy_budget_j=30.0)
    problem = build_problem(mission, begin)
    improver = Improver(problem, seed)
    team = improver.construct()
    if team is None:
        return
    team = improver.improve(team, 200, FOREVER)
    state = state_of(problem, team)
    assert unloaded(problem, state).visits() == team.routes
    assert state.value[0] == pytest.approx(team.information, rel=1e-9)
    for r, (robot, route) in enumerate(zip(problem.robots, team.routes, strict=True)):
        stops = len(route) - 1
        assert state.energy_j[r] == pytest.approx(sum(leg_energies(problem, robot, route)), rel=1e-12)
        assert state.depart[r, :stops].tolist() == payloads(robot, route)[:-1]
        alphas = [robot.closure.energy_per_kg[a.node, b.node] for a, b in pairwise(route)]
        assert state.cum[r, : stops + 1] == pytest.approx([0.0, *np.cumsum(alphas)])
        for k in range(stops):
            unload = next(i for i in range(k + 1, stops + 1) if i == stops or route[i].node in robot.depots)
            assert state.unload[r, k] == unload
            assert state.clock[r, k, r] == k
            for sender in route[k].pick:
                assert state.clock[r, k, sender] >= state.pos[sender, route[k].node] >= 0


def test_drops_in_a_circle_are_no_plan_for_the_kernel() -> None:
    robot: dict[str, Any] = {"start": "d0", "depots": ["d0"], "energy_budget_j": 99.0, "samples_per_node": 1}
    problem = build_problem(tiny_mission(1, candidates=2, payload_capacity=2, **robot))
    v0, v1, depot = (problem.nodes.index(node) for node in ("v0", "v1", "d0"))
    routes = [[depot, v1, v0, depot], [depot, v0, v1, depot]]
    knot = [(v0, 0, ((v0, 1),)), (v1, 1, ((v1, 0),))]
    case_ = case_of(problem)
    for count in (1, 2):
        draft = Draft(problem, routes, [Sample(COLLECTED, *way) for way in knot[:count]])
        kernel = Kernel(case_, most_samples(problem, case_), 2, 0)
        load(kernel.best, draft)
        assert kernel.begin() == (count == 1)
        assert (team_plan(problem, draft.visits()) is not None) == (count == 1)


def test_hardly_an_iteration_fails_where_nothing_must_come_home() -> None:
    problem = build_problem(build(Specification(4, 14, seed=1), 25.0))
    improver = Improver(problem, 1)
    start = improver.construct()
    assert start is not None
    improver.improve(start, 500, FOREVER)
    assert improver._kernel.counters[FAILED] == 0
