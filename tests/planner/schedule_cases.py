"""Robots for the labelling, their schedules listed by plain recursion, and gains as the master makes them.

No code is shared with the labelling: every order of stops and every operation is tried, idle stops included.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from malipp_field.planner.exact.labels import Actor

FloatArray = NDArray[np.float64]
Vector = tuple[int, ...]
"""Operation codes, less K, by place."""

_SLACK = 1e-9
_WIDTH = 2


def random_actor(seed: int, *, places: int = 4, capacity: int = 2, ties: bool = False) -> Actor:
    """Return a robot with one or two depots, the start sometimes one of them, at metric one-way costs.

    With ``ties`` all lengths and the budget are whole numbers, so that schedules use it up exactly.
    """
    rng = np.random.default_rng(seed)
    cost = _metric(rng, places, ties=ties)
    depot = np.zeros(places, dtype=np.bool_)
    depot[rng.choice(places, size=int(rng.integers(1, 3)), replace=False)] = True
    most_pick = rng.integers(0, capacity + 1, places)
    most_drop = np.where(depot, 0, rng.integers(0, capacity + 1, places))
    limits = np.where(depot, 0, rng.integers(0, _WIDTH, places))
    ends = np.flatnonzero(depot)
    home = np.array(
        [min((cost[u, d] for d in ends if d != u or u == 0), default=np.inf) for u in range(places)]
    )
    budget = float(rng.uniform(3.0, 9.0)) * cost.mean()
    return Actor(
        cost=cost, home=home, empty_mass=1.0, sample_mass=1.0 if ties else float(rng.choice([0.0, 0.5])),
        budget=float(round(budget)) if ties else budget, capacity=capacity,
        on_board=int(rng.integers(0, capacity + 1)) if seed % 2 else 0,
        limits=limits.astype(np.int64), most_drop=most_drop.astype(np.int64),
        most_pick=most_pick.astype(np.int64), depot=depot,
    )  # fmt: skip


def _metric(rng: np.random.Generator, places: int, *, ties: bool) -> FloatArray:
    if ties:
        cost = rng.integers(1, 4, (places, places)).astype(float)
    else:
        cost = rng.uniform(0.2, 4.0, (places, places))
    np.fill_diagonal(cost, 0.0)
    for k in range(places):
        cost = np.minimum(cost, cost[:, [k]] + cost[[k], :])
    return cost


def every_schedule(actor: Actor) -> dict[Vector, float]:
    """Return the least energy of every vector of operations that the robot can carry out."""
    found: dict[Vector, float] = {}
    for vector, energy in _extend(actor, [0], actor.on_board, 0.0, {}, actor.budget):
        found[vector] = min(energy, found.get(vector, np.inf))
    return found


def best_completion(actor: Actor, gain: FloatArray, at: int, load: int, energy: float) -> float:
    """Return the most that can still be gathered after what is done at a place; minus infinity if stuck."""
    best = -np.inf
    for vector, _ in _leave(actor, [at], load, 0.0, {}, energy):
        best = max(best, value_of(actor, gain, vector))
    return best


def value_of(actor: Actor, gain: FloatArray, vector: Vector) -> float:
    """Return the sum of the gains of a schedule's codes."""
    return float(sum(gain[w, code + actor.capacity] for w, code in enumerate(vector)))


def _extend(
    actor: Actor, route: list[int], load: int, energy: float, done: dict[int, int], budget: float
) -> Iterator[tuple[Vector, float]]:
    """Do something at the last stop of a route, then go on."""
    here = route[-1]
    for code, leaving in _operations(actor, here, load):
        yield from _leave(actor, route, leaving, energy, done | {here: code}, budget)


def _leave(
    actor: Actor, route: list[int], load: int, energy: float, done: dict[int, int], budget: float
) -> Iterator[tuple[Vector, float]]:
    """Drive home, or to any place that was not visited yet."""
    here, mass = route[-1], actor.empty_mass + actor.sample_mass * load
    for end in np.flatnonzero(actor.depot):
        spent = energy + actor.cost[here, end] * mass
        own_copy = end == here and here != 0
        if not own_copy and spent <= budget * (1 + _SLACK):
            yield tuple(done.get(w, 0) for w in range(len(actor.cost))), spent
    for v in range(1, len(actor.cost)):
        spent = energy + actor.cost[here, v] * mass
        if v not in route and spent <= budget * (1 + _SLACK):
            yield from _extend(actor, [*route, v], load, spent, done, budget)


def _operations(actor: Actor, here: int, load: int) -> Iterator[tuple[int, int]]:
    """Yield the code less K of what can be done at a place, and the load afterwards."""
    K = actor.capacity
    for taken in range(actor.limits[here] + 1):
        unloaded = load + taken if actor.depot[here] else 0
        if load + taken > K + unloaded:  # the paper's capacity: before anything is dropped
            continue
        left = load + taken - unloaded
        for exchange in range(-min(left, actor.most_drop[here]), actor.most_pick[here] + 1):
            if left + exchange <= K:
                yield taken * (2 * K + 1) + exchange, left + exchange


def codes_wide(actor: Actor) -> int:
    """Return C."""
    return _WIDTH * (2 * actor.capacity + 1)


def free_gain(rng: np.random.Generator, actor: Actor) -> FloatArray:
    """Return gains of any sign, zero for idleness."""
    gain = rng.normal(0.0, 1.0, (len(actor.cost), codes_wide(actor)))
    gain[:, actor.capacity] = 0.0
    return gain


def master_gain(rng: np.random.Generator, actor: Actor, *, samples_pay: bool = False) -> FloatArray:
    """Return gains as a master makes them: dearer to drop more, never worse to pick more.

    Some are zero, as where nobody asks for a pick. With ``samples_pay`` no sample is worth less than none.
    """
    places, K = len(actor.cost), actor.capacity
    pick = np.cumsum(rng.exponential(0.5, (places, K)) * (rng.random((places, K)) < 0.5), axis=1)
    drop = np.cumsum(rng.exponential(0.3, (places, K)) * (rng.random((places, K)) < 0.7), axis=1)
    exchange = np.concatenate([-drop[:, ::-1], np.zeros((places, 1)), pick], axis=1)
    taken = rng.normal(0.6, 1.0, (places, _WIDTH)) * (rng.random((places, _WIDTH)) < 0.8)
    taken[:, 0] = 0.0
    if samples_pay:
        taken = np.abs(taken)
    return np.asarray((taken[:, :, None] + exchange[:, None, :]).reshape(places, -1))


def exchange_of(actor: Actor) -> NDArray[np.int64]:
    """Return h of every code."""
    return np.arange(codes_wide(actor)) % (2 * actor.capacity + 1) - actor.capacity


def taken_of(actor: Actor) -> NDArray[np.int64]:
    """Return a of every code."""
    return np.arange(codes_wide(actor)) // (2 * actor.capacity + 1)
