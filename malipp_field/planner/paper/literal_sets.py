"""Index sets and constants of the paper's model, as far as something can happen there.

A slot is a routing node of one robot: a physical node by its index into `Problem.nodes`, the terminal copy
of depot d by ``len(nodes) + d``. What no feasible mission can use (out of reach, nothing to do) has been left
out by `malipp_field.planner.problem`.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Hashable, Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import cvxpy as cp
import networkx as nx
import numpy as np
from scipy import sparse

from malipp_field.field import FloatArray
from malipp_field.planner.problem import Problem

Key = Any
"""Index of one entry of a family: a tuple that begins with the robot, or (candidate, level)."""

_SAME_LEVEL = 1e-9
"""Precision levels closer than this share are one level."""


class Family:
    """One symbol of the paper: a vector variable with the keys of its entries."""

    def __init__(self, name: str, keys: Iterable[Key], **domain: bool) -> None:
        self.keys = tuple(keys)
        self.variable = cp.Variable(len(self.keys), name=name, **domain)
        self.position = {key: i for i, key in enumerate(self.keys)}

    def at(self, keys: Iterable[Key]) -> Any:
        """Return the entries at ``keys``, one after the other."""
        columns = [self.position[key] for key in keys]
        return _selection(range(len(columns)), columns, (len(columns), len(self.keys))) @ self.variable

    def total(self, rows: Iterable[Hashable], belongs: Callable[[Key], Hashable]) -> Any:
        """Return one sum a row: over all keys whose ``belongs(key)`` is that row."""
        return self.summing(rows, belongs) @ self.variable

    def summing(self, rows: Iterable[Hashable], belongs: Callable[[Key], Hashable]) -> Any:
        """Return the 0-1 matrix of these sums; shape (rows, keys)."""
        index = {row: i for i, row in enumerate(rows)}
        pairs = [(index[belongs(key)], i) for i, key in enumerate(self.keys) if belongs(key) in index]
        found, columns = [row for row, _ in pairs], [column for _, column in pairs]
        return _selection(found, columns, (len(index), len(self.keys)))

    def weigh(self, weight: Callable[[Key], float]) -> FloatArray:
        """Return one constant a key."""
        return np.array([weight(key) for key in self.keys], dtype=np.float64)


def _selection(rows: Iterable[int], columns: Iterable[int], shape: tuple[int, int]) -> Any:
    rows, columns = list(rows), list(columns)
    return sparse.csr_array((np.ones(len(rows)), (rows, columns)), shape=shape)


@dataclass(frozen=True)
class Sets:
    """The index sets of a problem."""

    problem: Problem

    @cached_property
    def arcs(self) -> list[tuple[int, int, int]]:
        """(r, u, v) of E_r, v being a slot."""
        return [(r, u, v) for r in range(self.size) for u, v in self.problem.arcs(r)]

    @property
    def size(self) -> int:
        """Number of robots R."""
        return len(self.problem.robots)

    @cached_property
    def starts(self) -> list[tuple[int, int]]:
        """(r, s_r)."""
        return [(r, robot.start) for r, robot in enumerate(self.problem.robots)]

    @cached_property
    def stops(self) -> list[tuple[int, int]]:
        """(r, v) of every physical node but the start."""
        return [(r, v) for r, robot in enumerate(self.problem.robots) for v in robot.stops]

    @cached_property
    def copies(self) -> list[tuple[int, int]]:
        """(r, d~) of every terminal copy."""
        n = len(self.problem.nodes)
        return [(r, n + d) for r, robot in enumerate(self.problem.robots) for d in robot.depots]

    @property
    def slots(self) -> list[tuple[int, int]]:
        """(r, v) of V^rt_r."""
        return [*self.starts, *self.stops, *self.copies]

    @cached_property
    def samples(self) -> list[tuple[int, int]]:
        """(r, v) where robot r may take samples."""
        return [(r, v) for r in range(self.size) for v in self.problem.candidates if self.most(r, v)]

    @cached_property
    def unloads(self) -> list[tuple[int, int]]:
        """(r, v) of U_r = D_r and its copies."""
        here = [(r, d) for r, robot in enumerate(self.problem.robots) for d in robot.depots
                if d in robot.places]  # fmt: skip
        return here + self.copies

    @cached_property
    def transfers(self) -> list[tuple[int, int, int]]:
        """(r, r', v): who may leave samples for whom, and where: at physical nodes that both may visit."""
        if not self.problem.handoffs:
            return []
        robots = self.problem.robots
        return [
            (r, o, v)
            for r, o in itertools.permutations(range(self.size), 2)
            if robots[r].capacity and robots[o].capacity
            for v in sorted((set(robots[r].places) & set(robots[o].places)) - self.problem.closed)
        ]

    @cached_property
    def fetches(self) -> list[tuple[int, int]]:
        """(r, s): who may fetch which stock."""
        return [
            (r, s)
            for s, stock in enumerate(self.problem.stocks)
            for r, robot in enumerate(self.problem.robots)
            if stock.node in robot.places and robot.capacity
        ]

    @cached_property
    def levels(self) -> list[tuple[int, float]]:
        """(i, p): precision levels that can be attained at candidate number i, what is gained included."""
        found = []
        for i, v in enumerate(self.problem.candidates):
            attained = {0.0}
            for r, robot in enumerate(self.problem.robots):
                counts = range(self.most(r, v) + 1)
                attained = _distinct(p + count * robot.precision for p in attained for count in counts)
            levels = [float(self.problem.gained[i]) + p for p in sorted(attained)]
            found += [(i, p) for p in levels if p > 0]
        return found

    def most(self, r: int, v: int) -> int:
        """Return S_r^max at a node, as far as it may be taken and carried."""
        robot = self.problem.robots[r]
        return min(int(robot.limits[v]), robot.capacity) if v in robot.places else 0

    def alpha(self, arc: tuple[int, int, int]) -> float:
        """Return alpha_uv^r, in joules for each kilogram."""
        r, u, v = arc
        return float(self.problem.robots[r].closure.energy_per_kg[u, v % len(self.problem.nodes)])

    def travel_s(self, arc: tuple[int, int, int]) -> float:
        """Return tau_uv^r."""
        r, u, v = arc
        return float(self.problem.robots[r].closure.time_s[u, v % len(self.problem.nodes)])


def _distinct(values: Iterable[float]) -> set[float]:
    """Return the values without those that differ from a smaller one by rounding only."""
    kept: list[float] = []
    for value in sorted(values):
        if not kept or value > kept[-1] * (1.0 + _SAME_LEVEL):
            kept.append(value)
    return set(kept)


@dataclass(frozen=True)
class Windows:
    """Earliest and latest departures: the constants of the timing constraints, in seconds.

    Attributes
    ----------
    earliest, latest : dict
        t_v^r between them where (r, v) is visited, in every plan worth having.
    """

    earliest: dict[tuple[int, int], float]
    latest: dict[tuple[int, int], float]


def windows(sets: Sets) -> Windows:
    """Return bounds on departures that cut off no optimum.

    Earliest: the quickest way through the closure arcs, a service at every stop. Latest: the horizon less the
    quickest way to a terminal copy. Arcs of the closure are cheapest, not fastest, so both are shortest paths
    over arcs and not single arcs.
    """
    horizon, beta = _horizon_s(sets), sets.problem.service_time_s
    earliest, latest = {}, {}
    for r, robot in enumerate(sets.problem.robots):
        graph: nx.DiGraph[int] = nx.DiGraph()
        for arc in (arc for arc in sets.arcs if arc[0] == r):
            graph.add_edge(arc[1], arc[2], wait=sets.travel_s(arc) + beta)
        graph.add_nodes_from(v for q, v in sets.slots if q == r)
        copies = [v for q, v in sets.copies if q == r]
        since = nx.single_source_dijkstra_path_length(graph, robot.start, weight="wait")
        left = nx.multi_source_dijkstra_path_length(graph.reverse(), copies, weight="wait") if copies else {}
        for v in graph:
            earliest[r, v] = robot.ready_s + beta + since.get(v, 0.0)
            latest[r, v] = max(horizon - left.get(v, 0.0), earliest[r, v])
    return Windows(earliest, latest)


def _horizon_s(sets: Sets) -> float:
    """Return a time by which every plan in which nobody waits without need is over.

    Going back from the last departure, each stop waited for one before it: a leg and a service, or a drop and
    its clearance. No stop comes twice, so all slots together, begun when everybody is ready, are enough.
    """
    problem = sets.problem
    slowest = dict.fromkeys(sets.slots, 0.0)
    for arc in sets.arcs:
        head = (arc[0], arc[2])
        slowest[head] = max(slowest[head], sets.travel_s(arc))
    ready = [robot.ready_s for robot in problem.robots] + [stock.available_s for stock in problem.stocks]
    clearance = problem.clearance_s
    return max(ready) + sum(max(leg_s, clearance) + problem.service_time_s for leg_s in slowest.values())


def coefficient_bounds(sets: Sets) -> FloatArray:
    """Return A_j^max, for each level of `Sets.levels`; shape (T, L).

    At the optimum A_j = k_jS (K_SS + N)^-1 over the sampled nodes S, so A_j (K_SS + N) A_j^T is the
    variance explained at j. It never exceeds e_j, what the highest precision everywhere explains. For a given
    A_jv, its least value over the other coefficients is A_jv^2 times a Schur complement: the variance of a
    measurement at v given those at the other nodes of S. That is at least rho_vi + c_v, where c_v is the
    variance left at v when all other candidates have their highest precision. Hence
    |A_jvi| <= sqrt(e_j / (rho_vi + c_v)).
    """
    information = sets.problem.information
    highest = np.zeros(len(sets.problem.candidates))
    for i, p in sets.levels:
        highest[i] = max(highest[i], p)
    everything = explained(information.k_vv, information.k_tv, highest)
    bounds = np.zeros((len(information.k_tt), len(sets.levels)))
    for column, (i, p) in enumerate(sets.levels):
        others = np.where(np.arange(len(highest)) == i, 0.0, highest)
        left = information.k_vv[i, i] - explained(information.k_vv, information.k_vv[[i]], others)[0]
        bounds[:, column] = np.sqrt(everything / (1.0 / p + max(0.0, left)))
    return bounds


def explained(k_vv: FloatArray, k_xv: FloatArray, precision: FloatArray) -> FloatArray:
    """Return the prior variance that observations of some precision explain at places x; shape (X,)."""
    root = np.sqrt(precision)
    noisy = np.eye(len(root)) + root[:, None] * k_vv * root
    scaled = k_xv * root
    variance: FloatArray = np.einsum("xv,vx->x", scaled, np.linalg.solve(noisy, scaled.T))
    return np.maximum(variance, 0.0)
