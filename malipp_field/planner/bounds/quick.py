"""A proven lower bound on J within seconds, for teams of any size (docs/planning.md, section 9).

J is convex, so it lies above its tangent at any point q; what is left is to bound the precision that a team
could gain, each candidate counted with its slope. Kept of all rules are these: what a robot spends on the
ways to and from its stops is within its budget, and so is, for the team, that together with what it takes to
carry every sample to the nearest depot. The point q comes from the method of Frank and Wolfe: the tangent
there bounds J over that same relaxation nearly as well as any.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from malipp_field.field import FloatArray
from malipp_field.planner.linear import Effort
from malipp_field.planner.problem import IntArray, Problem, RobotView

_MOST_PAIRS = 10_000
"""Pairs of places, of all robots, up to which the cone relaxation takes seconds and some hundred megabytes.
Its time grows faster than their number, and from about here on it is the weaker bound of the two."""
_ROUNDS = 20
_TRIALS = 40
"""Prices of energy that are tried in each round."""
_BUDGET_SLACK = 3e-6
"""The verifier forgives a millionth of a budget; the bound must hold for those plans too."""
_FREE_J = 1e-12
"""Visits that take no more than this count as free."""
_ROUNDING = 1e-9
"""Share of the prior J taken off the bound for rounding errors of its evaluation."""


@dataclass(frozen=True)
class _Reach:
    """What one robot could sample, and at what expense at least.

    Attributes
    ----------
    candidates : array, shape (k,)
        Positions in V.
    most : array, shape (k,)
        Samples it may take there.
    visit_j, carriage_j : array, shape (k,)
        Energy of a visit by the empty robot, and to bring one sample from there to a depot, by anybody.
    """

    candidates: IntArray
    most: FloatArray
    visit_j: FloatArray
    carriage_j: FloatArray
    budget_j: float
    precision: float


def is_relaxable(problem: Problem) -> bool:
    """Tell whether the cone relaxation (`relaxation`) is of use for such a team."""
    return sum(len(robot.places) ** 2 for robot in problem.robots) <= _MOST_PAIRS


def quick_bound(problem: Problem, effort: Effort) -> float:
    """Return a lower bound on J (`eq:llse_objective`) of every plan of a problem, with or without handoffs.

    It is valid whenever the effort ends.
    """
    information, gained = problem.information, problem.gained
    reaches = _reaches(problem)
    point, best = gained.copy(), 0.0
    for k in range(_ROUNDS):
        value, gradient = information.value_and_gradient(point)
        most, corner = _most(reaches, -gradient)
        best = max(best, value + float(gradient @ (gained - point)) - most)
        if effort.over:
            break
        point += 2.0 / (k + 2.0) * (gained + corner - point)
    return max(0.0, best - _ROUNDING * information.prior)


def _reaches(problem: Problem) -> list[_Reach]:
    away = _to_depots(problem)
    position = {v: i for i, v in enumerate(problem.candidates)}
    found = []
    for robot in problem.robots:
        passing = _passing(robot)
        possible = np.isfinite(passing) & np.isfinite(away) & (robot.limits > 0)
        nodes = np.array([v for v in robot.places if possible[v] and v in position], dtype=np.int64)
        found.append(
            _Reach(
                candidates=np.array([position[v] for v in nodes.tolist()], dtype=np.int64),
                most=np.minimum(robot.limits[nodes], max(robot.capacity, 0)).astype(np.float64),
                visit_j=robot.empty_mass_kg * passing[nodes],
                carriage_j=problem.sample_mass_kg * away[nodes],
                budget_j=robot.budget_j * (1.0 + _BUDGET_SLACK) + _BUDGET_SLACK,
                precision=robot.precision,
            )
        )
    return found


def _passing(robot: RobotView) -> FloatArray:
    """Return half of the cheapest ways into and out of every node, shape (N,); nothing for the start."""
    cost = robot.closure.energy_per_kg.copy()
    np.fill_diagonal(cost, np.inf)
    into = cost[list(robot.places)].min(axis=0)
    ends = [*robot.stops, *robot.depots]
    out = cost[:, ends].min(axis=1) if ends else np.full(len(cost), np.inf)
    half: FloatArray = 0.5 * (into + out)
    half[robot.start] = 0.0
    return half


def _to_depots(problem: Problem) -> FloatArray:
    """Return the least alpha by which a robot, or several in turn, bring a sample from a node to a depot."""
    closures = {id(robot.closure): robot.closure for robot in problem.robots}
    cost = np.min([closure.energy_per_kg for closure in closures.values()], axis=0)
    away: FloatArray = np.full(len(problem.nodes), np.inf)
    away[np.array([d for robot in problem.robots for d in robot.depots], dtype=np.int64)] = 0.0
    while True:
        nearer: FloatArray = np.minimum(away, (cost + away).min(axis=1))
        if not (nearer < away).any():
            return away
        away = nearer


def _most(reaches: list[_Reach], worth: FloatArray) -> tuple[float, FloatArray]:
    """Return an upper bound on the worth of all that can be gained, and the precision behind it.

    ``worth`` is that of a unit of precision at each candidate, shape (V,). Any price of the team's energy
    gives a bound; the function is convex in the price.
    """
    gains = [reach.precision * worth[reach.candidates] for reach in reaches]
    high = max(
        float((gain * reach.most / np.maximum(reach.visit_j, _FREE_J)).max(initial=0.0))
        for gain, reach in zip(gains, reaches, strict=True)
    )
    free, corner = _at_price(reaches, gains, 0.0, worth.size)
    best = free
    low = 0.0
    for _ in range(_TRIALS):
        one, other = low + 0.382 * (high - low), low + 0.618 * (high - low)
        first, at_first = _at_price(reaches, gains, one, worth.size)
        second, at_second = _at_price(reaches, gains, other, worth.size)
        if first < best:
            best, corner = first, at_first
        if second < best:
            best, corner = second, at_second
        low, high = (low, other) if first <= second else (one, high)
    return best, corner


def _at_price(
    reaches: list[_Reach], gains: list[FloatArray], price: float, candidates: int
) -> tuple[float, FloatArray]:
    """Return the bound for a price of energy (worth per joule), and the precision gained there.

    For each robot a knapsack in fractions: visits for their worth less the price of what they take.
    """
    total, corner = 0.0, np.zeros(candidates)
    for reach, gain in zip(reaches, gains, strict=True):
        total += price * reach.budget_j
        net = reach.most * gain
        if price > 0.0:
            net -= price * (reach.most * reach.carriage_j + reach.visit_j)
        useful = np.flatnonzero(net > 0.0)
        visit_j = np.where(reach.visit_j[useful] > _FREE_J, reach.visit_j[useful], 0.0)
        ratio = np.full(useful.size, np.inf)
        np.divide(net[useful], visit_j, out=ratio, where=visit_j > 0.0)
        best_first = np.argsort(-ratio, kind="stable")
        useful, visit_j = useful[best_first], visit_j[best_first]
        room = np.maximum(reach.budget_j - (np.cumsum(visit_j) - visit_j), 0.0)
        share = np.ones(useful.size)
        np.divide(room, visit_j, out=share, where=visit_j > room)
        total += float(share @ net[useful])
        np.add.at(corner, reach.candidates[useful], share * reach.most[useful] * reach.precision)
    return total, corner
