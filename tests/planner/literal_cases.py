"""A mission made by hand for the literal model, and plans that need not keep its rules."""

from __future__ import annotations

from typing import Any

import numpy as np

from malipp_field.mission import Mission
from malipp_field.planner.extract import Route, TeamPlan, Visit, earliest_departures
from malipp_field.planner.paper.literal import LiteralModel
from malipp_field.planner.paper.literal_plan import assign
from malipp_field.planner.problem import Problem, build_problem

A, B, C, D, E = range(5)
"""Three candidates and two depots, in the order of the mission's nodes."""
END_D, END_E = 5 + D, 5 + E
"""Terminal copies."""
NOISE = 0.1


def bench(**changes: Any) -> Problem:
    """Return three like robots that start at one depot and may end at two; ``changes`` alter all robots."""
    places = {"a": (0.0, 4.0), "b": (3.0, 5.0), "c": (6.0, 4.0)}
    nodes = [{"id": name, "x_m": x, "y_m": y} for name, (x, y) in places.items()]
    nodes += [
        {"id": "d", "x_m": 2.0, "y_m": 0.0, "role": "depot"},
        {"id": "e", "x_m": 5.0, "y_m": 0.5, "role": "depot"},
    ]
    robot = {
        "start": "d", "depots": ["d", "e"], "empty_mass_kg": 1.0, "energy_budget_j": 200.0,
        "payload_capacity": 2, "samples_per_node": 1, "noise_variance": NOISE, "energy_per_kg_m": 1.0,
        "speed_m_s": 1.0,
    }  # fmt: skip
    mission = Mission.model_validate(
        {
            "format": "malipp-mission/1",
            "name": "bench",
            "site": {"nodes": nodes, "complete": True},
            "field": {
                "kernel": {"family": "rbf", "length_scale_m": 2.0},
                "test_points": [{"x_m": 1.0, "y_m": 4.0}, {"x_m": 5.0, "y_m": 4.5, "weight": 2.0}],
            },
            "team": {"sample_mass_kg": 1.0, "robots": [robot | {"id": f"r{i}"} | changes for i in range(3)]},
        }
    )
    return build_problem(mission)


STAY: Route = (Visit(D),)

GOOD: tuple[Route, ...] = (
    (Visit(D), Visit(A, collect=1, drop={1: 1}), Visit(B, collect=1), Visit(D, unload=1)),
    (Visit(D), Visit(C, collect=1), Visit(A, pick={0: 1}), Visit(E, unload=2)),
    STAY,
)


def place(problem: Problem, routes: tuple[Route, ...]) -> LiteralModel:
    """Return the literal model with its variables at routes that may break rules."""
    depart_s = earliest_departures(problem, routes)
    assert depart_s is not None
    precision = problem.gained.copy()
    for robot, route in zip(problem.robots, routes, strict=True):
        for visit in route:
            if visit.collect:
                precision[problem.candidates.index(visit.node)] += visit.collect * robot.precision
    model = LiteralModel(problem)
    assert assign(model, TeamPlan(routes, depart_s, precision, 0.0, 0.0, 0.0))
    return model


def put(model: LiteralModel, name: str, values: dict[Any, float]) -> None:
    """Set single entries of one symbol."""
    family = model.families[name]
    vector = np.array(family.variable.value, dtype=np.float64)
    for key, value in values.items():
        vector[family.position[key]] = value
    family.variable.save_value(vector)


def get(model: LiteralModel, name: str, key: Any) -> float:
    """Return one entry of a symbol."""
    family = model.families[name]
    return float(family.variable.value[family.position[key]])
