"""Compiled shortest paths for sites with many edges."""

from __future__ import annotations

import numpy as np

from malipp_field.field import FloatArray
from malipp_field.planner.kernels import stored

_NOWHERE = -1


@stored
def cheapest_ways(
    start: np.ndarray,
    head: np.ndarray,
    energy: np.ndarray,
    time: np.ndarray,
    terminals: np.ndarray,
    tie: float,
) -> tuple[FloatArray, FloatArray, np.ndarray]:
    """Return energy and time of the cheapest paths from each terminal, the fastest among equals.

    Parameters
    ----------
    start : array, shape (N + 1,); head, energy, time : array, shape (A,)
        The arcs from node u are those from ``start[u]`` up to ``start[u + 1]``.
    terminals : array, shape (S,)
        Sources.
    tie
        Share by which a path may be dearer and still be equal.

    Returns
    -------
    energy, time, before : array, shape (S, N)
        Infinity where there is no way; the node before the last on every path, -1 where there is none.
    """
    n, sources = len(start) - 1, len(terminals)
    spent, passed = np.full((sources, n), np.inf), np.full((sources, n), np.inf)
    before = np.full((sources, n), _NOWHERE, dtype=np.int32)
    for s in range(sources):
        source = terminals[s]
        least = np.full(n, np.inf)
        least[source] = 0.0
        done = np.zeros(n, dtype=np.bool_)
        for _ in range(n):
            u, nearest = _NOWHERE, np.inf
            for v in range(n):
                if not done[v] and least[v] < nearest:
                    u, nearest = v, least[v]
            if u == _NOWHERE:
                break
            done[u] = True
            for a in range(start[u], start[u + 1]):
                least[head[a]] = min(least[head[a]], nearest + energy[a])
        # The same for time, along the arcs of cheapest paths only.
        spent[s, source], passed[s, source] = 0.0, 0.0
        done[:] = False
        for _ in range(n):
            u, nearest = _NOWHERE, np.inf
            for v in range(n):
                if not done[v] and passed[s, v] < nearest:
                    u, nearest = v, passed[s, v]
            if u == _NOWHERE:
                break
            done[u] = True
            for a in range(start[u], start[u + 1]):
                v = head[a]
                tight = least[u] + energy[a] <= least[v] * (1.0 + tie)
                if tight and nearest + time[a] < passed[s, v]:
                    passed[s, v], spent[s, v] = nearest + time[a], spent[s, u] + energy[a]
                    before[s, v] = u
    return spent, passed, before
