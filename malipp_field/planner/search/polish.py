"""Cheaper routes for the samples and drops of a plan, where no stage proves the least energy.

Stops are put elsewhere in their route, or some in a row turned round, as long as that takes less energy. Who
samples, drops and picks how much at which node stays, and with it J; what is held on the way, where it is
unloaded and when everybody is where, follows from the new order and must keep every rule.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

from malipp_field.planner.draft import Draft, draft_of
from malipp_field.planner.extract import TeamPlan, team_plan
from malipp_field.planner.linear import Effort
from malipp_field.planner.problem import Problem, within

_LEAST_SAVED = 1e-9
"""Share of a route's energy that a change has to save."""


def polished(problem: Problem, team: TeamPlan, effort: Effort) -> TeamPlan:
    """Return a plan of the same samples and drops that no one change of a route's order makes cheaper.

    The result is never worse; where the effort ends before, some change might.
    """
    best = team
    draft = draft_of(problem, team)
    waiting = list(range(len(problem.robots)))
    while waiting and not effort.over:
        r = waiting.pop()
        for route in _cheaper(draft, r):
            trial = Draft(problem, [*draft.routes[:r], route, *draft.routes[r + 1 :]], draft.samples)
            found = team_plan(problem, trial.visits())
            if found is not None and found.rank < best.rank:
                best, draft = found, trial
                waiting.append(r)
                break
    return best


def _cheaper(draft: Draft, r: int) -> Iterator[list[int]]:
    """Yield routes with one change of order that take less energy, the cheapest first."""
    first, *inner, _ = draft.routes[r]
    limit_j = (1.0 - _LEAST_SAVED) * route_energy_j(draft, r, draft.routes[r])
    found = []
    for order in _orders(inner):
        stops = [first, *order]
        route = [*stops, draft.terminal(r, stops)]
        if route[-1] != stops[-1]:  # no leg leads from a depot to its own terminal copy
            energy_j = route_energy_j(draft, r, route)
            if energy_j < limit_j:
                found.append((energy_j, route))
    return (route for _, route in sorted(found))


def _orders(inner: list[int]) -> Iterator[list[int]]:
    """Yield stops in other orders: one of them elsewhere, or some in a row the other way round."""
    for i, node in enumerate(inner):
        rest = inner[:i] + inner[i + 1 :]
        for k in range(len(inner)):
            if k != i:
                yield [*rest[:k], node, *rest[k:]]
        for k in range(i + 3, len(inner) + 1):
            yield inner[:i] + inner[i:k][::-1] + inner[k:]


def route_energy_j(draft: Draft, r: int, route: list[int]) -> float:
    """Return the energy of what a robot does, in the order of a route; infinity where that breaks a rule."""
    robot, kg = draft.problem.robots[r], draft.problem.sample_mass_kg
    rows, load, energy_j = robot.closure.rows, robot.on_board, 0.0
    for node, after in pairwise(route):
        load += draft.collect[r][node]
        given = draft.give[r][node]
        held = load - given if node in robot.depots else load
        if load < given or held > robot.capacity:
            return float("inf")
        load = draft.take[r][node] + (0 if node in robot.depots else load - given)
        if load > robot.capacity:
            return float("inf")
        energy_j += rows[node][after] * (robot.empty_mass_kg + kg * load)
    return energy_j if within(energy_j, robot.budget_j) else float("inf")
