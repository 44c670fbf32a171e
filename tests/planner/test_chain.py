"""Ways over several drops: found where nothing simpler fits, kept to every rule, never a failed insertion."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

import pytest
from brute_force import optimum

from malipp_field.bench.instances import Specification, build
from malipp_field.mission import Mission
from malipp_field.planner import solve, verify
from malipp_field.planner.draft import Sample, draft_of
from malipp_field.planner.extract import Verdict, plan_file
from malipp_field.planner.linear import Effort
from malipp_field.planner.problem import Problem, build_problem
from malipp_field.planner.search.improver import Improver
from malipp_field.planner.search.kernel import FAILED

FOREVER = Effort(deadline=math.inf)
LEGS_M = 3.0, 6.0, 4.0, 2.0
"""From the first of four nodes on a street to the depot at its end."""


def relay(*, spare_kg_m: tuple[float, float] = (7.0, 8.0), noise_variance: float = 0.1) -> Mission:
    """Return a street along which two robots drive to its end, each able to carry a sample so far.

    7 = 3 + 4 and 8 = 6 + 2: no other sharing of the legs fits, so that a sample of the first robot changes
    hands at the second, the third and the fourth node. The second robot takes no samples.
    """
    nodes: list[dict[str, Any]] = [{"id": "start", "x_m": -1.0, "y_m": 0.0, "role": "start"}]
    for i, leg in enumerate((0.0, *LEGS_M)):
        x = nodes[-1]["x_m"] + (leg or 1.0)
        nodes.append({"id": f"v{i}", "x_m": x, "y_m": 0.0})
    nodes[-1] |= {"id": "end", "role": "depot"}
    ids = [node["id"] for node in nodes]
    robots = [
        {
            "id": name, "start": "start", "depots": ["end"], "empty_mass_kg": 1.0, "payload_capacity": 1,
            "energy_budget_j": 1.0 + sum(LEGS_M) + spare + 0.01, "samples_per_node": int(name == "taker"),
            "noise_variance": noise_variance, "energy_per_kg_m": 1.0, "speed_m_s": 1.0,
        }
        for name, spare in zip(("taker", "helper"), spare_kg_m, strict=True)
    ]  # fmt: skip
    return Mission.model_validate(
        {
            "format": "malipp-mission/1",
            "name": "relay",
            "site": {
                "nodes": nodes,
                "edges": [{"from": u, "to": v} for u, v in pairwise(ids)],
            },
            "field": {
                "kernel": {"family": "rbf", "length_scale_m": 0.2},
                "test_points": [{"x_m": 0.0, "y_m": 0.0}],
            },
            "team": {"sample_mass_kg": 1.0, "robots": robots},
        }
    )


def samples(problem: Problem, iterations: int, seed: int = 0) -> tuple[float, list[Sample]]:
    """Return J and the samples, with their ways, of a plan from ruin and recreate."""
    improver = Improver(problem, seed)
    start = improver.construct()
    assert start is not None
    team = improver.improve(start, iterations, FOREVER)
    return team.information, draft_of(problem, team).samples


@pytest.mark.parametrize("seed", range(3))
def test_a_sample_goes_back_and_forth_between_two_robots(seed: int) -> None:
    mission = relay()
    problem = build_problem(mission)
    information, found = samples(problem, 500, seed)
    truth = optimum(mission)
    assert truth is not None
    assert information == pytest.approx(truth[0], rel=1e-9)
    names = [[(problem.nodes[v], problem.robots[r].id) for v, r in sample.hops] for sample in found]
    assert names == [[("v1", "helper"), ("v2", "taker"), ("v3", "helper")]]
    exact = solve(mission, method="exact")
    assert exact.objective is not None
    assert exact.objective.information == pytest.approx(information, rel=1e-9)


@pytest.mark.parametrize("spare_kg_m", [(6.9, 8.0), (7.0, 7.9)])
def test_nothing_is_taken_where_one_of_them_falls_short_of_a_leg(spare_kg_m: tuple[float, float]) -> None:
    mission = relay(spare_kg_m=spare_kg_m)
    information, found = samples(build_problem(mission), 500)
    assert not found
    truth = optimum(mission)
    assert truth is not None
    assert information == pytest.approx(truth[0], rel=1e-9)


@pytest.mark.parametrize("seed", range(6))
def test_ways_found_can_always_be_put_in(seed: int) -> None:
    mission = build(Specification(3, 10, seed), 24.0)
    problem = build_problem(mission)
    improver = Improver(problem, seed)
    start = improver.construct()
    assert start is not None
    team = improver.improve(start, 4000, FOREVER)
    assert improver._kernel.counters[FAILED] == 0
    plan = plan_file(mission.name, problem, team, Verdict("exact", "feasible", None, None, 0.0, 0, 1))
    assert not verify(mission, plan)
