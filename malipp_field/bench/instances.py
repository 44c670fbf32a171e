"""Random missions in the manner of the paper's Section "Experiments".

What the paper says is kept: random directed graphs in a 10 x 10 workspace that grows with the team, edge
density 0.30, one-way share 0.05, Euclidean lengths, identical speeds, an RBF kernel of length scale 2, W = I,
every node except starts and depots a candidate, sample mass 1, beta = Delta^H = 0, S^max = 1, two classes of
sensors whose precisions add up to 40, the precise ones on platforms of lower capacity and reach.

What it leaves open is chosen here, and figures depend on it:

- *n* is |V|, the number of candidates; depots come on top of it.
- *Workspace*: a square of 10 m x max(1, sqrt(n / base_candidates)), so that from ``base_candidates`` on (10,
  the study's n for R = 2) a larger n, and so a larger team, has the same number of candidates per area.
- *Depots*: one for every four robots or part of four. Every robot may unload and end at any of them and
  starts at one of them; two neighbours in the list, a precise robot and a carrier, start at the same.
- *Nodes* are independent and uniform in the workspace, given to 0.1 mm.
- *Graph*: of all pairs of nodes a share of ``density``, drawn uniformly, is joined by a straight edge; a
  share of ``one_way_share`` of these edges can be driven in one direction only. While the graph is not
  strongly connected, the two nearest nodes that do not reach each other both ways are joined both ways.
- *Classes*: robots 0, 2, 4, ... are precise, the others carriers. Capacities are 2 and 4 samples; a precise
  robot has 0.6 of a carrier's energy budget. All weigh 1 kg, need 1 J/(kg m) and drive at 1 m/s, so the
  sample mass is also the ratio of a sample's mass to a robot's.
- *Test points*: as many as candidates, either "random" (uniform in the workspace, of no kin to the nodes) or
  the "candidates" themselves. Gains of cooperation are about twice as high with the latter: always say which.
- *Budgets* are a free factor here; `malipp_field.bench.budgets` tunes it for each instance.

The graph depends on (R, n, seed, density, one-way share, base_candidates) only, so sweeps over mass, noise
ratio, test points or budgets are over the same site.
"""

from __future__ import annotations

import hashlib
import io
import itertools
import json
import math
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Literal

import networkx as nx
import numpy as np
from ruamel.yaml import YAML

from malipp_field.documents import whole_file
from malipp_field.field import FloatArray
from malipp_field.mission import Mission

BASE_SIDE_M = 10.0
TOTAL_PRECISION = 40.0
"""1 / sigma_best^2 + 1 / sigma_worst^2, as in the paper's sweep over noise ratios."""
ROBOTS_PER_DEPOT = 4
PRECISE_REACH = 0.6
"""Energy budget of a precise robot, as a share of a carrier's."""
PRECISE_CAPACITY, CARRIER_CAPACITY = 2, 4


@dataclass(frozen=True)
class Specification:
    """Everything an instance follows from, but its energy budgets.

    Attributes
    ----------
    robots, candidates
        R and n = |V|.
    noise_ratio
        sigma_worst^2 / sigma_best^2.
    sample_mass_kg
        m^s (lambda).
    coverage
        Share of the candidates that Seq-LIPP is to sample, for tuning budgets.
    test_points
        Where T lies: "random" in the workspace, or at the "candidates".
    base_candidates
        Candidates in the 10 m x 10 m workspace; with more the workspace grows.

    Raises
    ------
    ValueError
        When a value makes no sense.
    """

    robots: int
    candidates: int
    seed: int = 0
    noise_ratio: float = 20.0
    sample_mass_kg: float = 1.0
    coverage: float = 0.545
    test_points: Literal["random", "candidates"] = "random"
    base_candidates: int = 10
    density: float = 0.30
    one_way_share: float = 0.05
    length_scale_m: float = 2.0

    def __post_init__(self) -> None:
        if min(self.robots, self.candidates, self.base_candidates) < 1 or self.seed < 0:
            raise ValueError(
                "an instance has robots and candidates, at least one each, and a seed of 0 or more"
            )
        if not all(0.0 <= share <= 1.0 for share in (self.density, self.one_way_share, self.coverage)):
            raise ValueError("density, one_way_share and coverage are shares between 0 and 1")
        if self.noise_ratio < 1.0 or self.sample_mass_kg < 0.0 or self.length_scale_m <= 0.0:
            raise ValueError("noise_ratio is 1 or more, sample_mass_kg 0 or more, length_scale_m above 0")
        if self.test_points not in {"random", "candidates"}:
            raise ValueError("test_points are random, or at the candidates")

    @property
    def name(self) -> str:
        """Return a mission id: size and seed, with a fingerprint of what differs from the defaults."""
        size = f"r{self.robots}-n{self.candidates}-s{self.seed}"
        other = {
            f.name: getattr(self, f.name)
            for f in fields(self)
            if f.name not in {"robots", "candidates", "seed"} and getattr(self, f.name) != f.default
        }
        if not other:
            return size
        return f"{size}-{hashlib.sha256(json.dumps(other, sort_keys=True).encode()).hexdigest()[:8]}"

    @property
    def side_m(self) -> float:
        """Return the side of the square workspace."""
        return BASE_SIDE_M * max(1.0, math.sqrt(self.candidates / self.base_candidates))

    @property
    def depots(self) -> int:
        """Return the number of depots."""
        return -(-self.robots // ROBOTS_PER_DEPOT)

    @property
    def target(self) -> int:
        """Return how many candidates Seq-LIPP is to sample: the number nearest to the coverage asked for."""
        return max(1, round(self.coverage * self.candidates))


def build(specification: Specification, carrier_budget_j: float) -> Mission:
    """Return the instance with the given energy budget for carriers, and its share for precise robots.

    The same arguments give the same mission, to the last digit.
    """
    spec = specification
    places = np.round(_stream(spec, 0).uniform(0.0, spec.side_m, (spec.candidates + spec.depots, 2)), 4)
    ids = [f"v{i}" for i in range(spec.candidates)] + [f"d{i}" for i in range(spec.depots)]
    nodes = [{"id": node, **_xy(place)} for node, place in zip(ids, places, strict=True)]
    for depot in nodes[spec.candidates :]:
        depot["role"] = "depot"
    return Mission.model_validate(
        {
            "format": "malipp-mission/1",
            "name": spec.name,
            "site": {"nodes": nodes, "edges": _edges(spec, ids, places)},
            "field": {
                "kernel": {"family": "rbf", "length_scale_m": spec.length_scale_m},
                "test_points": [_xy(place) for place in _test_points(spec, places)],
            },
            "team": {
                "sample_mass_kg": spec.sample_mass_kg,
                "robots": [_robot(spec, r, carrier_budget_j) for r in range(spec.robots)],
            },
        }
    )


def write_mission(mission: Mission, path: Path) -> None:
    """Write a mission as a YAML file that reads back as the same mission.

    Raises
    ------
    InputError
        When the file cannot be written.
    """
    with whole_file(path) as partial:
        partial.write_text(mission_text(mission), encoding="utf-8")


def mission_text(mission: Mission) -> str:
    """Return the content of a mission's file."""
    yaml = YAML()
    yaml.default_flow_style = None
    yaml.width = 110
    content = mission.model_dump(mode="json", by_alias=True, exclude_defaults=True)
    stream = io.StringIO()
    yaml.dump(content, stream)
    return stream.getvalue()


def _stream(spec: Specification, purpose: int) -> np.random.Generator:
    """Return a source of randomness of its own for each purpose, so that none disturbs another."""
    return np.random.default_rng([spec.seed, spec.robots, spec.candidates, purpose])


def _xy(place: FloatArray) -> dict[str, Any]:
    return {"x_m": float(place[0]), "y_m": float(place[1])}


def _test_points(spec: Specification, places: FloatArray) -> FloatArray:
    if spec.test_points == "candidates":
        return places[: spec.candidates]
    return np.round(_stream(spec, 2).uniform(0.0, spec.side_m, (spec.candidates, 2)), 4)


def _robot(spec: Specification, r: int, carrier_budget_j: float) -> dict[str, Any]:
    precise = r % 2 == 0
    best = TOTAL_PRECISION * spec.noise_ratio / (1.0 + spec.noise_ratio)
    return {
        "id": f"r{r}",
        "start": f"d{r // 2 % spec.depots}",
        "depots": [f"d{d}" for d in range(spec.depots)],
        "empty_mass_kg": 1.0,
        "energy_budget_j": carrier_budget_j * (PRECISE_REACH if precise else 1.0),
        "payload_capacity": PRECISE_CAPACITY if precise else CARRIER_CAPACITY,
        "samples_per_node": 1,
        "noise_variance": 1.0 / best if precise else spec.noise_ratio / best,
        "energy_per_kg_m": 1.0,
        "speed_m_s": 1.0,
    }


def _edges(spec: Specification, ids: list[str], places: FloatArray) -> list[dict[str, Any]]:
    """Return a strongly connected random graph as edges of a mission file."""
    arcs = _random_arcs(spec, len(ids))
    _connect(arcs, places)
    return [
        {"from": ids[u], "to": ids[v]} | ({} if (v, u) in arcs else {"one_way": True})
        for u, v in sorted(arcs)
        if u < v or (v, u) not in arcs
    ]


def _random_arcs(spec: Specification, count: int) -> set[tuple[int, int]]:
    rng = _stream(spec, 1)
    pairs = list(itertools.combinations(range(count), 2))
    joined = rng.permutation(len(pairs))[: round(spec.density * len(pairs))]
    one_way = round(spec.one_way_share * len(joined))
    arcs: set[tuple[int, int]] = set()
    for position, pair in enumerate(joined):
        u, v = pairs[pair]
        both = {(u, v), (v, u)}
        arcs |= both if position >= one_way else {(u, v) if rng.uniform() < 0.5 else (v, u)}
    return arcs


def _connect(arcs: set[tuple[int, int]], places: FloatArray) -> None:
    """Join the two nearest nodes of different strong components until there is one component."""
    away = np.linalg.norm(places[:, None] - places[None], axis=-1)
    graph = nx.DiGraph(arcs)
    graph.add_nodes_from(range(len(places)))
    while True:
        component = np.empty(len(places), dtype=np.int64)
        for label, members in enumerate(nx.strongly_connected_components(graph)):
            component[list(members)] = label
        apart = component[:, None] != component[None]
        if not apart.any():
            return
        u, v = divmod(int(np.where(apart, away, np.inf).argmin()), len(places))
        arcs |= {(u, v), (v, u)}
        graph.add_edges_from([(u, v), (v, u)])
