"""The master never excludes a plan, and never says more of its J than is true."""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np
import pytest
from brute_force import optimum
from random_missions import part_way, tiny_mission
from team_cases import alike, as_scheduled, listed, lowest, nothing_forbidden, scaled, some_teams

from malipp_field.mission import Mission, TeamState
from malipp_field.planner.exact.branching import (
    Count,
    Decision,
    Level,
    Operation,
    only,
    options,
    sides,
    split_levels,
)
from malipp_field.planner.exact.columns import Branch
from malipp_field.planner.exact.master import Master
from malipp_field.planner.exact.schedules import Codes

_MISSIONS: dict[str, tuple[Mission, TeamState | None]] = {
    "two robots": (tiny_mission(202, candidates=2), None),
    "two samples": (tiny_mission(14, candidates=2, samples_per_node=2, payload_capacity=2), None),
    "one robot": (tiny_mission(41, robots=1, candidates=4), None),
    "part-way": (tiny_mission(60, candidates=2), part_way(tiny_mission(60, candidates=2), 60)),
    "part-way too": (tiny_mission(62, candidates=2), part_way(tiny_mission(62, candidates=2), 62)),
    "alike": (alike(3), None),
    "alike, two samples": (alike(5, candidates=2, samples_per_node=2), None),
    "long ways": (alike(8, candidates=3, energy_budget_j=30.0, payload_capacity=1), None),
}


@functools.cache
def truth(name: str) -> float:
    """Return the least J of all plans, in the units of the master."""
    mission, state = _MISSIONS[name]
    best = optimum(mission, state)
    assert best is not None
    return best[0] / scaled(mission, state)[1]


def random_decision(rng: np.random.Generator, master: Master) -> Decision:
    """Return something to branch on, whether a point asks for it or not."""
    kind = int(rng.integers(5))
    if kind == 0 and master.n:
        keys = sorted(master.n)
        return Count(keys[int(rng.integers(len(keys)))], int(rng.integers(2)))
    own = [(i, s) for i, levels in enumerate(master.z) for s in range(len(levels))]
    if kind == 1 and own:
        i, s = own[int(rng.integers(len(own)))]
        counts = tuple((k, n) for k, n in enumerate(master.z[i][s][0]) if (k, i) in master.n)
        return Level((i, s), counts)
    r = int(rng.integers(len(master.robots)))
    robot, t = master.robots[r], int(rng.integers(1, 3))
    hit = (robot.exchange_of <= -t, robot.exchange_of >= t, robot.taken_of >= t)[kind % 3]
    return Operation(r, int(rng.integers(len(robot.places))), hit, kind % 3 == 0)


def leaves(rng: np.random.Generator, master: Master, branch: Branch, depth: int) -> list[Branch]:
    """Return the leaves of a random tree."""
    if not depth:
        return [branch]
    both = sides(master.robots, branch, random_decision(rng, master))
    return [leaf for side in both for leaf in leaves(rng, master, side, depth - 1)]


def counts_of(master: Master, chosen: list[Codes]) -> dict[tuple[int, int], int]:
    """Return samples by class and position in V."""
    counts: dict[tuple[int, int], int] = {}
    for r, (robot, codes) in enumerate(zip(master.robots, chosen, strict=True)):
        for w, n in enumerate(robot.taken_of[codes + robot.capacity].tolist()):
            if n:
                key = (master.class_of[r], master.position[robot.places[w]])
                counts[key] = counts.get(key, 0) + n
    return counts


@pytest.mark.parametrize("name", _MISSIONS)
def test_the_root_never_exceeds_the_optimum(name: str) -> None:
    problem, _ = scaled(*_MISSIONS[name])
    for robots in (listed(problem), None):
        master = Master(problem, robots or listed(problem))
        bound, point = lowest(master, nothing_forbidden(master.robots))
        assert point is not None
        assert 0.3 * truth(name) < bound <= truth(name) * (1 + 1e-8)


@pytest.mark.parametrize("name", _MISSIONS)
def test_every_plan_is_a_point_with_its_own_j(name: str) -> None:
    problem, _ = scaled(*_MISSIONS[name])
    robots = listed(problem)
    master, good = Master(problem, robots), 0
    lowest(master, nothing_forbidden(robots))  # with the cuts of other points
    for chosen, team in some_teams(problem, robots, 150, seed=1):
        branch = nothing_forbidden(robots)
        for r, codes in enumerate(chosen):
            branch = only(branch, r, codes, robots[r].capacity)
        value, _ = lowest(master, branch)
        if team is not None and as_scheduled(robots, chosen, team):
            good += 1
            assert value == pytest.approx(team.information, rel=1e-6)
    assert good >= 2


@pytest.mark.parametrize("name", _MISSIONS)
def test_no_branching_loses_the_optimum(name: str) -> None:
    problem, _ = scaled(*_MISSIONS[name])
    rng = np.random.default_rng(4)
    master = Master(problem, listed(problem))
    for _ in range(4):
        bounds = [
            lowest(master, leaf, 15)[0] for leaf in leaves(rng, master, nothing_forbidden(master.robots), 3)
        ]
        assert min(bounds) <= truth(name) * (1 + 1e-8)


@pytest.mark.parametrize("name", ["two robots", "alike", "part-way"])
def test_priced_schedules_bound_as_listed_ones_do(name: str) -> None:
    problem, _ = scaled(*_MISSIONS[name])
    rng = np.random.default_rng(5)
    master, priced = Master(problem, listed(problem)), Master(problem, [
        replace(robot, pool=None) for robot in listed(problem)
    ])  # fmt: skip
    for _ in range(2):
        for leaf in leaves(rng, master, nothing_forbidden(master.robots), 2):
            bound, _ = lowest(priced, leaf, 15)
            # without listed schedules there are no rows of products: the bound may be lower, never higher
            assert bound <= lowest(master, leaf, 60)[0] + 1e-4
    for _ in range(4):
        tree = leaves(rng, priced, nothing_forbidden(priced.robots), 3)
        assert min(lowest(priced, leaf, 15)[0] for leaf in tree) <= truth(name) * (1 + 1e-8)


@pytest.mark.parametrize("name", ["alike", "alike, two samples", "long ways"])
def test_twins_spare_work_and_lose_nothing(name: str) -> None:
    problem, _ = scaled(*_MISSIONS[name])
    rng, spared = np.random.default_rng(6), 0
    master = Master(problem, listed(problem))
    assert master.robots[0].twins == (0, 1)
    single = [replace(robot, twins=(r,)) for r, robot in enumerate(master.robots)]
    for _ in range(6):
        decision = random_decision(rng, master)
        with_twins = sides(master.robots, nothing_forbidden(master.robots), decision)
        without = sides(single, nothing_forbidden(master.robots), decision)
        spared += sum(
            int(a.sum() > b.sum())
            for one, other in zip(with_twins, without, strict=True)
            for a, b in zip(one.forbidden, other.forbidden, strict=True)
        )
        bounds = [min(lowest(master, side)[0] for side in both) for both in (with_twins, without)]
        assert max(bounds) <= truth(name) * (1 + 1e-8)
    assert spared


@pytest.mark.parametrize("name", ["two robots", "two samples", "alike, two samples"])
def test_forbidding_counts_cuts_off_just_those_and_more(name: str) -> None:
    problem, _ = scaled(*_MISSIONS[name])
    robots = listed(problem)
    teams = [
        (chosen, team)
        for chosen, team in some_teams(problem, robots, 200, seed=2)
        if team is not None and as_scheduled(robots, chosen, team)
    ]
    counted = (counts_of(Master(problem, robots), chosen) for chosen, _ in teams)
    reference = next(counts for counts in counted if counts)
    master, cut_off = Master(problem, robots), 0
    master.forbid(reference)
    for chosen, team in teams[:30]:
        branch = nothing_forbidden(robots)
        for r, codes in enumerate(chosen):
            branch = only(branch, r, codes, robots[r].capacity)
        value, point = lowest(master, branch)
        counts = counts_of(master, chosen)
        if all(counts.get(key, 0) >= n for key, n in reference.items()):
            cut_off += 1
            # whole counts may still be made up of several levels, which is for branching to decide
            assert value == np.inf or (point is not None and split_levels(master, point))
        else:
            assert value == pytest.approx(team.information, rel=1e-6)
    assert 0 < cut_off < len(teams[:30])


def test_a_fractional_point_has_something_to_branch_on() -> None:
    seen = 0
    for mission, state in _MISSIONS.values():
        problem, _ = scaled(mission, state)
        master = Master(problem, listed(problem))
        root = nothing_forbidden(master.robots)
        bound, point = lowest(master, root)
        assert point is not None
        parts = {r: master.used(point, r, 1e-6) for r in range(len(master.robots))}
        if all(len(own) == 1 for own in parts.values()):
            continue
        seen += 1
        decisions = options(master, point, parts)
        assert decisions
        for side in sides(master.robots, root, decisions[0]):
            assert lowest(master, side)[0] >= bound - 1e-6
            _, there = lowest(master, side)
            assert there is None or not np.allclose(
                there.x[: len(point.x)], point.x[: len(there.x)], atol=1e-7
            )
    assert seen
