"""Missions whose most informative plan would have two robots wait for each other's drop."""

from __future__ import annotations

from typing import Any

from malipp_field.mission import Mission

_PLACES = {
    "sa": (0.0, 0.0), "sb": (9.0, 9.0), "u": (1.0, 0.0), "v": (8.0, 9.0),
    "ca": (3.0, 5.0), "cb": (6.0, 4.0), "e": (0.5, 1.0),
    "da": (2.0, 2.0), "db": (7.0, 7.0), "ta": (8.5, 3.0), "tb": (0.5, 6.0), "tc": (1.0, -1.0),
}  # fmt: skip
_DEPOTS = ("u", "v", "da", "db", "ta", "tb", "tc")


def circle(*, samples: int = 1, budget_j: float = 10.5, extra: bool = False) -> Mission:
    """Return two robots on one-way roads of 1 m (the last one 3 m), each needing the other's drop.

    A drives sa, u, da, ca, v, ta and B sb, v, db, cb, u, tb. Nobody can bring his own sample down his last
    road: that of A at ca has to be dropped at v for B, who unloads it at db, and B's at cb at u for A. But A
    is at u before v, and B at v before u: only one of both samples can be had.

    With ``extra`` A may also go sa, da, ca, v, u, tc: then both can be had. But if A samples at e as well,
    before u, its energy suffices for the circle only.
    """
    roads = {"A": ["sa u", "u da", "da ca", "ca v"], "B": ["sb v", "v db", "db cb", "cb u"]}
    if extra:
        roads["A"] += ["sa da", "sa e", "e u", "u tc"]
    edges = [_road(robot, road, 1.0) for robot in roads for road in roads[robot]]
    edges += [_road("A", "v ta", 5.0 if extra else 3.0), _road("B", "u tb", 3.0)]
    edges += [_road("A", "v u", 6.0)] if extra else []
    nodes = [
        {"id": node, "x_m": x, "y_m": y, "role": _role(node)} for node, (x, y) in _PLACES.items()
        if extra or node not in {"e", "tc"}
    ]  # fmt: skip
    robot = {
        "empty_mass_kg": 1.0, "payload_capacity": 2, "samples_per_node": samples, "noise_variance": 0.1,
        "energy_per_kg_m": 1.0, "speed_m_s": 1.0,
    }  # fmt: skip
    return Mission.model_validate(
        {
            "format": "malipp-mission/1", "name": "circle",
            "site": {"nodes": nodes, "edges": edges},
            "field": {
                "kernel": {"family": "rbf", "length_scale_m": 1.0},
                "test_points": [
                    {"x_m": _PLACES[c][0], "y_m": _PLACES[c][1], "weight": weight}
                    for c, weight in (("ca", 1.0), ("cb", 0.8), ("e", 0.1))
                ],
            },
            "team": {
                "sample_mass_kg": 1.0,
                "robots": [
                    robot | {"id": "A", "start": "sa", "energy_budget_j": 14.2 if extra else budget_j,
                             "depots": ["da", "ta", "tc"] if extra else ["da", "ta"]},
                    robot | {"id": "B", "start": "sb", "energy_budget_j": budget_j, "depots": ["db", "tb"]},
                ],
            },
        }
    )  # fmt: skip


def _role(node: str) -> str:
    return "depot" if node in _DEPOTS else "start" if node.startswith("s") else "candidate"


def _road(robot: str, ends: str, length: float) -> dict[str, Any]:
    tail, head = ends.split()
    other = {"A": "B", "B": "A"}[robot]
    return {"from": tail, "to": head, "one_way": True, "length_m": length, "closed_to": [other]}
