"""What the tree decides on: samples of a class at a candidate, or what one robot does at a place."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from malipp_field.planner.exact.columns import Branch, Point
from malipp_field.planner.exact.master import Master
from malipp_field.planner.exact.schedules import Codes, Robot

INTEGRAL = 1e-6
"""Shares that differ from a whole number by no more are whole."""

Parts = Mapping[int, Sequence[tuple[float, Codes]]]
"""Schedules in use with their shares, by robot."""


@dataclass(frozen=True)
class Count:
    """Samples of a class at a candidate: at most ``floor``, or more; ``key`` is (class, position in V)."""

    key: tuple[int, int]
    floor: int


@dataclass(frozen=True)
class Level:
    """Whether a candidate has this level; ``key`` is (position in V, selector).

    ``counts`` are its samples of each class that can sample there.
    """

    key: tuple[int, int]
    counts: tuple[tuple[int, int], ...]


@dataclass(frozen=True)
class Operation:
    """Whether the robot's code at a place is one of ``codes`` (array of bool, shape (C,))."""

    robot: int
    place: int
    codes: NDArray[np.bool_]
    drops: bool


Decision = Count | Level | Operation


def options(master: Master, point: Point, parts: Parts) -> list[Decision]:
    """Return decisions that a fractional point does not keep, the most open first."""
    found: list[tuple[float, Decision]] = []
    for key, n in master.n.items():
        value = float(point.x[n])
        part = value - np.floor(value)
        if INTEGRAL < part < 1 - INTEGRAL:
            found.append((1.2 * min(part, 1 - part), Count(key, int(np.floor(value)))))
    for r, own in parts.items():
        if len(own) > 1:
            found += _operations(r, master.robots[r], own)
    found.sort(key=lambda option: -option[0])
    return [decision for _, decision in found] or [
        Level((i, s), tuple((k, n) for k, n in enumerate(master.z[i][s][0]) if (k, i) in master.n))
        for i, s in split_levels(master, point)
    ]


def _operations(r: int, robot: Robot, own: Sequence[tuple[float, Codes]]) -> list[tuple[float, Decision]]:
    shares = np.array([share for share, _ in own])
    codes = np.array([codes for _, codes in own]) + robot.capacity
    found: list[tuple[float, Decision]] = []
    for t in range(1, robot.capacity + 1):
        for kind, weight, hit in (
            ("drop", 1.0, robot.exchange_of <= -t),
            ("pick", 0.9, robot.exchange_of >= t),
            ("take", 0.7, robot.taken_of >= t),
        ):
            for w, part in enumerate(shares @ hit[codes]):
                if INTEGRAL < part < shares.sum() - INTEGRAL:
                    score = weight * min(float(part), 1.0 - float(part)) / t**0.5
                    found.append((score, Operation(r, w, hit, kind == "drop")))
    return found


def split_levels(master: Master, point: Point) -> list[tuple[int, int]]:
    """Return candidates whose whole counts are made up of several levels, with the level of those counts."""
    split = []
    for i, own in enumerate(master.z):
        if not any(INTEGRAL < point.x[z] < 1 - INTEGRAL for _, z in own):
            continue
        counts = tuple(
            round(float(point.x[master.n[k, i]])) if (k, i) in master.n else 0
            for k in range(len(master.classes))
        )
        split += [(i, s) for s, (levels, _) in enumerate(own) if levels == counts]
    return split


def sides(robots: Sequence[Robot], branch: Branch, decision: Decision) -> list[Branch]:
    """Return the sides of a decision: together they leave nothing out."""
    if isinstance(decision, Count):
        lower, upper = branch.counts.get(decision.key, (0.0, np.inf))
        floor = float(decision.floor)
        return [
            replace(branch, counts=branch.counts | {decision.key: bounds})
            for bounds in ((lower, floor), (floor + 1.0, upper))
        ]
    if isinstance(decision, Level):
        return _level_sides(branch, decision)
    r, w = decision.robot, decision.place
    exact = branch.exact_load | {r} if decision.drops else branch.exact_load
    without = _forbid(branch, twins(robots, branch, r), w, decision.codes)
    return [without, replace(_forbid(branch, [r], w, ~decision.codes), exact_load=exact)]


def _level_sides(branch: Branch, decision: Level) -> list[Branch]:
    """Return the side with the level, and for each class those with fewer and with more samples."""
    i, _ = decision.key
    bounds = [
        ((k, i), side)
        for k, count in decision.counts
        for lower, upper in [branch.counts.get((k, i), (0.0, np.inf))]
        for side in ((lower, count - 1.0), (count + 1.0, upper))
        if side[0] <= side[1]
    ]
    return [
        replace(branch, levels=branch.levels | {decision.key: (1.0, 1.0)}),
        *(replace(branch, counts=branch.counts | {key: side}) for key, side in bounds),
    ]


def twins(robots: Sequence[Robot], branch: Branch, r: int) -> list[int]:
    """Return the robots that could stand in for r at this node (orbital branching).

    If one of them does what is decided on, r may as well be the one: on the other side none of them does.
    """
    return [
        o for o in robots[r].twins
        if np.array_equal(branch.forbidden[o], branch.forbidden[r])
        and (o in branch.exact_load) == (r in branch.exact_load)
    ]  # fmt: skip


def only(branch: Branch, r: int, codes: Codes, capacity: int) -> Branch:
    """Return the branch with the schedule of robot r fixed."""
    forbidden = [own.copy() if k == r else own for k, own in enumerate(branch.forbidden)]
    forbidden[r][:] = True
    forbidden[r][np.arange(len(codes)), codes + capacity] = False
    return replace(branch, forbidden=forbidden, exact_load=branch.exact_load | {r})


def _forbid(branch: Branch, team: Sequence[int], w: int, codes: NDArray[np.bool_]) -> Branch:
    forbidden = [own.copy() if k in team else own for k, own in enumerate(branch.forbidden)]
    for r in team:
        forbidden[r][w] |= codes
    return replace(branch, forbidden=forbidden)
