"""Tiny random missions and states, one for each seed."""

from __future__ import annotations

from typing import Any

import numpy as np

from malipp_field.mission import Cache, Mission, RobotState, TeamState


def tiny_mission(seed: int, *, robots: int = 2, candidates: int = 3, **changes: Any) -> Mission:
    """Return a mission of mixed generality: depots, factors, limits and services vary with the seed.

    ``changes`` replace entries of every robot.
    """
    rng = np.random.default_rng(seed)
    xy = rng.uniform(0.0, 10.0, (candidates, 2))
    nodes: list[dict[str, Any]] = [
        {"id": f"v{i}", "x_m": float(x), "y_m": float(y)} for i, (x, y) in enumerate(xy)
    ]
    nodes.append({"id": "d0", "x_m": 5.0, "y_m": 0.0, "role": "depot"})
    depots = ["d0"]
    if seed % 3 == 0:
        nodes.append({"id": "d1", "x_m": 5.0, "y_m": 9.0, "role": "depot"})
        depots.append("d1")
    if seed % 5 == 0:
        nodes.append({"id": "camp", "x_m": 0.0, "y_m": 5.0, "role": "start"})
    factor = {"r0": float(rng.uniform(0.7, 1.5))}
    edges = [{"from": "v0", "to": "d0", "one_way": seed % 2 == 0, "energy_factor": factor}]
    starts = ["d0", "v0", "camp" if seed % 5 == 0 else "d0"]
    team = []
    for r in range(robots):
        robot: dict[str, Any] = {
            "id": f"r{r}",
            "start": starts[int(rng.integers(3))],
            "depots": [depots[int(rng.integers(len(depots)))]] if rng.uniform() < 0.6 else depots,
            "empty_mass_kg": 1.0,
            "energy_budget_j": float(rng.uniform(14.0, 32.0)),
            "payload_capacity": int(rng.integers(1, 4)),
            "samples_per_node": int(rng.choice([0, 1, 1, 2] if robots == 1 or candidates < 3 else [0, 1, 1])),
            "noise_variance": float(rng.choice([0.03, 0.3])),
            "energy_per_kg_m": float(rng.uniform(0.6, 1.2)),
            "speed_m_s": 1.0,
        }
        team.append(robot | changes)
    return Mission.model_validate(
        {
            "format": "malipp-mission/1",
            "name": f"tiny-{seed}",
            "site": {"nodes": nodes, "edges": edges, "complete": True},
            "field": {
                "kernel": {"family": "rbf", "length_scale_m": 2.5},
                "test_points": [
                    {"x_m": float(x), "y_m": float(y), "weight": float(rng.uniform(0.5, 2.0))}
                    for x, y in rng.uniform(0.0, 10.0, (5, 2))
                ],
            },
            "team": {
                "sample_mass_kg": float(rng.choice([0.0, 0.4, 1.0])),
                "service_time_s": float(rng.choice([0.0, 2.0])),
                "clearance_s": float(rng.choice([0.0, 1.0])),
                "robots": team,
            },
        }
    )


def part_way(mission: Mission, seed: int) -> TeamState:
    """Return a state in which samples are on board, taken already, and lying in a drop."""
    rng = np.random.default_rng(seed)
    ids = [node.id for node in mission.site.nodes if node.role == "candidate"]
    robots = []
    for robot in mission.team.robots:
        taken = ids[int(rng.integers(len(ids)))]
        collected = {taken: 1} if robot.samples_per_node else {}
        robots.append(
            RobotState(
                id=robot.id,
                node=ids[int(rng.integers(len(ids)))],
                ready_s=float(rng.uniform(0.0, 20.0)),
                energy_left_j=robot.energy_budget_j,
                on_board=int(rng.integers(0, 2)),
                collected=collected,
            )
        )
    cache = Cache(node=ids[0], sender=robots[0].id, count=1, available_s=float(rng.uniform(0.0, 30.0)))
    return TeamState(time_s=10.0, robots=tuple(robots), caches=(cache,))
