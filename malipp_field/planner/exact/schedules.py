"""One robot's schedules: what it takes and exchanges where, in whatever order its energy allows.

A schedule is a vector of operation codes, one for each place (see `labels`). For J only these matter; the
order of the stops decides whether the energy suffices, and the cheapest order is found by labelling. What is
picked beyond what is dropped need not be picked, so exchanges are capabilities: `without_dominated`.
"""

from __future__ import annotations

from dataclasses import dataclass
from hashlib import sha256

import numpy as np
from numpy.typing import NDArray

from malipp_field.field import FloatArray
from malipp_field.planner.exact.labels import (
    Actor,
    complete_schedules,
    enumerate_labels,
    price_labels,
    scan,
    without_dominated,
)
from malipp_field.planner.problem import Problem

Codes = NDArray[np.int16]
Pairs = tuple[NDArray[np.int64], NDArray[np.int64], FloatArray]
"""Pairs of places (two arrays of shape (Q,)) and the value of any two codes there, shape (Q, C, C)."""

MOST_PLACES = 63
"""Places of a robot: those visited are the bits of one word."""
_FIRST_ROOM = 400_000
"""Labels allowed for listing all schedules of a robot outright."""
_SMALL_ROOM, _GROWTH = 10_000, 12
"""Labels allowed at first, and their growth: clearing room for a million takes longer than most lists."""
_PRICING_ROOM = 100_000
"""Labels allowed for pricing; with more it ends with a bound."""
_AT_ONCE = 40
"""Schedules handed to the master in one round, at most."""


@dataclass
class Pool:
    """All schedules of a robot that can be part of a better plan."""

    codes: Codes
    values: FloatArray


@dataclass
class Robot:
    """A robot's places, codes and, where they could be listed, its schedules.

    Attributes
    ----------
    places : tuple of int
        Nodes, the start first.
    capacity, samples
        K and the most samples at one place; there are C = (samples + 1) (2 K + 1) codes.
    """

    actor: Actor
    places: tuple[int, ...]
    precision: float
    capacity: int
    samples: int
    pool: Pool | None = None
    twins: tuple[int, ...] = ()
    """Robots, itself included, that could stand in for each other everywhere."""

    @property
    def width(self) -> int:
        """C."""
        return (self.samples + 1) * (2 * self.capacity + 1)

    @property
    def taken_of(self) -> NDArray[np.int64]:
        """Return a of every code, shape (C,)."""
        return np.arange(self.width) // (2 * self.capacity + 1)

    @property
    def exchange_of(self) -> NDArray[np.int64]:
        """Return h of every code, shape (C,)."""
        return np.arange(self.width) % (2 * self.capacity + 1) - self.capacity

    def list_all(
        self, gain: FloatArray, least: float, room: int = _FIRST_ROOM, *, dominated: bool = False
    ) -> bool:
        """List all schedules of value ``least`` or more, unless there are too many; tell whether it is done.

        Raises nothing: False says that more than ``room`` labels would be needed.
        """
        listed = self.listed(gain, least, room)
        if listed is None:
            return False
        found = listed[0]
        if not dominated:
            actor = self.actor
            found = found[without_dominated(found, self.capacity, actor.limits, actor.most_pick)]
        self.pool = self._pool(np.ascontiguousarray(found))
        return True

    def listed(self, gain: FloatArray, least: float, room: int) -> tuple[Codes, FloatArray] | None:
        """Return codes, shape (M, P), and least energies of schedules, None with more than ``room`` labels.

        All schedules of value ``least`` or more are among them; others may be.
        """
        tried = min(_SMALL_ROOM, room)
        while True:
            count, codes, mask, place, load, energy, _ = enumerate_labels(self.actor, gain, least, tried)
            if count >= 0:
                break
            if tried == room:
                return None
            tried = _GROWTH * tried if 2 * _GROWTH * tried < room else room
        label, spent = complete_schedules(self.actor, count, codes, mask, place, load, energy)
        return codes[label], spent

    def keep(self, least: float) -> None:
        """Forget schedules whose value at the last `price` was below ``least``."""
        if self.pool is not None:
            kept = self.pool.values >= least
            self.pool = self._pool(np.ascontiguousarray(self.pool.codes[kept]))

    def _pool(self, codes: Codes) -> Pool:
        return Pool(codes, np.zeros(len(codes)))

    def price(
        self, gain: FloatArray, pairs: Pairs,
        least: float, *, exact_load: bool,
    ) -> tuple[float, list[Codes]]:  # fmt: skip
        """Return an upper bound on the value of any schedule, and some that are worth more than ``least``.

        Parameters
        ----------
        gain : array, shape (P, C)
            Value of every code; minus infinity forbids it.
        pairs
            What two codes at two places are worth besides, never above zero (listed schedules only).
        exact_load
            See `labels.price_labels`.
        """
        if self.pool is not None:
            return self._scan(gain, pairs, least)
        most, found = self.price_anew(gain, least, exact_load=exact_load)
        return most, [codes for codes, _ in found]

    def price_anew(
        self, gain: FloatArray, least: float, *, exact_load: bool = False
    ) -> tuple[float, list[tuple[Codes, float]]]:
        """Return the same by labelling, whether schedules are listed or not, and the value of each found.

        Where there is a toll, the value is that of the order found, which need not be the cheapest.
        """
        must = sum(1 << w for w in range(len(self.places)) if gain[w, self.capacity] == -np.inf)
        rest, found, worths, code_of, place, parent = price_labels(
            self.actor, gain, np.uint64(must), exact_load, least, _PRICING_ROOM, 2 * _AT_ONCE
        )
        order = np.argsort(-worths, kind="stable")[:_AT_ONCE]
        chosen = [(self._codes(int(found[k]), code_of, place, parent), float(worths[k])) for k in order]
        return max(rest, float(worths.max(initial=least))), chosen

    def _scan(self, gain: FloatArray, pairs: Pairs, least: float) -> tuple[float, list[Codes]]:
        pool = self.pool
        assert pool is not None
        scan(pool.codes, self.capacity, gain, *pairs, least, pool.values)
        good = np.flatnonzero(pool.values > least)
        if good.size == 0:
            return max(least, float(pool.values.max(initial=-np.inf))), []
        if good.size > _AT_ONCE:
            good = good[np.argpartition(-pool.values[good], _AT_ONCE)[:_AT_ONCE]]
        return float(pool.values.max()), [pool.codes[k] for k in good]

    def _codes(self, label: int, code_of: Codes, place: Codes, parent: NDArray[np.int32]) -> Codes:
        codes = np.zeros(len(self.places), dtype=np.int16)
        while label >= 0:
            codes[place[label]] = code_of[label]
            label = int(parent[label])
        return codes

    def order(self, codes: Codes) -> tuple[list[int], float]:
        """Return the places of the cheapest route with these operations (depots included), and its energy."""
        gain = np.full((len(self.places), self.width), -np.inf)
        for w, code in enumerate(codes):
            gain[w, code + self.capacity] = 1.0 if code else 0.0
        room = 20_000
        while True:
            count, listed, mask, place, load, energy, parent = enumerate_labels(
                self.actor._replace(toll=0.0), gain, float(np.count_nonzero(codes)), room
            )
            if count >= 0:
                break
            room *= 8
        label, spent = complete_schedules(self.actor, count, listed, mask, place, load, energy)
        match = [k for k in range(len(label)) if (listed[label[k]] == codes).all()]
        assert match, "a schedule without an order"
        best = min(match, key=lambda k: float(spent[k]))
        route, at = [], int(label[best])
        while at >= 0:
            route.append(int(place[at]))
            at = int(parent[at])
        return route[::-1], float(spent[best])


def robots_of(problem: Problem) -> list[Robot]:
    """Return the team in the terms of the labelling."""
    robots = [_robot(problem, r) for r in range(len(problem.robots))]
    alike: dict[tuple[object, ...], list[int]] = {}
    prints = [_fingerprint(robot) for robot in robots]
    for r, fingerprint in enumerate(prints):
        alike.setdefault(fingerprint, []).append(r)
    for robot, fingerprint in zip(robots, prints, strict=True):
        robot.twins = tuple(alike[fingerprint])
    return robots


def _fingerprint(robot: Robot) -> tuple[object, ...]:
    """Return what is the same for robots that could stand in for each other; arrays as their digests."""
    parts = (sha256(np.asarray(part).tobytes()).digest() for part in robot.actor)
    return robot.places, robot.precision, *parts


def _robot(problem: Problem, r: int) -> Robot:
    view = problem.robots[r]
    places = view.places
    cost = np.ascontiguousarray(view.closure.energy_per_kg[np.ix_(places, places)])
    np.fill_diagonal(cost, 0.0)
    ends = view.closure.energy_per_kg
    home = np.array([
        min((ends[u, d] for d in view.depots if d != u or w == 0), default=np.inf)
        for w, u in enumerate(places)
    ])  # fmt: skip
    if view.start in view.depots:
        home[0] = 0.0
    depot = np.array([v in view.depots for v in places])
    stock = {v: sum(s.count for s in problem.stocks if s.node == v) for v in places}
    taken_over, handed_over = dict.fromkeys(places, 0), dict.fromkeys(places, 0)
    for o, other in enumerate(problem.robots):
        if o != r:
            for v in problem.shared(r, o):
                taken_over[v] += other.capacity
            for v in problem.shared(o, r):
                # who may unload at a node has no reason to leave something there for others
                handed_over[v] += 0 if v in other.depots else other.capacity
    most_drop = [0 if v in view.depots else min(view.capacity, taken_over[v]) for v in places]
    most_pick = [min(view.capacity, handed_over[v] + stock[v]) for v in places]
    limits = [min(int(view.limits[v]), view.capacity) for v in places]
    actor = Actor(
        cost=cost, home=home, empty_mass=float(view.empty_mass_kg), sample_mass=float(problem.sample_mass_kg),
        budget=float(view.budget_j), capacity=int(view.capacity), on_board=int(view.on_board),
        limits=np.array(limits, dtype=np.int64), most_drop=np.array(most_drop, dtype=np.int64),
        most_pick=np.array(most_pick, dtype=np.int64), depot=depot,
    )  # fmt: skip
    return Robot(actor, places, view.precision, int(view.capacity), max(limits))
