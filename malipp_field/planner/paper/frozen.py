"""Routes that stand: a problem in which some robots drive where a plan sends them, and all else is free.

The neighbourhoods of the paper's LNS (Section "Heuristic") fix the route decisions x of some robots and leave
sampling, payload, handoffs, unloading and timing free for the whole team. Here a robot whose route stands is
an ordinary robot with another closure: from each node of its route it can drive on along the route, at what
that costs, and nowhere else. So every solver of the house keeps to the route without knowing of it.

In the paper as here routes are sequences of closure arcs, and an arc is a physical path that passes nodes in
transit. Splitting it at a node it passes is a route over the closure too, with the same energy (parts of
cheapest paths are cheapest paths). Hence a robot may stop, or not, wherever its route leads it: at no cost,
also where the plan had nothing for it to do. A node that is passed more than once belongs to its last pass,
from where samples have the shortest way to go. The one freedom beyond the paper's fixed x: a robot may end
its route early at a depot of its own on it, when nothing is left to do.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from itertools import pairwise

import numpy as np

from malipp_field.planner.closure import Closure, Path
from malipp_field.planner.extract import Route
from malipp_field.planner.problem import Problem, RobotView


def freeze(problem: Problem, routes: tuple[Route, ...], free: Collection[int] = ()) -> Problem:
    """Return the problem in which all robots but ``free`` keep to their routes.

    Stops at which a route does nothing are not kept: plans of the house have none.
    """
    return replace(
        problem,
        robots=tuple(
            robot if r in free else _on_route(problem, robot, [visit.node for visit in route])
            for r, (robot, route) in enumerate(zip(problem.robots, routes, strict=True))
        ),
    )


def ground(problem: Problem, robot: RobotView, nodes: list[int]) -> list[int]:
    """Return every node at which a robot may operate on a route, in order, from the start to the terminal.

    Parameters
    ----------
    nodes
        The stops of the route; a robot that stays at its depot has one, and gets one.
    """
    index = {node: i for i, node in enumerate(problem.nodes)}
    taken, found = {robot.start, *nodes}, nodes[-1:]
    for u, v in reversed(list(pairwise(nodes))):
        for name in reversed(robot.closure.paths[u, v][1:-1]):
            node = index[name]
            if node in robot.stops and node not in taken:
                taken.add(node)
                found.append(node)
        found.append(u)
    return found[::-1]


def _on_route(problem: Problem, robot: RobotView, nodes: list[int]) -> RobotView:
    walk = ground(problem, robot, nodes)
    return replace(
        robot,
        stops=tuple(v for v in robot.stops if v in walk),
        depots=tuple(d for d in robot.depots if d in walk),
        closure=along(robot.closure, walk),
    )


def along(closure: Closure, walk: list[int]) -> Closure:
    """Return the closure of a robot that can only drive along ``walk``: to the next time it is at a node."""
    energy = np.full_like(closure.energy_per_kg, np.inf)
    time = np.full_like(closure.time_s, np.inf)
    paths: dict[tuple[int, int], Path] = {}
    for i, u in enumerate(walk[: max(1, len(walk) - 1)]):
        energy[u, u] = time[u, u] = 0.0
        path = closure.paths[u, u]
        paths[u, u] = path
        spent_j, passed_s = 0.0, 0.0
        for before, v in zip(walk[i:], walk[i + 1 :], strict=False):
            spent_j += float(closure.energy_per_kg[before, v])
            passed_s += float(closure.time_s[before, v])
            path = (*path, *closure.paths[before, v][1:])
            if (u, v) not in paths:
                energy[u, v], time[u, v], paths[u, v] = spent_j, passed_s, path
    end = walk[-1]
    energy[end, end] = time[end, end] = 0.0
    paths[end, end] = closure.paths[end, end]
    return Closure(energy, time, paths)
