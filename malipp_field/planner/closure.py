"""The metric closure of one robot: the cheapest way between any two nodes, whatever it carries.

The payload multiplies the energy of every edge of a leg alike, so the cheapest path by alpha_e is the
cheapest for every load and can be found before anything is planned (Problem Setting of the paper).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import cast

import networkx as nx
import numpy as np

from malipp_field.field import FloatArray
from malipp_field.mission import Passage

Path = tuple[str, ...]

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
    graph: nx.DiGraph[str] = nx.DiGraph()
    graph.add_nodes_from(nodes)
    for passage in passages:
        graph.add_edge(passage.tail, passage.head, energy=passage.energy_per_kg, time=passage.time_s)
    energy = np.full((len(nodes), len(nodes)), np.inf)
    time = np.full_like(energy, np.inf)
    paths: dict[tuple[int, int], Path] = {}
    for u in terminals:
        legs = _cheapest_paths(graph, nodes[u])
        for v in terminals:
            path = legs.get(nodes[v])
            if path is None:
                continue
            paths[u, v] = path
            energy[u, v] = nx.path_weight(graph, path, "energy")
            time[u, v] = nx.path_weight(graph, path, "time")
    return Closure(energy, time, paths)


def _cheapest_paths(graph: nx.DiGraph[str], source: str) -> dict[str, Path]:
    """Return the minimum-energy path to every node that can be reached, the fastest among equals."""
    cost: dict[str, float] = nx.single_source_dijkstra_path_length(graph, source, weight="energy")
    tight: nx.DiGraph[str] = nx.DiGraph()
    tight.add_node(source)
    for tail, head, data in graph.edges(data=True):
        if tail in cost and cost[tail] + data["energy"] <= cost[head] * (1.0 + _TIE):
            tight.add_edge(tail, head, time=data["time"])
    return {
        node: tuple(path)
        for node, path in nx.single_source_dijkstra_path(tight, source, weight="time").items()
    }
