"""The exact methods against each other, and against exhaustive search where that is quick.

They share no model: schedules of whole robots ("exact"), an outer approximation over arcs ("arcs"), and the
paper's equations one by one in another solver ("miqp"). The same optimum, three times, is no accident.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from brute_force import optimum
from random_missions import part_way, tiny_mission

from malipp_field.mission import Mission, TeamState
from malipp_field.mission.schema import Method
from malipp_field.plan import Plan
from malipp_field.planner import solve, verify

_GAP = 1e-6
_LIMIT_S = 200.0
"""Generous: what is to be seen is proof, not speed."""
_METHODS: tuple[Method, ...] = ("exact", "arcs", "miqp")


def figures(mission: Mission, state: TeamState | None, method: Method, **options: Any) -> Any:
    """Return the proven lexicographic optimum by a method, infinite where it proves that there is no plan."""
    plan: Plan = solve(mission, state=state, method=method, mip_gap=_GAP, time_limit_s=_LIMIT_S, **options)
    assert plan.method == (method if method != "exact" or options.get("handoffs", True) else "no-handoffs")
    if plan.status == "infeasible":
        assert plan.reason
        return (math.inf, math.inf, math.inf)
    assert plan.status == "optimal"
    assert plan.objective is not None
    assert not verify(mission, plan, state)
    return (plan.objective.information, plan.objective.energy_j, plan.objective.makespan_s)


def compare(mission: Mission, state: TeamState | None = None, *, tiny: bool = False, **options: Any) -> None:
    """Solve by every method; a ``tiny`` mission also by listing every schedule, which says no makespan."""
    found = {method: figures(mission, state, method, **options) for method in _METHODS}
    for method in _METHODS:
        assert found[method] == pytest.approx(found["miqp"], rel=4 * _GAP, abs=1e-9), found
    if tiny:
        truth = optimum(mission, state, **options) or (math.inf, math.inf)
        assert found["miqp"][:2] == pytest.approx(truth, rel=4 * _GAP, abs=1e-9)


def rugged(seed: int) -> Mission:
    """Return a mission on roads: not every node is joined to every other, nor for everybody alike.

    Junctions, a keep-out, one-way roads, closures and speeds by robot, three sensors, a Matérn kernel, an
    energy reserve.
    """
    rng = np.random.default_rng(seed)
    record = tiny_mission(seed, robots=2 + seed % 2, candidates=2 + (seed + 1) % 2).model_dump(
        mode="json", by_alias=True, exclude_none=True
    )
    site, robots = record["site"], record["team"]["robots"]
    site["nodes"] += [
        {"id": f"j{i}", "role": "via", "x_m": float(x), "y_m": float(y)}
        for i, (x, y) in enumerate(rng.uniform(2.0, 8.0, (2, 2)))
    ]
    ids = [node["id"] for node in site["nodes"]]
    order = [ids[i] for i in rng.permutation(len(ids))]
    roads = list(zip(order, order[1:] + order[:1], strict=True))
    roads += [(order[i], order[(i + 3) % len(order)]) for i in range(0, len(order), 2)]
    site["edges"] = [_road(rng, tail, head, [robot["id"] for robot in robots]) for tail, head in roads]
    site["complete"] = False
    for robot, noise_variance in zip(robots, (0.03, 0.1, 0.5), strict=False):
        robot["noise_variance"] = noise_variance
        robot["energy_budget_j"] *= 1.5
    record["field"]["kernel"] = {"family": ["matern32", "matern52"][seed % 2], "length_scale_m": 3.0}
    record["planner"] = {"energy_reserve": float(rng.choice([0.0, 0.1]))}
    return Mission.model_validate(record)


def _road(rng: np.random.Generator, tail: str, head: str, robots: list[str]) -> dict[str, Any]:
    return {
        "from": tail,
        "to": head,
        "one_way": bool(rng.uniform() < 0.2),
        "energy_factor": {robots[0]: float(rng.uniform(0.8, 1.5))},
        "speed_factor": {robots[-1]: float(rng.uniform(0.5, 1.0))},
        "closed_to": [robots[1]] if rng.uniform() < 0.15 else [],
    }


@pytest.mark.parametrize(
    ("seed", "candidates"), [(202, 2), (203, 2), (204, 2), (200, 3), (209, 3), (210, 3), (226, 3)]
)
def test_two_robots_that_hand_over(seed: int, candidates: int) -> None:
    compare(tiny_mission(seed, candidates=candidates), tiny=candidates == 2)


@pytest.mark.parametrize("seed", [301, 302, 303, 304])
def test_two_robots_that_may_not(seed: int) -> None:
    compare(tiny_mission(seed, candidates=3), tiny=True, handoffs=False)


@pytest.mark.parametrize("seed", [311, 312, 313, 314])
def test_three_robots(seed: int) -> None:
    compare(tiny_mission(seed, robots=3, candidates=2))


@pytest.mark.parametrize("seed", [321, 322, 323, 324])
def test_one_robot(seed: int) -> None:
    compare(tiny_mission(seed, robots=1, candidates=4), tiny=True)


@pytest.mark.parametrize("seed", [331, 332, 333, 334, 335, 336])
def test_rugged_sites(seed: int) -> None:
    compare(rugged(seed))


@pytest.mark.parametrize("seed", [341, 342, 343, 344, 345, 350])
def test_part_way_through_a_mission(seed: int) -> None:
    mission = tiny_mission(seed, robots=2 + seed % 2, candidates=2)
    compare(mission, part_way(mission, seed), tiny=seed % 2 == 0)


@pytest.mark.parametrize("seed", [351, 352])
def test_nodes_at_which_nobody_may_hand_over(seed: int) -> None:
    compare(tiny_mission(seed, candidates=3), closed=["v0", "d0"])
