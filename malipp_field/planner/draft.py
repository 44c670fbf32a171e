"""A team plan in the making: stops by robot, and for every sample the way it takes home.

All else (what is collected, dropped and picked where, loads, energies) is derived. Samples on board or lying
in a drop when the plan begins are samples like the others, except that they may not be left out.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from typing import NamedTuple

from malipp_field.planner.extract import Route, TeamPlan, Visit, in_order, precedence, tidy
from malipp_field.planner.problem import Problem

COLLECTED, ON_BOARD, STOCK = 0, 1, 2


class Sample(NamedTuple):
    """One sample: who takes it in hand first, where, and through which drops it goes.

    Attributes
    ----------
    kind
        `COLLECTED` at ``node``; `ON_BOARD` at the start of ``robot``; `STOCK`, fetched at ``node``.
    hops : tuple of (node, robot)
        Where it is dropped, and which robot picks it there.
    stock
        Index of the stock it lies in, -1 for the other kinds.
    """

    kind: int
    node: int
    robot: int
    hops: tuple[tuple[int, int], ...] = ()
    stock: int = -1


def handlers(sample: Sample) -> set[int]:
    """Return the robots through whose hands a sample goes."""
    return {sample.robot, *(receiver for _, receiver in sample.hops)}


class Draft:
    """Routes (node lists from start to terminal) and samples; changed in place."""

    def __init__(self, problem: Problem, routes: list[list[int]], samples: list[Sample]) -> None:
        self.problem, self.routes, self.samples = problem, routes, samples
        team = range(len(problem.robots))
        self.collect = [defaultdict[int, int](int) for _ in team]
        self.give = [defaultdict[int, int](int) for _ in team]
        self.take = [defaultdict[int, int](int) for _ in team]
        for sample in samples:
            self.count(sample, 1)

    def remove(self, sample: Sample) -> None:
        """Remove a sample; its stops stay."""
        self.samples.remove(sample)
        self.count(sample, -1)

    def count(self, sample: Sample, change: int) -> None:
        """Count a sample in (1) or out (-1) at its stops."""
        if sample.kind == COLLECTED:
            self.collect[sample.robot][sample.node] += change
        elif sample.kind == STOCK:
            self.take[sample.robot][sample.node] += change
        holder = sample.robot
        for node, receiver in sample.hops:
            self.give[holder][node] += change
            self.take[receiver][node] += change
            holder = receiver

    def tidy(self) -> None:
        """Drop stops at which nothing happens, and end every route at its nearest depot."""
        for r, route in enumerate(self.routes):
            robot, load, kept = self.problem.robots[r], self.problem.robots[r].on_board, route[:1]
            for i, node in enumerate(route[:-1]):
                busy = self.collect[r][node] or self.give[r][node] or self.take[r][node]
                if i and (busy or (node in robot.depots and load)):
                    kept.append(node)
                load += self.collect[r][node] - self.give[r][node]
                load = self.take[r][node] + (0 if node in robot.depots else load)
            # No leg leads from a depot to its own terminal copy: what it was for is done at the end.
            while len(kept) > 1 and kept[-1] in robot.depots and not self._transfers(r, kept[-1]):
                kept.pop()
            self.routes[r] = [*kept, self.terminal(r, kept)]

    def _transfers(self, r: int, node: int) -> bool:
        """Tell whether a robot drops or picks at a node."""
        return bool(self.give[r][node] or self.take[r][node])

    def terminal(self, r: int, inner: list[int]) -> int:
        """Return the cheapest depot to end at after the stops ``inner``."""
        robot = self.problem.robots[r]
        cost = robot.closure.energy_per_kg[inner[-1]]
        allowed = [d for d in robot.depots if d != inner[-1] or len(inner) == 1]
        return min(allowed or robot.depots, key=lambda d: cost[d])

    def visits(self) -> tuple[Route, ...]:
        """Return the routes with their operations."""
        drop: dict[tuple[int, int], Counter[int]] = defaultdict(Counter)
        pick: dict[tuple[int, int], Counter[int]] = defaultdict(Counter)
        fetch: dict[tuple[int, int], Counter[int]] = defaultdict(Counter)
        for sample in self.samples:
            if sample.kind == STOCK:
                fetch[sample.robot, sample.node][sample.stock] += 1
            holder = sample.robot
            for node, receiver in sample.hops:
                drop[holder, node][receiver] += 1
                pick[receiver, node][holder] += 1
                holder = receiver
        found = []
        for r, (robot, route) in enumerate(zip(self.problem.robots, self.routes, strict=True)):
            load, visits = robot.on_board, []
            for i, node in enumerate(route):
                last = i == len(route) - 1
                load += 0 if last else self.collect[r][node] - self.give[r][node]
                unload = load if last or node in robot.depots else 0
                load += (0 if last else self.take[r][node]) - unload
                visits.append(
                    Visit(node, unload=unload)
                    if last
                    else Visit(node, self.collect[r][node], dict(drop[r, node]), dict(pick[r, node]),
                               dict(fetch[r, node]), unload)
                )  # fmt: skip
            found.append(tidy(tuple(visits)))
        return tuple(found)


def draft_of(problem: Problem, team: TeamPlan) -> Draft:
    """Return a plan as a draft: samples are told apart by following each through the stops."""
    routes = [[visit.node for visit in route] for route in team.routes]
    routes = [route if len(route) > 1 else [route[0], route[0]] for route in routes]
    held = [[Sample(ON_BOARD, robot.start, r)] * robot.on_board for r, robot in enumerate(problem.robots)]
    lying: dict[tuple[int, int, int], list[Sample]] = {}
    home: list[Sample] = []
    order = in_order(precedence(problem, team.routes))
    assert order is not None, "a team plan whose stops wait in a circle"
    for r, k in order:
        visit, hand = team.routes[r][k], held[r]
        hand += [Sample(COLLECTED, visit.node, r)] * visit.collect
        for receiver, count in visit.drop.items():
            for _ in range(count):
                sample = hand.pop()
                dropped = sample._replace(hops=(*sample.hops, (visit.node, receiver)))
                lying.setdefault((visit.node, r, receiver), []).append(dropped)
        home += hand[: visit.unload]
        del hand[: visit.unload]
        for sender in visit.pick:
            hand += lying.pop((visit.node, sender, r))
        for s, count in visit.fetch.items():
            hand += [Sample(STOCK, visit.node, r, (), s)] * count
    return Draft(problem, routes, home)
