"""What the planner makes of random missions, with ground that is in the way and hardware of every kind."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
from check_cases import BY_OUTPUTS, rules
from shapely.geometry import Point, Polygon

from malipp_field.mission import Mission, parse_mission
from malipp_field.plan import Plan, advance, rest_of
from malipp_field.planner import solve, verify
from malipp_field.vehicle.check import check
from malipp_field.vehicle.compile import Custody

PAYLOADS: list[Any] = ["script", "manual", BY_OUTPUTS]
SITE_M = 80.0


def walled_mission(seed: int) -> Mission:
    """Return a mission on a fenced site with two keep-outs, all nodes outside of these."""
    rng = np.random.default_rng(seed)
    blocks = [_triangle(rng) for _ in range(2)]
    free: list[tuple[float, float]] = []
    while len(free) < 6:
        place = rng.uniform(0.0, SITE_M, 2)
        if not any(block.buffer(1.0).contains(Point(place)) for block in blocks):
            free.append((float(place[0]), float(place[1])))
    nodes = [{"id": f"n{i}", "x_m": x, "y_m": y} for i, (x, y) in enumerate(free)]
    nodes[0]["role"] = nodes[1]["role"] = "depot"
    corners = [(-1.0, -1.0), (SITE_M + 1, -1.0), (SITE_M + 1, SITE_M + 1), (-1.0, SITE_M + 1)]
    record = {
        "format": "malipp-mission/1",
        "name": f"walled-{seed}",
        "site": {
            "origin": {"lat_deg": float(rng.uniform(-70, 70)), "lon_deg": float(rng.uniform(-180, 180))},
            "nodes": nodes,
            "complete": True,
            "fence": [{"x_m": x, "y_m": y} for x, y in corners],
            "keep_outs": [
                {"id": f"k{i}", "polygon": [{"x_m": x, "y_m": y} for x, y in block.exterior.coords[:-1]]}
                for i, block in enumerate(blocks)
            ],
        },
        "field": {
            "kernel": {"family": "rbf", "length_scale_m": 20.0},
            "test_points": [{"x_m": x, "y_m": y} for x, y in free[2:]],
        },
        "team": {
            "sample_mass_kg": 1.0,
            "service_time_s": 60.0,
            "robots": [_robot(f"r{i}", rng) for i in range(2)],
        },
        "vehicles": {
            f"r{i}": {"payload": PAYLOADS[(seed + i) % len(PAYLOADS)], "gate": "time"} for i in range(2)
        },
    }
    return parse_mission(json.dumps(record))  # every JSON document is a YAML one


def _triangle(rng: np.random.Generator) -> Polygon:
    middle = rng.uniform(20.0, SITE_M - 20.0, 2)
    angles = rng.uniform(0.0, 1.5, 3) + np.array([0.0, 2.0, 4.0])
    return Polygon([(middle[0] + 12.0 * np.cos(a), middle[1] + 12.0 * np.sin(a)) for a in angles])


def _robot(name: str, rng: np.random.Generator) -> dict[str, Any]:
    return {
        "id": name,
        "start": "n0",
        "depots": ["n0", "n1"],
        "empty_mass_kg": 10.0,
        "energy_budget_j": float(rng.uniform(3000.0, 6000.0)),
        "payload_capacity": 2,
        "samples_per_node": 1,
        "noise_variance": 0.1,
        "energy_per_kg_m": 1.0,
        "speed_m_s": 1.0,
    }


def planned(mission: Mission) -> Plan:
    return solve(mission, method="fast", work_limit=3, mip_gap=0.2, threads=1)


@pytest.mark.parametrize("seed", range(5))
def test_plans_of_the_planner_have_no_errors(seed: int) -> None:
    mission = walled_mission(seed)
    plan = planned(mission)
    assert verify(mission, plan) == []
    assert rules(check(mission, plan, start_s=1_800_000_000.0), "error") == set()


def test_nor_has_what_is_left_of_one() -> None:
    mission = walled_mission(1)
    plan = planned(mission)
    assert plan.objective is not None
    for share in (0.2, 0.5, 0.8):
        time_s = share * plan.objective.makespan_s
        state, rest = advance(mission, plan, time_s), rest_of(plan, time_s)
        tags = iter(range(1, 100))
        custody = Custody(
            {robot.id: tuple(next(tags) for _ in range(robot.on_board)) for robot in state.robots},
            {(c.node, c.sender): tuple(next(tags) for _ in range(c.count)) for c in state.caches},
            next_tag=100,
        )
        found = check(mission, rest, start_s=1_800_000_000.0, custody=custody, state=state)
        assert rules(found, "error") == set()
