"""A street base - a - b - c with a robot at each end of it."""

from __future__ import annotations

from malipp_field.mission import Mission
from malipp_field.planner.problem import Problem, build_problem

A, B, C, BASE = range(4)


def street(*, energy_budget_j: float = 40.0) -> Problem:
    """Return the problem; "near" starts at the base, "far" at c."""
    nodes = [{"id": node, "x_m": float(x), "y_m": 0.0} for x, node in enumerate("abc", start=1)]
    nodes.append({"id": "base", "x_m": 0.0, "y_m": 0.0, "role": "depot"})
    robot = {
        "start": "base", "depots": ["base"], "empty_mass_kg": 1.0, "energy_budget_j": energy_budget_j,
        "payload_capacity": 2, "samples_per_node": 1, "noise_variance": 0.1, "energy_per_kg_m": 1.0,
        "speed_m_s": 0.5,
    }  # fmt: skip
    edges = [{"from": u, "to": v} for u, v in (("base", "a"), ("a", "b"), ("b", "c"))]
    return build_problem(
        Mission.model_validate(
            {
                "format": "malipp-mission/1",
                "name": "street",
                "site": {"nodes": nodes, "edges": edges},
                "field": {
                    "kernel": {"family": "rbf", "length_scale_m": 1.0},
                    "test_points": [{"x_m": 1.0, "y_m": 0.0}],
                },
                "team": {
                    "sample_mass_kg": 1.0,
                    "robots": [{"id": "near", **robot}, {"id": "far", **robot, "start": "c"}],
                },
            }
        )
    )
