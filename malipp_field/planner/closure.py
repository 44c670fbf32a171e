"""The metric closure of one robot: the cheapest way between any two nodes, whatever it carries.

The payload multiplies the energy of every edge of a leg alike, so the cheapest path by alpha_e is the
cheapest for every load and can be found before anything is planned (Problem Setting of the paper).
"""

from __future__ import annotations

import heapq
import math
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import count, pairwise
from typing import cast

import numpy as np
from numpy.typing import NDArray

from malipp_field.field import FloatArray
from malipp_field.mission import Passage

Path = tuple[str, ...]
Ways = Mapping[str, Mapping[str, float]]
"""What it takes to get from a node to each of its neighbours."""

_TIE = 1e-9
"""Paths whose energies differ by less than this share count as equally cheap; the faster one is taken."""
_MANY = 400_000
"""Sources times edges from which on shortest paths are worth the compiled code's loading."""


@dataclass(frozen=True)
class Closure:
    """Cheapest legs of one robot between nodes; what cannot be reached costs infinity.

    Attributes
    ----------
    energy_per_kg : array, shape (N, N)
        alpha_uv: joules for each kilogram moved from u to v.
    time_s : array, shape (N, N)
        tau_uv of the same path.
    paths : mapping
        Physical nodes of the leg by (u, v), both ends included.
    """

    energy_per_kg: FloatArray
    time_s: FloatArray
    paths: Mapping[tuple[int, int], Path]

    @cached_property
    def rows(self) -> list[list[float]]:
        """``energy_per_kg`` as plain lists: far quicker to read one entry at a time."""
        return cast("list[list[float]]", self.energy_per_kg.tolist())


class PathsByTree(Mapping[tuple[int, int], Path]):
    """Paths that are put together when asked for, from the node before the last on each.

    Parameters
    ----------
    nodes
        Ids of all nodes.
    reached : array, shape (N, N)
        Between which nodes there is a path.
    before : array, shape (N, N)
        The node before v on the path from u, at (u, v).
    """

    def __init__(self, nodes: Sequence[str], reached: NDArray[np.bool_], before: NDArray[np.int32]) -> None:
        self._nodes, self._reached, self._before = nodes, reached, before

    def __getitem__(self, ends: tuple[int, int]) -> Path:
        u, v = ends
        if not self._reached[u, v]:
            raise KeyError(ends)
        path = [self._nodes[v]]
        while v != u:
            v = int(self._before[u, v])
            path.append(self._nodes[v])
        return tuple(path[::-1])

    def __iter__(self) -> Iterator[tuple[int, int]]:
        return ((int(u), int(v)) for u, v in np.argwhere(self._reached))

    def __len__(self) -> int:
        return int(np.count_nonzero(self._reached))


def closure(passages: Iterable[Passage], nodes: Sequence[str], terminals: Sequence[int]) -> Closure:
    """Return the closure over ``nodes``, filled in between the members of ``terminals`` (indices)."""
    energies: defaultdict[str, dict[str, float]] = defaultdict(dict)
    times: defaultdict[str, dict[str, float]] = defaultdict(dict)
    for passage in passages:
        energies[passage.tail][passage.head] = passage.energy_per_kg
        times[passage.tail][passage.head] = passage.time_s
    if len(terminals) * sum(map(len, energies.values())) > _MANY:
        return _closure_compiled(energies, times, nodes, terminals)
    energy = np.full((len(nodes), len(nodes)), np.inf)
    time = np.full_like(energy, np.inf)
    paths: dict[tuple[int, int], Path] = {}
    for u in terminals:
        legs = _cheapest_paths(energies, times, nodes[u])
        for v in terminals:
            path = legs.get(nodes[v])
            if path is None:
                continue
            paths[u, v] = path
            energy[u, v] = sum(energies[a][b] for a, b in pairwise(path))
            time[u, v] = sum(times[a][b] for a, b in pairwise(path))
    return Closure(energy, time, paths)


def _closure_compiled(energies: Ways, times: Ways, nodes: Sequence[str], terminals: Sequence[int]) -> Closure:
    """Return the same for a site with many edges."""
    from malipp_field.planner.closure_kernel import cheapest_ways  # noqa: PLC0415 (numba takes its time)

    index = {node: i for i, node in enumerate(nodes)}
    heads = [energies.get(node, {}) for node in nodes]
    start = np.concatenate(([0], np.cumsum([len(row) for row in heads]))).astype(np.int64)
    head = np.array([index[v] for row in heads for v in row], dtype=np.int64)
    weights = np.array([w for row in heads for w in row.values()], dtype=np.float64)
    durations = np.array(
        [times[node][v] for node, row in zip(nodes, heads, strict=True) for v in row], dtype=np.float64
    )
    chosen = np.array(terminals, dtype=np.int64)
    spent, passed, tails = cheapest_ways(start, head, weights, durations, chosen, _TIE)
    energy = np.full((len(nodes), len(nodes)), np.inf)
    time, before = np.full_like(energy, np.inf), np.full(energy.shape, -1, dtype=np.int32)
    energy[np.ix_(chosen, chosen)], time[np.ix_(chosen, chosen)] = spent[:, chosen], passed[:, chosen]
    before[chosen] = tails
    return Closure(energy, time, PathsByTree(nodes, np.isfinite(energy), before))


def _cheapest_paths(energies: Ways, times: Ways, source: str) -> dict[str, Path]:
    """Return the minimum-energy path to every node that can be reached, the fastest among equals."""
    least, _ = _dijkstra(energies, source)
    tight = {
        tail: {head: times[tail][head] for head in heads if cost + heads[head] <= least[head] * (1.0 + _TIE)}
        for tail, cost in least.items()
        if (heads := energies.get(tail))
    }
    _, before = _dijkstra(tight, source)
    paths: dict[str, Path] = {source: (source,)}
    for node, tail in before.items():  # in the order of arrival: a path's beginning is known before its end
        paths[node] = (*paths[tail], node)
    return paths


def _dijkstra(ways: Ways, source: str) -> tuple[dict[str, float], dict[str, str]]:
    """Return the least sum of weights to every node that can be reached, and the node before it.

    Both in the order of arrival; the source has no node before it.
    """
    least: dict[str, float] = {}
    before: dict[str, str] = {}
    best = {source: 0.0}
    turn = count()
    queue = [(0.0, next(turn), source, source)]
    while queue:
        cost, _, node, tail = heapq.heappop(queue)
        if node in least:
            continue
        least[node] = cost
        if node != source:
            before[node] = tail
        for head, weight in ways.get(node, {}).items():
            if cost + weight < best.get(head, math.inf):
                best[head] = cost + weight
                heapq.heappush(queue, (best[head], next(turn), head, node))
    return least, before
