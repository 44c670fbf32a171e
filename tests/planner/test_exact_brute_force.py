"""The exact planner against exhaustive search, on tiny missions of every kind."""

from __future__ import annotations

import pytest
from brute_force import optimum
from random_missions import part_way, tiny_mission

from malipp_field.mission import Mission, TeamState
from malipp_field.planner import solve, verify


def compare(mission: Mission, state: TeamState | None, *, handoffs: bool) -> None:
    truth = optimum(mission, state, handoffs=handoffs)
    plan = solve(mission, state=state, method="exact", handoffs=handoffs, mip_gap=1e-7, time_limit_s=60.0)
    if truth is None:
        assert plan.status == "infeasible"
        assert plan.reason
        return
    assert plan.status == "optimal"
    assert plan.objective is not None
    assert plan.objective.information == pytest.approx(truth[0], rel=1e-6)
    assert plan.objective.energy_j == pytest.approx(truth[1], rel=1e-6, abs=1e-6)
    assert not verify(mission, plan, state)


@pytest.mark.parametrize("seed", [*range(9), *range(10, 17)])  # seed 9 takes the brute force 20 s
def test_two_robots_with_handoffs(seed: int) -> None:
    compare(tiny_mission(seed, candidates=2 + seed % 2), None, handoffs=True)


@pytest.mark.parametrize("seed", range(20, 28))
def test_two_robots_without_handoffs(seed: int) -> None:
    compare(tiny_mission(seed, candidates=3), None, handoffs=False)


@pytest.mark.parametrize("seed", range(40, 48))
def test_one_robot(seed: int) -> None:
    compare(tiny_mission(seed, robots=1, candidates=4), None, handoffs=True)


@pytest.mark.parametrize("seed", range(60, 76))
def test_part_way_through_a_mission(seed: int) -> None:
    mission = tiny_mission(seed, candidates=2)
    compare(mission, part_way(mission, seed), handoffs=seed % 4 != 0)
