"""What is said of missions whose obstacle shows only in the team: each sample could come home, not all."""

from __future__ import annotations

import re
from typing import Any

import pytest
from random_missions import part_way, tiny_mission

from malipp_field.mission import Cache, Mission, RobotState, TeamState
from malipp_field.plan import Plan
from malipp_field.planner import solve

FIGURE = re.compile(r"(r\d) needs ([\d.]+) J more")


def line(*, budget_j: float = 21.0, capacity: int = 2, robots: int = 1, sample_kg: float = 0.0) -> Mission:
    """Return robots at a depot in the middle of a road of 10 m each way, 1 J a metre when empty."""
    nodes: list[dict[str, Any]] = [
        {"id": "west", "x_m": -10.0, "y_m": 0.0},
        {"id": "base", "x_m": 0.0, "y_m": 0.0, "role": "depot"},
        {"id": "east", "x_m": 10.0, "y_m": 0.0},
    ]
    robot = {
        "start": "base",
        "depots": ["base"],
        "empty_mass_kg": 1.0,
        "energy_budget_j": budget_j,
        "payload_capacity": capacity,
        "samples_per_node": 1,
        "noise_variance": 0.1,
        "energy_per_kg_m": 1.0,
        "speed_m_s": 1.0,
    }
    return Mission.model_validate(
        {
            "format": "malipp-mission/1",
            "name": "line",
            "site": {
                "nodes": nodes,
                "edges": [{"from": "west", "to": "base"}, {"from": "base", "to": "east"}],
            },
            "field": {
                "kernel": {"family": "rbf", "length_scale_m": 5.0},
                "test_points": [{"x_m": 5.0, "y_m": 0.0}],
            },
            "team": {
                "sample_mass_kg": sample_kg,
                "robots": [robot | {"id": f"r{r}"} for r in range(robots)],
            },
        }
    )


def both_ends(mission: Mission, each: int = 1, on_board: int = 0) -> TeamState:
    return TeamState(
        robots=tuple(
            RobotState(id=r.id, node="base", energy_left_j=r.energy_budget_j, on_board=on_board)
            for r in mission.team.robots
        ),
        caches=tuple(Cache(node=node, sender="r0", count=each) for node in ("west", "east")),
    )


def reason(plan: Plan) -> str:
    assert (plan.status, plan.robots) == ("infeasible", ())
    assert plan.reason is not None
    assert "\n" not in plan.reason
    return plan.reason


def test_a_robot_that_can_fetch_either_but_not_both_lacks_the_second_trip() -> None:
    mission = line()
    said = reason(solve(mission, state=both_ends(mission)))
    assert "the least that would do: r0 needs 19.0 J more (its budget is 21.0 J)" in said
    assert "the 1 sample of r0 lying at west" in said
    assert "the 1 sample of r0 lying at east" in said


def test_what_the_load_weighs_is_in_the_figure() -> None:
    mission = line(sample_kg=0.5, budget_j=26.0)
    # 10 m empty, 20 m with the first (it passes its depot in transit), 10 m with both
    assert "r0 needs 34.0 J more (its budget is 26.0 J)" in reason(solve(mission, state=both_ends(mission)))


def test_two_robots_can_share_the_ends_and_nothing_is_missing() -> None:
    mission = line(robots=2)
    assert solve(mission, state=both_ends(mission)).status == "optimal"


def test_a_lack_of_room_is_counted_in_samples() -> None:
    mission = line(robots=2, capacity=1)
    said = reason(solve(mission, state=both_ends(mission, each=2)))
    assert "room for 1 sample more (it can carry 1)" in said


def test_energy_that_is_kept_in_reserve_does_not_count() -> None:
    mission = line(budget_j=50.0)
    options = mission.planner.model_copy(update={"energy_reserve": 0.5})
    careful = mission.model_copy(update={"planner": options})
    said = reason(solve(careful, state=both_ends(careful)))
    assert "r0 needs 15.0 J more (its budget is 25.0 J)" in said


def with_energy(state: TeamState, more_j: dict[str, float]) -> TeamState:
    return state.model_copy(
        update={
            "robots": tuple(
                r.model_copy(update={"energy_left_j": r.energy_left_j + more_j.get(r.id, 0.0)})
                for r in state.robots
            )
        }
    )


@pytest.mark.parametrize("seed", [203, 214, 222, 246, 249, 253])
def test_what_is_said_to_be_missing_makes_a_plan_possible_and_nothing_less(seed: int) -> None:
    mission = tiny_mission(seed, candidates=3, energy_budget_j=9.0, payload_capacity=2)
    state = part_way(mission, seed)
    said = reason(solve(mission, state=state, method="arcs"))
    assert "the least that would do" in said
    missing = {robot: float(figure) for robot, figure in FIGURE.findall(said)}
    assert solve(mission, state=with_energy(state, missing), method="arcs").status == "optimal"
    less = {robot: figure - 0.2 for robot, figure in missing.items()}
    assert solve(mission, state=with_energy(state, less), method="arcs").status == "infeasible"


def test_one_robot_alone_is_told_how_much_it_is_short_of() -> None:
    mission = line(budget_j=15.0)
    state = TeamState(robots=(RobotState(id="r0", node="west", energy_left_j=4.0),))
    assert reason(solve(mission, state=state)) == (
        "r0: the cheapest way from west to a depot (base) needs 10.0 J, 6.0 J more than there is: "
        "its budget is 4.0 J"
    )
    one_end = both_ends(mission).model_copy(update={"caches": (Cache(node="east", sender="r0", count=1),)})
    assert "r0 needs 20.0 J to fetch one, 5.0 J more than there is" in reason(solve(mission, state=one_end))
