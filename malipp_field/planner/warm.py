"""Compile the planner's inner loops before anybody waits for a plan (``python -m`` this module).

Numba keeps what it has compiled beside the source files; the first plan on a machine would pay for it. What
is compiled here is told by `malipp_field.planner.kernels`; where all is on disk already this takes seconds.
"""

from __future__ import annotations

import numpy as np

from malipp_field.mission import Mission
from malipp_field.planner.closure_kernel import cheapest_ways
from malipp_field.planner.exact.schedules import robots_of
from malipp_field.planner.problem import build_problem
from malipp_field.planner.solve import solve

_LIMIT_S = 600.0


def main() -> None:
    """Plan a mission so small that all the time goes into compiling."""
    equipment = {
        "start": "depot", "depots": ["depot"], "empty_mass_kg": 1.0, "energy_budget_j": 40.0,
        "payload_capacity": 2, "samples_per_node": 1, "noise_variance": 0.1, "energy_per_kg_m": 1.0,
        "speed_m_s": 1.0,
    }  # fmt: skip
    mission = Mission.model_validate(
        {
            "format": "malipp-mission/1",
            "name": "warm",
            "site": {
                "nodes": [
                    {"id": "depot", "x_m": 0.0, "y_m": 0.0, "role": "depot"},
                    {"id": "near", "x_m": 3.0, "y_m": 0.0},
                    {"id": "far", "x_m": 6.0, "y_m": 1.0},
                ],
                "complete": True,
            },
            "field": {
                "kernel": {"family": "rbf", "length_scale_m": 2.0},
                "test_points": [{"x_m": 4.0, "y_m": 1.0}],
            },
            "team": {
                "sample_mass_kg": 1.0,
                "robots": [{"id": "one", **equipment}, {"id": "other", **equipment}],
            },
        }
    )
    solve(mission, method="exact", time_limit_s=_LIMIT_S)
    one, fares = np.zeros(1, dtype=np.int64), np.zeros(0)
    cheapest_ways(np.zeros(2, dtype=np.int64), one[:0], fares, fares, one, 0.0)  # large sites only
    robot = robots_of(build_problem(mission))[0]  # pricing, which so small a mission does without
    none = np.zeros(0, dtype=np.int64)
    robot.price(
        np.zeros((len(robot.places), robot.width)),
        (none, none, np.zeros((0, robot.width, robot.width))),
        0.0,
        exact_load=False,
    )


if __name__ == "__main__":
    main()
