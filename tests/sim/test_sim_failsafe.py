"""The ground station failsafe of the simulated rover, as ArduPilot Rover has it."""

from __future__ import annotations

from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from sim_cases import Ground, ground_for, site, waypoint

GCS = mavlink.MAVLink_heartbeat_message(mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, 4, 3)


def driving(**parameters: float) -> Ground:
    """A rover in AUTO on a long leg, with those parameters set."""
    ground = ground_for(site(speed_m_s="0.5"))
    for name, value in parameters.items():
        ground.send(
            mavlink.MAVLink_param_set_message(1, 1, name.encode(), value, mavlink.MAV_PARAM_TYPE_REAL32)
        )
    ground.start([waypoint(ground.rover.world, "a")])
    return ground


def mode_after(ground: Ground, duration_s: float) -> int:
    ground.wait(duration_s)
    return ground.rover.autopilot.mode


def test_it_is_off_by_default() -> None:
    ground = driving()
    ground.send(GCS)
    assert mode_after(ground, 60.0) == mavlink.ROVER_MODE_AUTO


@pytest.mark.parametrize("step_s", [0.1, 30.0])
def test_it_holds_when_heartbeats_stay_away_exactly_as_long_as_the_parameters_say(step_s: float) -> None:
    ground = driving(FS_GCS_ENABLE=1)
    x_m = ground.rover.autopilot.position[0]
    ground.send(GCS)
    ground.wait(30.0, step_s)
    assert ground.rover.autopilot.mode == mavlink.ROVER_MODE_HOLD
    assert ground.rover.autopilot.position[0] - x_m == pytest.approx(0.5 * 6.5)
    assert "GCS Failsafe" in ground.texts()


def test_heartbeats_keep_it_going_and_end_it_but_do_not_resume_the_mission() -> None:
    ground = driving(FS_GCS_ENABLE=1)
    for _ in range(20):
        ground.send(GCS)
        assert mode_after(ground, 4.0) == mavlink.ROVER_MODE_AUTO
    assert mode_after(ground, 3.0) == mavlink.ROVER_MODE_HOLD
    ground.send(GCS)
    assert mode_after(ground, 1.0) == mavlink.ROVER_MODE_HOLD
    assert "GCS Failsafe Cleared" in ground.texts()


def test_it_counts_one_system_id_only_and_only_once_seen() -> None:
    ground = driving(FS_GCS_ENABLE=1)
    for _ in range(20):
        ground.send(GCS, ground=(245, 190))
        assert mode_after(ground, 1.0) == mavlink.ROVER_MODE_AUTO  # never seen, never missed
    ground.send(GCS)
    for _ in range(10):
        ground.send(GCS, ground=(245, 190))
        ground.wait(1.0)
    assert ground.rover.autopilot.mode == mavlink.ROVER_MODE_HOLD


@pytest.mark.parametrize("parameters", [{"FS_GCS_ENABLE": 2}, {"FS_GCS_ENABLE": 1, "FS_ACTION": 0}])
def test_it_may_be_told_to_go_on(parameters: dict[str, float]) -> None:
    ground = driving(**parameters)
    ground.send(GCS)
    assert mode_after(ground, 30.0) == mavlink.ROVER_MODE_AUTO


def test_a_restart_forgets_what_it_has_heard() -> None:
    ground = driving(FS_GCS_ENABLE=1)
    ground.send(GCS)
    ground.rover.reboot(ground.now_s)
    assert mode_after(ground, 30.0) == mavlink.ROVER_MODE_MANUAL
    assert "GCS Failsafe" not in ground.texts()


def test_in_hold_it_waits_until_that_mode_is_left() -> None:
    ground = driving(FS_GCS_ENABLE=1)
    ground.send(GCS)
    ground.mode(mavlink.ROVER_MODE_HOLD)
    ground.wait(30.0)
    assert "GCS Failsafe" not in ground.texts()
    ground.mode(mavlink.ROVER_MODE_AUTO)
    assert mode_after(ground, 0.2) == mavlink.ROVER_MODE_HOLD


def test_the_parameters_say_how_fast_it_drives() -> None:
    ground = ground_for(site(speed_m_s="0.5"))
    read = mavlink.MAVLink_param_request_read_message(1, 1, b"WP_SPEED", -1)
    answers: list[Any] = [m for m in ground.send(read) if m.get_type() == "PARAM_VALUE"]
    assert [m.param_value for m in answers] == [0.5]
