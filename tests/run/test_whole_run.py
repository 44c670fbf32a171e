"""The whole chain: simulated rovers, agents, coordinator and recorder, with a replan on the way."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

from malipp_field.control import Outcome
from malipp_field.mission import Mission, parse_mission
from malipp_field.plan import Plan
from malipp_field.planner import check, solve
from malipp_field.record import Run, read_run
from malipp_field.run import fly, mission_planner
from malipp_field.vehicle.steps import Action

ROOT = Path(__file__).parents[2]
SPEED = 60.0
WALL_LIMIT_S = 150.0

# Deep sand right behind the hub, on the scout's only way to the right region and back.
SAND = """
simulation:
  seed: 3
  terrain:
    - {x_m: 110.0, y_m: 10.0, radius_m: 12.0, speed_factor: 0.25, energy_factor: 1.3}
    - {x_m: 110.0, y_m: -10.0, radius_m: 12.0, speed_factor: 0.25, energy_factor: 1.3}
replanning: {slip_s: 20.0, energy_overdraw: 0.04, time_limit_s: 3.0}
"""


def sandy_corridor() -> tuple[Mission, str]:
    text = (ROOT / "missions" / "corridor.yaml").read_text() + SAND
    return parse_mission(text), text


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> tuple[Mission, Plan, Outcome, Run]:
    mission, text = sandy_corridor()
    plan = solve(mission, threads=1)
    assert plan.handoffs > 0, "the mission is about dead drops"
    recording = tmp_path_factory.mktemp("flight") / "run.mcap"
    outcome = asyncio.run(
        asyncio.wait_for(
            fly(mission, text, plan, recording, speed=SPEED, planner=mission_planner(threads=1)), WALL_LIMIT_S
        )
    )
    return mission, plan, outcome, read_run(recording)


def test_the_team_replans_and_every_sample_taken_comes_home(
    flight: tuple[Mission, Plan, Outcome, Run],
) -> None:
    _, _, outcome, run = flight
    assert outcome.complete, outcome.reason
    assert outcome.versions >= 2
    final = run.ledgers[-1].samples
    taken = [record for record in final if record.history]
    assert taken
    assert {record.state for record in taken} == {"delivered"}
    assert {record.state for record in final} <= {"delivered", "withdrawn"}


def test_every_plan_in_force_is_in_the_recording_and_names_its_reason(
    flight: tuple[Mission, Plan, Outcome, Run],
) -> None:
    mission, plan, outcome, run = flight
    versions = [adopted.plan.version for adopted in run.plans]
    assert versions == sorted(set(versions)), "a version that was dropped is not given again"
    assert (versions[0], versions[-1]) == (1, outcome.versions)
    assert run.plans[0].plan == plan
    check(mission, run.plans[0].plan)
    assert "late" in run.plans[1].reason or "budget" in run.plans[1].reason
    assert run.complete


def test_no_container_is_fetched_before_it_was_left(flight: tuple[Mission, Plan, Outcome, Run]) -> None:
    _, _, _, run = flight
    handovers = 0
    for record in run.ledgers[-1].samples:
        for before, after in zip(record.history, record.history[1:], strict=False):
            assert before.time_s <= after.time_s
            if after.action is Action.PICK:
                assert (before.action, before.node) == (Action.DROP, after.node)
                assert before.robot != after.robot
                handovers += 1
    assert handovers > 0


def test_no_vehicle_overdraws_its_battery_or_its_hold(flight: tuple[Mission, Plan, Outcome, Run]) -> None:
    mission, _, _, run = flight
    for robot in mission.team.robots:
        reports = run.telemetry[robot.id]
        assert reports[-1].finished
        assert reports[-1].energy_used_j <= robot.energy_budget_j
        on_board = 0
        for confirmation in run.confirmations:
            if confirmation.robot == robot.id:
                assert confirmation.ok
                on_board += {Action.COLLECT: 1, Action.PICK: 1}.get(confirmation.action, -1)
                assert 0 <= on_board <= robot.payload_capacity
        assert on_board == 0


def test_vehicles_carry_out_only_missions_that_were_put_in_force(
    flight: tuple[Mission, Plan, Outcome, Run],
) -> None:
    _, _, _, run = flight
    known = {m.robot: set[str]() for m in run.plans[0].missions}
    for adopted in run.plans:
        for vehicle_mission in adopted.missions:
            known[vehicle_mission.robot] |= {step.uid for step in vehicle_mission.steps}
    for robot, reports in run.telemetry.items():
        steps = {report.step_uid for report in reports if report.step_uid is not None}
        assert steps <= known[robot]
