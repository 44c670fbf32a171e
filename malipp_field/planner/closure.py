"""The metric closure of one robot: the cheapest way between any two nodes, whatever it carries.

The payload multiplies the energy of every edge of a leg alike, so the cheapest path by alpha_e is the
cheapest for every load and can be found before anything is planned (Problem Setting of the paper).
"""

from __future__ import annotations

import heapq
import math
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import count, pairwise
from typing import cast

import numpy as np

from malipp_field.field import FloatArray
from malipp_field.mission import Passage

Path = tuple[str, ...]
Ways = Mapping[str, Mapping[str, float]]
"""What it takes to get from a node to each of its neighbours."""

_TIE = 1e-9
"""Paths whose energies differ by less than this share count as equally cheap; the faster one is taken."""


@dataclass(frozen=True)
class Closure:
    """Cheapest legs of one robot between nodes; what cannot be reached costs infinity.

    Attributes
    ----------
    energy_per_kg : array, shape (N, N)
        alpha_uv: joules for each kilogram moved from u to v.
    time_s : array, shape (N, N)
        tau_uv of the same path.
    paths : dict
        Physical nodes of the leg by (u, v), both ends included.
    """

    energy_per_kg: FloatArray
    time_s: FloatArray
    paths: dict[tuple[int, int], Path]

    @cached_property
    def rows(self) -> list[list[float]]:
        """``energy_per_kg`` as plain lists: far quicker to read one entry at a time."""
        return cast("list[list[float]]", self.energy_per_kg.tolist())


def closure(passages: Iterable[Passage], nodes: Sequence[str], terminals: Sequence[int]) -> Closure:
    """Return the closure over ``nodes``, filled in between the members of ``terminals`` (indices)."""
    energies: defaultdict[str, dict[str, float]] = defaultdict(dict)
    times: defaultdict[str, dict[str, float]] = defaultdict(dict)
    for passage in passages:
        energies[passage.tail][passage.head] = passage.energy_per_kg
        times[passage.tail][passage.head] = passage.time_s
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
