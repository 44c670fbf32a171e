"""The rover as a ground station meets it: identity, arming, modes, commands, parameters."""

from __future__ import annotations

import math
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from sim_cases import Ground, action, from_ground, ground_for, item_int, numbered, of, site, waypoint

from malipp_field.sim import RoverConfig
from malipp_field.vehicle.items import MissionItem
from malipp_field.vehicle.steps import Action

ACCEPTED, FAILED = mavlink.MAV_RESULT_ACCEPTED, mavlink.MAV_RESULT_FAILED
ARM = mavlink.MAV_CMD_COMPONENT_ARM_DISARM
SET_CURRENT = mavlink.MAV_CMD_DO_SET_MISSION_CURRENT


@pytest.fixture
def ground() -> Ground:
    return ground_for(site())


def some_items(ground: Ground) -> list[MissionItem]:
    world = ground.rover.world
    return numbered(world, [waypoint(world, "a"), action(Action.COLLECT, 1, 7), waypoint(world, "b")])


def test_it_presents_itself_as_an_ardupilot_rover(ground: Ground) -> None:
    said = ground.wait(1.0)
    heartbeat = of(said, "HEARTBEAT")[0]
    assert heartbeat.type == mavlink.MAV_TYPE_GROUND_ROVER
    assert heartbeat.autopilot == mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA
    assert heartbeat.custom_mode == mavlink.ROVER_MODE_MANUAL
    assert not heartbeat.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED
    position = of(said, "GLOBAL_POSITION_INT")[0]
    assert (position.lat, position.lon, position.alt) == (340219000, -1182870000, 60000)


@pytest.mark.parametrize("step_s", [0.05, 0.15])
def test_telemetry_keeps_its_rates_whatever_the_step(ground: Ground, step_s: float) -> None:
    ground.wait(1.0, step_s)
    said = ground.wait(30.0, step_s)
    rates = {m: len(of(said, m)) / 30.0 for m in ("HEARTBEAT", "GLOBAL_POSITION_INT", "BATTERY_STATUS")}
    expected = {"HEARTBEAT": 1.0, "GLOBAL_POSITION_INT": 4.0, "BATTERY_STATUS": 1.0}
    assert rates == pytest.approx(expected, rel=0.05)
    assert len(of(said, "NAMED_VALUE_FLOAT")) == pytest.approx(60, abs=2)


def test_it_arms_only_once_the_position_estimate_is_good(ground: Ground) -> None:
    horizontal = mavlink.EKF_POS_HORIZ_REL | mavlink.EKF_POS_HORIZ_ABS
    early = ground.wait(2.0)
    assert not of(early, "EKF_STATUS_REPORT")[-1].flags & horizontal
    assert of(early, "SYS_STATUS")[-1].onboard_control_sensors_health & mavlink.MAV_SYS_STATUS_PREARM_CHECK
    assert ground.command(ARM, 1.0) == FAILED
    assert "Arm: AHRS: waiting for position estimate" in ground.texts()
    late = ground.wait(4.0)
    assert of(late, "EKF_STATUS_REPORT")[-1].flags & horizontal == horizontal
    assert ground.command(ARM, 1.0) == ACCEPTED
    assert of(ground.wait(1.1), "HEARTBEAT")[-1].base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED
    assert ground.command(ARM, 0.0) == ACCEPTED
    assert not ground.rover.autopilot.armed


def test_arming_may_be_forced_and_the_delay_configured() -> None:
    slow = ground_for(site(), config=RoverConfig(ready_after_s=40.0))
    slow.wait(30.0)
    assert slow.command(ARM, 1.0) == FAILED
    assert slow.command(ARM, 1.0, 21196.0) == FAILED  # forces disarming only
    assert slow.command(ARM, 1.0, 2989.0) == ACCEPTED


def test_home_is_told_to_whoever_asks_and_no_fence_is_breached(ground: Ground) -> None:
    answers = ground.send(
        mavlink.MAVLink_command_long_message(1, 0, mavlink.MAV_CMD_GET_HOME_POSITION, 0, *[0.0] * 7)
    )
    assert of(answers, "COMMAND_ACK")[0].result == ACCEPTED
    assert of(answers, "HOME_POSITION")[0].latitude == of(answers, "GPS_GLOBAL_ORIGIN")[0].latitude
    status = of(ground.wait(1.1), "SYS_STATUS")[0]
    assert status.onboard_control_sensors_health & mavlink.MAV_SYS_STATUS_GEOFENCE


def test_auto_needs_a_mission(ground: Ground) -> None:
    assert ground.mode(mavlink.ROVER_MODE_AUTO) == FAILED
    assert "No Mission. Can't set AUTO." in ground.texts()
    assert ground.command(mavlink.MAV_CMD_MISSION_START) == FAILED
    ground.upload(some_items(ground))
    assert ground.command(mavlink.MAV_CMD_MISSION_START) == ACCEPTED
    assert ground.rover.autopilot.mode == mavlink.ROVER_MODE_AUTO


def test_modes_change_by_command_and_by_message(ground: Ground) -> None:
    assert ground.mode(mavlink.ROVER_MODE_HOLD) == ACCEPTED
    assert ground.mode(99) == FAILED
    ground.send(mavlink.MAVLink_set_mode_message(1, 1, mavlink.ROVER_MODE_GUIDED))
    assert ground.rover.autopilot.mode == mavlink.ROVER_MODE_GUIDED
    ground.send(mavlink.MAVLink_set_mode_message(1, 0, mavlink.ROVER_MODE_HOLD))
    assert ground.rover.autopilot.mode == mavlink.ROVER_MODE_GUIDED


def test_a_disarmed_rover_does_not_drive(ground: Ground) -> None:
    ground.upload(some_items(ground))
    ground.mode(mavlink.ROVER_MODE_AUTO)
    ground.wait(60.0)
    assert ground.rover.autopilot.position == (0.0, 0.0)


def test_unknown_commands_are_unsupported(ground: Ground) -> None:
    assert ground.command(mavlink.MAV_CMD_NAV_TAKEOFF) == mavlink.MAV_RESULT_UNSUPPORTED
    assert ground.command(mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 3.0) == mavlink.MAV_RESULT_UNSUPPORTED


def test_params_that_are_no_numbers_do_no_harm(ground: Ground) -> None:
    for command in (ARM, SET_CURRENT, mavlink.MAV_CMD_DO_SET_MODE, mavlink.MAV_CMD_SET_MESSAGE_INTERVAL):
        ground.command(command, math.nan, math.inf)
    assert not ground.rover.autopilot.armed


def test_command_int_is_answered_like_command_long(ground: Ground) -> None:
    hold = mavlink.MAVLink_command_int_message(
        1, 1, 0, mavlink.MAV_CMD_DO_SET_MODE, 0, 0, 1.0, 4.0, 0.0, 0.0, 0, 0, 0.0
    )
    (ack,) = of(ground.send(hold), "COMMAND_ACK")
    assert (ack.command, ack.result) == (mavlink.MAV_CMD_DO_SET_MODE, ACCEPTED)
    assert (ack.target_system, ack.target_component) == (255, 190)
    assert ground.rover.autopilot.mode == mavlink.ROVER_MODE_HOLD


def test_messages_come_on_request_and_at_requested_rates(ground: Ground) -> None:
    ground.wait(1.0)
    assert ground.command(mavlink.MAV_CMD_REQUEST_MESSAGE, 148.0) == ACCEPTED
    (version,) = of(ground.heard, "AUTOPILOT_VERSION")
    for wanted in ("MISSION_INT", "MAVLINK2", "COMMAND_INT", "PARAM_FLOAT"):
        assert version.capabilities & getattr(mavlink, f"MAV_PROTOCOL_CAPABILITY_{wanted}")
    assert ground.command(mavlink.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES, 1.0) == ACCEPTED
    assert len(of(ground.heard, "AUTOPILOT_VERSION")) == 2
    for wanted_id in (242.0, 49.0):
        assert ground.command(mavlink.MAV_CMD_REQUEST_MESSAGE, wanted_id) == ACCEPTED
    assert of(ground.heard, "HOME_POSITION")[0].latitude == 340219000
    assert ground.command(mavlink.MAV_CMD_REQUEST_MESSAGE, 410.0) == FAILED
    interval = mavlink.MAV_CMD_SET_MESSAGE_INTERVAL
    assert ground.command(interval, 33.0, -1.0) == ACCEPTED
    assert of(ground.wait(3.0), "GLOBAL_POSITION_INT") == []
    assert ground.command(interval, 33.0, 2e6) == ACCEPTED
    assert len(of(ground.wait(10.0), "GLOBAL_POSITION_INT")) == pytest.approx(5, abs=1)
    assert ground.command(interval, 33.0, 0.0) == ACCEPTED
    assert len(of(ground.wait(10.0), "GLOBAL_POSITION_INT")) == pytest.approx(40, abs=1)
    assert ground.command(interval, 410.0, 1e6) == FAILED


def test_what_is_for_another_system_is_ignored(ground: Ground) -> None:
    ground.rover.receive(from_ground(mavlink.MAVLink_mission_count_message(2, 1, 3)), "ground", ground.now_s)
    assert not ground.rover.autopilot.store.receiving
    ground.send(mavlink.MAVLink_mission_count_message(0, 0, 3))
    assert ground.rover.autopilot.store.receiving


def test_answers_go_to_the_sender_and_telemetry_to_all(ground: Ground) -> None:
    begin = mavlink.MAVLink_mission_count_message(1, 1, 3)
    ground.rover.receive(from_ground(begin), "here", ground.now_s)
    said = ground.rover.outbox
    assert [peer for peer, m in said if m.get_type() == "MISSION_REQUEST"] == ["here"]
    assert {peer for peer, m in said if m.get_type() == "HEARTBEAT"} == {None}
    ground.rover.outbox = []
    ground.rover.receive(from_ground(begin, (254, 1)), "there", ground.now_s)
    assert [peer for peer, m in ground.rover.outbox if m.get_type() == "MISSION_ACK"] == ["there"]
    ground.rover.outbox = []
    ground.rover.step(ground.now_s + 1.5)
    assert [peer for peer, m in ground.rover.outbox if m.get_type() == "MISSION_REQUEST"] == ["here"]


def test_mission_current_speaks_up_at_once_and_counts_without_home(ground: Ground) -> None:
    empty = of(ground.wait(1.05), "MISSION_CURRENT")[-1]
    assert (empty.total, empty.mission_state) == (0, mavlink.MISSION_STATE_NO_MISSION)
    ground.upload(some_items(ground))
    latest = of(ground.heard, "MISSION_CURRENT")[-1]
    assert (latest.total, latest.mission_state) == (3, mavlink.MISSION_STATE_NOT_STARTED)
    assert (
        of(ground_for(site()).wait(1.0), "MISSION_CURRENT")[-1].mission_state
        == mavlink.MISSION_STATE_NO_MISSION
    )


def test_set_current_wants_an_item_that_is_there(ground: Ground) -> None:
    assert ground.command(SET_CURRENT, 1.0) == FAILED
    ground.upload(some_items(ground))
    assert ground.command(SET_CURRENT, 4.0) == FAILED
    assert ground.command(SET_CURRENT, -1.0) == FAILED
    assert ground.command(SET_CURRENT, 3.0) == ACCEPTED
    assert of(ground.heard, "MISSION_CURRENT")[-1].seq == 3
    ground.send(mavlink.MAVLink_mission_set_current_message(1, 1, 1))
    assert of(ground.heard, "MISSION_CURRENT")[-1].seq == 1


def test_the_downloaded_mission_marks_the_current_item(ground: Ground) -> None:
    ground.upload(some_items(ground))
    ground.command(SET_CURRENT, 2.0)
    assert [m.current for m in ground.download()] == [0, 0, 1, 0]


def test_the_old_way_to_make_an_item_current_is_answered_with_its_number(ground: Ground) -> None:
    ground.upload(some_items(ground))
    home_first = mavlink.MAVLink_mission_set_current_message(1, 1, 0)
    assert [m.seq for m in of(ground.send(home_first), "MISSION_CURRENT")] == [0, 1]
    assert of(ground.send(mavlink.MAVLink_mission_set_current_message(1, 1, 9)), "MISSION_CURRENT") == []


def test_reset_before_auto_was_ever_entered_blocks_arming(ground: Ground) -> None:
    ground.upload(some_items(ground))
    ground.wait(6.0)
    ground.command(SET_CURRENT, 1.0, 1.0)
    assert ground.command(ARM, 1.0) == FAILED
    ground.rover.reboot(ground.now_s)
    ground.wait(6.0)
    assert ground.command(ARM, 1.0) == ACCEPTED


def test_a_mission_and_parameters_survive_a_restart(ground: Ground) -> None:
    ground.upload(some_items(ground))
    before = [m.to_dict() for m in ground.download()]
    ground.send(mavlink.MAVLink_param_set_message(1, 1, b"WP_SPEED", 1.25, 9))
    ground.send(mavlink.MAVLink_mission_count_message(1, 1, 5))  # an upload cut off by the restart
    assert ground.command(mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 1.0) == ACCEPTED
    assert [m.to_dict() for m in ground.download()] == before
    assert ground.rover.parameters["WP_SPEED"] == 1.25
    assert of(ground.wait(2.1), "SYSTEM_TIME")[-1].time_boot_ms <= 2101


def test_an_armed_rover_refuses_to_restart_by_command(ground: Ground) -> None:
    ground.start([waypoint(ground.rover.world, "a")])
    assert ground.command(mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 1.0) == FAILED
    assert ground.rover.autopilot.armed


def test_energy_counts_from_the_last_start_but_the_battery_does_not_fill(ground: Ground) -> None:
    ground.start([waypoint(ground.rover.world, "a")])
    ground.wait(60.0)
    used_j = ground.rover.autopilot.energy_used_j
    assert used_j == pytest.approx(4500.0)
    ground.rover.reboot(ground.now_s)
    assert of(ground.wait(1.0), "NAMED_VALUE_FLOAT")[-1].value == 0.0
    assert ground.rover.autopilot.energy_used_j == used_j
    assert of(ground.wait(1.1), "BATTERY_STATUS")[-1].battery_remaining == round(100 * (1 - 4500 / 60000))


def test_fence_and_rally_are_stores_of_their_own(ground: Ground) -> None:
    ground.upload(some_items(ground))
    for kind in (mavlink.MAV_MISSION_TYPE_FENCE, mavlink.MAV_MISSION_TYPE_RALLY):
        listing = mavlink.MAVLink_mission_request_list_message(1, 1, kind)
        (count,) = of(ground.send(listing), "MISSION_COUNT")
        assert (count.count, count.mission_type) == (0, kind)
    rally = MissionItem(0, 3, 5100, 0, 1, 0.0, 0.0, 0.0, 0.0, 340219000, -1182870000, 0.0)
    assert ground.upload([rally], mavlink.MAV_MISSION_TYPE_RALLY) == mavlink.MAV_MISSION_ACCEPTED
    assert ground.upload([rally], mavlink.MAV_MISSION_TYPE_FENCE) == mavlink.MAV_MISSION_UNSUPPORTED
    request = mavlink.MAVLink_mission_request_int_message(1, 1, 0, mavlink.MAV_MISSION_TYPE_RALLY)
    (back,) = of(ground.send(request), "MISSION_ITEM_INT")
    assert (back.command, back.x, back.mission_type) == (5100, 340219000, 2)
    assert len(ground.rover.autopilot.store.items) == 4
    clear = mavlink.MAVLink_mission_clear_all_message(1, 1, mavlink.MAV_MISSION_TYPE_ALL)
    assert [m.type for m in of(ground.send(clear), "MISSION_ACK")] == [mavlink.MAV_MISSION_ACCEPTED]
    assert ground.download() == []


def param(said: list[Any], name: str) -> Any:
    return next(m for m in of(said, "PARAM_VALUE") if m.param_id == name)


def test_parameters_are_listed_read_and_set(ground: Ground) -> None:
    listed = of(ground.send(mavlink.MAVLink_param_request_list_message(1, 1)), "PARAM_VALUE")
    assert [m.param_index for m in listed] == list(range(listed[0].param_count))
    assert param(listed, "MAV_SYSID").param_value == 1.0
    assert {m.param_type for m in listed} == {2, 4, 6, 9}
    by_name = ground.send(mavlink.MAVLink_param_request_read_message(1, 1, b"FS_ACTION", -1))
    assert (param(by_name, "FS_ACTION").param_value, param(by_name, "FS_ACTION").param_type) == (2.0, 2)
    index = param(listed, "WP_SPEED").param_index
    by_index = ground.send(mavlink.MAVLink_param_request_read_message(1, 1, b"", index))
    assert param(by_index, "WP_SPEED").param_index == index
    said = ground.send(mavlink.MAVLink_param_set_message(1, 1, b"FS_ACTION", 300.0, 2))
    assert param(said, "FS_ACTION").param_value == 127.0
    said = ground.send(mavlink.MAVLink_param_set_message(1, 1, b"WP_SPEED", math.nan, 9))
    assert param(said, "WP_SPEED").param_value == 2.0
    assert not of(
        ground.send(mavlink.MAVLink_param_request_read_message(1, 1, b"NO_SUCH", -1)), "PARAM_VALUE"
    )
    assert not of(ground.send(mavlink.MAVLink_param_set_message(1, 1, b"NO_SUCH", 1.0, 9)), "PARAM_VALUE")


def test_mis_restart_begins_the_mission_anew_on_entering_auto(ground: Ground) -> None:
    ground.start([waypoint(ground.rover.world, "a"), waypoint(ground.rover.world, "b")])
    ground.wait(55.0)
    for restart, seq in ((0.0, 2), (1.0, 1)):
        ground.send(mavlink.MAVLink_param_set_message(1, 1, b"MIS_RESTART", restart, 2))
        ground.mode(mavlink.ROVER_MODE_HOLD)
        ground.mode(mavlink.ROVER_MODE_AUTO)
        assert of(ground.heard, "MISSION_CURRENT")[-1].seq == seq


def test_clocks_are_compared_on_request(ground: Ground) -> None:
    (answer,) = of(ground.send(mavlink.MAVLink_timesync_message(0, 1234)), "TIMESYNC")
    assert (answer.tc1, answer.ts1) == (int(ground.now_s * 1e9), 1234)
    assert not of(ground.send(mavlink.MAVLink_timesync_message(1, 1234)), "TIMESYNC")


def test_an_item_out_of_the_blue_is_an_error(ground: Ground) -> None:
    (ack,) = of(ground.send(item_int(some_items(ground)[1])), "MISSION_ACK")
    assert ack.type == mavlink.MAV_MISSION_ERROR
