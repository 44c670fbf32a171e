"""Small missions of every kind for hypothesis, and what the properties need to know of a plan.

Places come from a seed, so that no two plans tie by symmetry; all else is drawn and shrinks towards fewer
and plainer things.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from hypothesis import strategies as st

from malipp_field.field.kernel import covariance
from malipp_field.mission import (
    Cache,
    Mission,
    RobotState,
    TeamState,
    initial_state,
    locate,
    node_positions,
)
from malipp_field.plan import Plan

_SIZE_M = 8.0


@dataclass(frozen=True)
class Case:
    """All that a planner is given."""

    mission: Mission
    state: TeamState | None = None
    handoffs: bool = True

    def with_robots(self, robots: list[dict[str, Any]]) -> Case:
        """Return the case with other robots; a state speaks of the same ones."""
        return replace(self, mission=changed(self.mission, {"team": {"robots": robots}}))


@st.composite
def missions(draw: st.DrawFn, /, *, robots: int = 3, **changes: Any) -> Mission:
    """Draw a mission of one to ``robots`` robots and two to five candidates, fewer for larger teams.

    ``changes`` replace entries of every robot.
    """
    team = draw(st.integers(1, robots))
    candidates = draw(st.integers(2, 6 - team))
    rng = np.random.default_rng(draw(st.integers(0, 999)))
    two_depots = draw(st.booleans())
    nodes = [_node(rng, f"v{i}") for i in range(candidates)]
    nodes += [_node(rng, "d0", role="depot"), _node(rng, "camp", role="start")]
    nodes += [_node(rng, "d1", role="depot")] if two_depots else []
    return Mission.model_validate(
        {
            "format": "malipp-mission/1",
            "name": "drawn",
            "site": {"nodes": nodes, "edges": _edges(draw), "complete": True},
            "field": {
                "kernel": {"family": "rbf", "length_scale_m": 3.0},
                "test_points": [_place(rng) | {"weight": float(rng.uniform(0.5, 2.0))} for _ in range(4)],
            },
            "team": {
                "sample_mass_kg": draw(st.sampled_from([0.5, 0.0, 1.0])),
                "service_time_s": draw(st.sampled_from([0.0, 2.0])),
                "clearance_s": draw(st.sampled_from([0.0, 1.0])),
                "robots": [
                    _robot(draw, f"r{r}", candidates, two_depots=two_depots) | changes for r in range(team)
                ],
            },
        }
    )


def _place(rng: np.random.Generator) -> dict[str, Any]:
    x_m, y_m = rng.uniform(0.0, _SIZE_M, 2)
    return {"x_m": float(x_m), "y_m": float(y_m)}


def _node(rng: np.random.Generator, name: str, role: str = "candidate") -> dict[str, Any]:
    return {"id": name, "role": role} | _place(rng)


def _edges(draw: st.DrawFn) -> list[dict[str, Any]]:
    """Draw edges that are not as straight ones would be: one way, dearer, or closed to a robot."""
    kinds: list[dict[str, Any]] = [
        {"from": "v0", "to": "d0", "one_way": True},
        {"from": "v1", "to": "d0", "energy_factor": {"r0": 1.5}},
        {"from": "v0", "to": "v1", "closed_to": ["r0"]},
    ]
    return [kind for kind in kinds if draw(st.booleans())]


def _robot(draw: st.DrawFn, name: str, candidates: int, *, two_depots: bool) -> dict[str, Any]:
    depots = [["d0"], ["d0", "d1"], ["d1"]] if two_depots else [["d0"]]
    return {
        "id": name,
        "start": draw(st.sampled_from(["d0", "camp", "v0"])),
        "depots": draw(st.sampled_from(depots)),
        "empty_mass_kg": 1.0,
        "energy_budget_j": float(draw(st.integers(6, 30))),
        "payload_capacity": draw(st.sampled_from([1, 2, 3, 2, 1, 0])),
        "samples_per_node": draw(st.sampled_from([1, 2, 0, 1] if candidates < 4 else [1, 0, 1])),
        "noise_variance": draw(st.sampled_from([0.3, 0.03])),
        "energy_per_kg_m": draw(st.sampled_from([1.0, 0.7])),
        "speed_m_s": draw(st.sampled_from([1.0, 2.0])),
    }


@st.composite
def states(draw: st.DrawFn, /, mission: Mission) -> TeamState:
    """Draw a state in which samples may be on board, taken already, and lying in a drop."""
    ids = [node.id for node in mission.site.nodes if node.role == "candidate"]
    places = st.sampled_from(ids[:3])
    robots = [
        RobotState(
            id=robot.id,
            node=draw(places),
            ready_s=draw(st.sampled_from([0.0, 7.0])),
            energy_left_j=robot.energy_budget_j,
            on_board=draw(st.integers(0, min(1, robot.payload_capacity))),
            collected={draw(places): 1} if robot.samples_per_node and draw(st.booleans()) else {},
        )
        for robot in mission.team.robots
    ]
    cache = Cache(node=ids[0], sender=robots[0].id, count=1, available_s=draw(st.sampled_from([0.0, 20.0])))
    barren = draw(st.sampled_from([(), (), (ids[0],), (ids[-1],)]))
    return TeamState(robots=tuple(robots), caches=(cache,) if draw(st.booleans()) else (), barren=barren)


@st.composite
def cases(draw: st.DrawFn, /, **changes: Any) -> Case:
    """Draw a mission from its beginning or part-way, with handoffs or without."""
    mission = draw(missions(**changes))
    state = draw(st.none() | states(mission))
    return Case(mission, state, draw(st.sampled_from([True, True, False])))


def changed(mission: Mission, changes: dict[str, Any]) -> Mission:
    """Return the mission with entries of its sections replaced, section by section."""
    record = mission.model_dump(mode="json", by_alias=True, exclude_none=True)
    for section, entries in changes.items():
        record[section] = record[section] | entries
    return Mission.model_validate(record)


def robot_records(mission: Mission) -> list[dict[str, Any]]:
    """Return the robots as in a mission file, to be changed."""
    return [robot.model_dump() for robot in mission.team.robots]


def posterior(mission: Mission, samples: dict[str, dict[str, int]]) -> float:
    """Return J of the samples taken, by robot and node, as the variance left after conditioning on them."""
    precision: dict[str, float] = {}
    for robot, taken in samples.items():
        for node, count in taken.items():
            precision[node] = precision.get(node, 0.0) + count / mission.robot(robot).noise_variance
    known = [node for node, p in precision.items() if p]
    kernel, places, tests = mission.field.kernel, node_positions(mission), mission.field.test_points
    v = np.array([places[node] for node in known]).reshape(-1, 2)
    t = np.array([locate(point, mission.site.origin) for point in tests])
    noisy = covariance(kernel, v, v) + np.diag([1.0 / precision[node] for node in known])
    cross = covariance(kernel, t, v)
    left = kernel.variance - np.einsum("tv,vt->t", cross, np.linalg.solve(noisy, cross.T))
    return float(np.array([point.weight for point in tests]) @ left)


def samples_of(case: Case, plan: Plan) -> dict[str, dict[str, int]]:
    """Return the samples taken before and in the plan, by robot and node."""
    state = case.state or initial_state(case.mission)
    found = {robot.id: dict(robot.collected) for robot in state.robots}
    for robot in plan.robots:
        for stop in robot.route:
            if stop.collect:
                taken = found[robot.id]
                taken[stop.node] = taken.get(stop.node, 0) + stop.collect
    return found
