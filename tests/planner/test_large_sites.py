"""What large sites need: compiled closures equal to the others, shared closures, a quick bound that holds."""

from __future__ import annotations

import math
import random
from itertools import pairwise

import numpy as np
import pytest
from brute_force import optimum
from random_missions import part_way, tiny_mission

from malipp_field.bench.instances import Specification, build
from malipp_field.mission import Passage, drives_alike, initial_state, passages
from malipp_field.planner import closure as closures
from malipp_field.planner.bounds.quick import quick_bound
from malipp_field.planner.closure import Closure, closure
from malipp_field.planner.linear import Effort
from malipp_field.planner.problem import build_problem
from malipp_field.planner.search.improver import Improver

FOREVER = Effort(deadline=math.inf)


def roads(seed: int) -> tuple[list[Passage], list[str]]:
    """Return random one-way edges with factors; nodes that cannot be reached, and ties, are among them."""
    rng = random.Random(seed)
    nodes = [f"n{i}" for i in range(rng.randint(2, 25))]
    found = []
    for tail in nodes:
        for head in nodes:
            if tail != head and rng.random() < 0.2:
                length = float(rng.randint(1, 4))
                factor, speed = rng.choice([1.0, 1.0, 1.5]), rng.choice([0.5, 1.0, 2.0])
                found.append(Passage(tail, head, length, 0.1 * length * factor, length / speed))
    return found, nodes


def both_ways(seed: int, monkeypatch: pytest.MonkeyPatch) -> tuple[Closure, Closure, list[Passage]]:
    edges, nodes = roads(seed)
    terminals = sorted(random.Random(seed).sample(range(len(nodes)), max(1, len(nodes) * 2 // 3)))
    monkeypatch.setattr(closures, "_MANY", math.inf)
    plain = closure(edges, nodes, terminals)
    monkeypatch.setattr(closures, "_MANY", -1)
    return plain, closure(edges, nodes, terminals), edges


@pytest.mark.parametrize("seed", range(40))
def test_the_compiled_closure_is_the_same(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    plain, compiled, edges = both_ways(seed, monkeypatch)
    assert compiled.energy_per_kg == pytest.approx(plain.energy_per_kg, rel=1e-12)
    assert compiled.time_s == pytest.approx(plain.time_s, rel=1e-12)
    assert len(compiled.paths) == len(plain.paths)
    assert set(compiled.paths) == set(plain.paths)
    energy = {(p.tail, p.head): p.energy_per_kg for p in edges}
    time = {(p.tail, p.head): p.time_s for p in edges}
    for (u, v), path in compiled.paths.items():
        assert (path[0], path[-1]) == (plain.paths[u, v][0], plain.paths[u, v][-1])
        assert sum(energy[step] for step in pairwise(path)) == pytest.approx(compiled.energy_per_kg[u, v])
        assert sum(time[step] for step in pairwise(path)) == pytest.approx(compiled.time_s[u, v])


def test_a_way_that_does_not_exist_has_no_path(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(closures, "_MANY", -1)
    found = closure([Passage("a", "b", 1.0, 1.0, 1.0)], ["a", "b"], [0, 1])
    assert found.paths[0, 1] == ("a", "b")
    assert found.paths[0, 0] == ("a",)
    assert (1, 0) not in found.paths


def test_robots_that_drive_alike_have_their_closure_in_common() -> None:
    text = build(Specification(4, 14, seed=0), 30.0).model_dump(mode="json", by_alias=True)
    text["site"]["edges"][3]["closed_to"] = ["r1"]
    text["site"]["edges"][5]["energy_factor"] = {"r2": 2.0}
    text["team"]["robots"][3]["speed_m_s"] = 2.0
    mission = type(build(Specification(2, 5), 1.0)).model_validate(text)
    assert drives_alike(mission) == [("r0",), ("r1",), ("r2",), ("r3",)]
    text["site"]["edges"][3]["closed_to"] = ["r1", "r0"]
    text["site"]["edges"][5]["energy_factor"] = {}
    mission = type(mission).model_validate(text)
    assert drives_alike(mission) == [("r0", "r1"), ("r2",), ("r3",)]
    for group in drives_alike(mission):
        assert all(passages(mission, robot) == passages(mission, group[0]) for robot in group)
    one, other, *_ = build_problem(mission).robots
    assert one.closure is other.closure


@pytest.mark.parametrize("seed", [s for s in range(31) if s != 9])  # of 9 brute force takes minutes
def test_the_quick_bound_is_never_above_the_optimum(seed: int) -> None:
    mission = tiny_mission(seed, robots=1 + seed % 2, candidates=2 + seed % 2)
    state = part_way(mission, seed) if seed % 3 == 0 else initial_state(mission)
    problem = build_problem(mission, state)
    bound = quick_bound(problem, FOREVER)
    truth = optimum(mission, state)
    assert (
        0.0
        <= bound
        <= (problem.information.value(problem.gained) if truth is None else truth[0]) * (1 + 1e-9)
    )
    assert truth is not None or seed % 3 == 0


@pytest.mark.parametrize(("size", "budget_j"), [((4, 14), 15.0), ((6, 18), 25.0), ((8, 31), 30.0)])
def test_the_quick_bound_is_below_good_plans_and_above_what_all_samples_give(
    size: tuple[int, int], budget_j: float
) -> None:
    problem = build_problem(build(Specification(*size, seed=2), budget_j))
    improver = Improver(problem, 0)
    start = improver.construct()
    assert start is not None
    bound = quick_bound(problem, FOREVER)
    assert bound <= improver.improve(start, 500, FOREVER).information
    everything = np.zeros(len(problem.candidates))
    position = {v: i for i, v in enumerate(problem.candidates)}
    for robot in problem.robots:
        for v in set(robot.places) & set(position):
            everything[position[v]] += robot.limits[v] * robot.precision
    assert bound > problem.information.value(everything)


def test_the_quick_bound_needs_no_time() -> None:
    problem = build_problem(build(Specification(4, 14, seed=0), 20.0))
    assert 0.0 <= quick_bound(problem, Effort(deadline=-math.inf)) <= quick_bound(problem, FOREVER)
