"""Small missions with plans made by hand; what follows from a route (loads, energies, times) is filled in."""

from __future__ import annotations

import json
from collections.abc import Mapping
from copy import deepcopy
from dataclasses import dataclass, field
from itertools import pairwise
from types import MappingProxyType
from typing import Any

import numpy as np

from malipp_field.field import candidate_ids, information_model
from malipp_field.mission import Mission, TeamState, initial_state, parse_mission, passages
from malipp_field.plan import Plan

Routes = dict[str, list[dict[str, Any]]]
FIELD = {
    "kernel": {"family": "matern32", "length_scale_m": 15.0, "variance": 2.0},
    "test_points": [{"x_m": 5.0, "y_m": 3.0}, {"x_m": 25.0, "y_m": -2.0, "weight": 2.5}],
}


def stop(node: str, path: str = "", **fields: Any) -> dict[str, Any]:
    """A stop; ``path`` names the nodes of the leg in one string."""
    return {"node": node, **({"path": path.split()} if path else {}), **fields}


def robot(robot_id: str, **fields: Any) -> dict[str, Any]:
    usual = {
        "id": robot_id, "start": "base", "depots": ["base"], "empty_mass_kg": 1.0, "energy_budget_j": 100.0,
        "payload_capacity": 2, "samples_per_node": 1, "noise_variance": 0.1, "energy_per_kg_m": 1.0,
        "speed_m_s": 1.0,
    }  # fmt: skip
    return usual | fields


@dataclass
class Scene:
    """A mission, the state of its team and a plan, all open to change until they are built."""

    mission: dict[str, Any]
    routes: Routes
    state: dict[str, Any] | None = None
    plan: dict[str, Any] = field(default_factory=dict)
    """What the plan file says beside or instead of what follows from the routes."""

    def team(self, robot_id: str) -> dict[str, Any]:
        """The robot of that id in the mission file."""
        return next(entry for entry in self.mission["team"]["robots"] if entry["id"] == robot_id)

    def begin(self, robot_id: str) -> dict[str, Any]:
        """The robot of that id in the state."""
        assert self.state is not None
        return next(entry for entry in self.state["robots"] if entry["id"] == robot_id)

    def build(self) -> tuple[Mission, Plan, TeamState | None]:
        mission = parse_mission(json.dumps(self.mission))
        state = None if self.state is None else TeamState.model_validate(self.state)
        return mission, plan_of(mission, self.routes, state, self.plan), state


def plan_of(
    mission: Mission,
    routes: Routes,
    state: TeamState | None = None,
    plan: Mapping[str, Any] = MappingProxyType({}),
) -> Plan:
    """The plan in which every robot follows its route as early as it can.

    Fields that a stop gives itself (payload, leg_energy_j, depart_s ...) are kept; ``plan`` is what the file
    says beside or instead of what follows from the routes.
    """
    begin = state or initial_state(mission)
    filled = {robot_id: _filled(mission, begin, robot_id, route) for robot_id, route in routes.items()}
    stated = {
        "mission": mission.name, "method": "hand", "status": "feasible", "solve_time_s": 0.0,
        "objective": _objective(mission, begin, filled),
        "robots": [{"id": robot_id, "route": route} for robot_id, route in filled.items()],
    }  # fmt: skip
    return Plan.model_validate(stated | dict(plan))


def _filled(
    mission: Mission, begin: TeamState, robot_id: str, route: list[dict[str, Any]]
) -> list[dict[str, Any]]:
    known = next((r for r in mission.team.robots if r.id == robot_id), mission.team.robots[0])
    state, beta_s = begin.robot(known.id), mission.team.service_time_s
    roads = {(p.tail, p.head): p for p in passages(mission, known.id)}
    load, left_s = state.on_board, state.ready_s
    filled = []
    for index, given in enumerate(route):
        there_s, leg = left_s, {}
        if index:
            steps = [roads[step] for step in pairwise(given.get("path", [])) if step in roads]
            mass_kg = known.empty_mass_kg + mission.team.sample_mass_kg * load
            there_s = left_s + sum(p.time_s for p in steps)
            leg = {"arrive_s": there_s, "leg_energy_j": sum(p.energy_per_kg for p in steps) * mass_kg}
        load += given.get("collect", 0) - given.get("unload", 0)
        load += sum(given.get("pick", {}).values()) - sum(given.get("drop", {}).values())
        made = leg | {"depart_s": there_s + beta_s, "payload": load} | given
        load, left_s = made["payload"], made["depart_s"]
        filled.append(made)
    return filled


def _objective(mission: Mission, begin: TeamState, routes: Routes) -> dict[str, float]:
    candidates = candidate_ids(mission)
    precision = np.zeros(len(candidates))
    for known in mission.team.robots:
        taken = list(begin.robot(known.id).collected.items())
        taken += [(made["node"], made.get("collect", 0)) for made in routes.get(known.id, [])]
        for node, count in taken:
            if node in candidates:
                precision[candidates.index(node)] += count / known.noise_variance
    return {
        "information": information_model(mission).value(precision),
        "energy_j": sum(made.get("leg_energy_j") or 0.0 for route in routes.values() for made in route),
        "makespan_s": max(route[-1]["depart_s"] for route in routes.values()),
    }


def _mission(
    nodes: list[dict[str, Any]], edges: list[dict[str, Any]], *robots: dict[str, Any]
) -> dict[str, Any]:
    team = {"sample_mass_kg": 1.0, "service_time_s": 2.0, "clearance_s": 3.0, "robots": list(robots)}
    site = {"nodes": nodes, "edges": edges}
    return deepcopy(
        {"format": "malipp-mission/1", "name": "small", "site": site, "field": FIELD, "team": team}
    )


def _line() -> dict[str, Any]:
    """Base, a, h and b in a line, 10 m apart; scout, carrier and one that need not move."""
    places: Mapping[str, float] = {"a": 10.0, "h": 20.0, "b": 30.0}
    nodes = [{"id": "base", "x_m": 0.0, "y_m": 0.0, "role": "depot"}]
    nodes += [{"id": node, "x_m": x_m, "y_m": 0.0} for node, x_m in places.items()]
    edges = [{"from": "base", "to": "a"}, {"from": "a", "to": "h"}, {"from": "h", "to": "b"}]
    carrier = robot(
        "carrier", empty_mass_kg=4.0, energy_budget_j=300.0, payload_capacity=3, samples_per_node=2,
        noise_variance=0.5,
    )  # fmt: skip
    return _mission(nodes, edges, robot("scout"), carrier, robot("idle"))


def dead_drop() -> Scene:
    """The scout samples b and drops it at h; the carrier samples h, fetches that and brings both home."""
    return Scene(
        _line(),
        {
            "scout": [
                stop("base"),
                stop("b", "base a h b", collect=1),
                stop("h", "b h", drop={"carrier": 1}),
                stop("base", "h a base"),
            ],
            "carrier": [
                stop("base"),
                stop("h", "base a h", collect=1, pick={"scout": 1}, depart_s=51.0),
                stop("base", "h a base", unload=2),
            ],
            "idle": [stop("base")],
        },
    )


def mid_route() -> Scene:
    """One robot takes a, unloads at the yard, takes b, and ends at base; another stays where it is."""
    nodes = [
        {"id": "base", "x_m": 0.0, "y_m": 0.0, "role": "depot"},
        {"id": "yard", "x_m": 20.0, "y_m": 0.0, "role": "depot"},
        {"id": "a", "x_m": 10.0, "y_m": 0.0},
        {"id": "b", "x_m": 20.0, "y_m": 5.0},
    ]
    edges = [{"from": "base", "to": "a"}, {"from": "a", "to": "yard"}, {"from": "yard", "to": "b"}]
    depots = ["base", "yard"]
    routes = {
        "scout": [
            stop("base"),
            stop("a", "base a", collect=1),
            stop("yard", "a yard", unload=1),
            stop("b", "yard b", collect=1),
            stop("base", "b yard a base", unload=1),
        ],
        "idle": [stop("base")],
    }
    return Scene(_mission(nodes, edges, robot("scout", depots=depots), robot("idle", depots=depots)), routes)


def one_way() -> Scene:
    """Out over one via node, home over another; the direct way is dear, and a short one is closed."""
    nodes = [
        {"id": "base", "x_m": 0.0, "y_m": 0.0, "role": "depot"},
        {"id": "out", "x_m": 10.0, "y_m": 5.0, "role": "via"},
        {"id": "home", "x_m": 10.0, "y_m": -5.0, "role": "via"},
        {"id": "a", "x_m": 20.0, "y_m": 0.0},
    ]
    edges: list[dict[str, Any]] = [
        {"from": "base", "to": "out", "length_m": 12.0, "one_way": True},
        {"from": "out", "to": "a", "length_m": 12.0, "one_way": True, "speed_factor": {"scout": 0.5}},
        {"from": "a", "to": "home", "length_m": 12.0, "one_way": True},
        {"from": "home", "to": "base", "length_m": 12.0, "one_way": True, "energy_factor": {"scout": 1.5}},
        {"from": "base", "to": "a", "energy_factor": {"scout": 5.0}},
        {"from": "out", "to": "home", "length_m": 1.0, "closed_to": ["scout"]},
    ]
    routes = {
        "scout": [stop("base"), stop("a", "base out a", collect=1), stop("base", "a home base", unload=1)]
    }
    return Scene(_mission(nodes, edges, robot("scout", energy_budget_j=400.0)), routes)


def residual() -> Scene:
    """The dead drop half done: the sample of b lies at h, the carrier is under way with one of its own."""
    state = {
        "time_s": 30.0,
        "robots": [
            {"id": "scout", "node": "h", "ready_s": 46.0, "energy_left_j": 25.0, "collected": {"b": 1}},
            {
                "id": "carrier", "node": "a", "ready_s": 30.0, "energy_left_j": 200.0, "on_board": 1,
                "collected": {"a": 1},
            },
            {"id": "idle", "node": "base", "energy_left_j": 0.0, "ready_s": 2.0},
        ],
        "caches": [{"node": "h", "sender": "scout", "count": 1, "available_s": 49.0}],
    }  # fmt: skip
    routes = {
        "scout": [stop("h"), stop("base", "h a base")],
        "carrier": [
            stop("a"),
            stop("h", "a h", pick={"scout": 1}, depart_s=51.0),
            stop("base", "h a base", unload=2),
        ],
        "idle": [stop("base")],
    }
    return Scene(_line(), routes, state)
