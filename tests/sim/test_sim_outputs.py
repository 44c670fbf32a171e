"""Servos, relays and grippers: when they move, what ArduPilot says of it, and what becomes of containers."""

from __future__ import annotations

from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from sim_cases import START_S, Ground, action, ground_for, of, site, waypoint

from malipp_field.sim import World
from malipp_field.sim.world import Outcome
from malipp_field.vehicle.items import MissionItem, item_without_place
from malipp_field.vehicle.layout import gate_code
from malipp_field.vehicle.steps import Action

SERVO, RELAY, GRIPPER = mavlink.MAV_CMD_DO_SET_SERVO, mavlink.MAV_CMD_DO_SET_RELAY, mavlink.MAV_CMD_DO_GRIPPER
PROFILE = """
vehicles:
  carrier:
    payload:
      collect: {by: servo, channel: 9, pwm_us: 1900, rest_us: 1100, duration_s: 5.0}
      drop: {by: gripper, move: release, duration_s: 3.0}
      pick: {by: relay, relay: 2, duration_s: 4.0}
      unload: {by: gripper, move: release, duration_s: 3.0}
  scout: {payload: script}
"""
MIDNIGHT_S = START_S - START_S % 86400.0
BASE, A, B = (0.0, 0.0), (100.0, 0.0), (100.0, 60.0)


def do(command: int, *params: float) -> MissionItem:
    return item_without_place(0, command, *params)


def delay(*params: float) -> MissionItem:
    return do(mavlink.MAV_CMD_NAV_DELAY, *params)


def carrier() -> Ground:
    return ground_for(site(PROFILE), "carrier")


def reached(said: list[Any]) -> list[int]:
    return [message.seq for message in of(said, "MISSION_ITEM_REACHED")]


def current(ground: Ground) -> int:
    return int(of(ground.wait(1.5), "MISSION_CURRENT")[-1].seq)


def test_do_commands_move_outputs_after_the_waypoint_and_are_never_the_current_item() -> None:
    ground = carrier()
    world = ground.rover.world
    ground.start([waypoint(world, "a"), do(SERVO, 9, 1900), delay(5, -1, -1, -1), do(SERVO, 9, 1100),
                  do(RELAY, 3, 1), delay(5, -1, -1, -1)])  # fmt: skip
    outputs = ground.rover.autopilot.outputs
    ground.wait(90.0)
    assert outputs.servos_us == {}, "still on the way"
    said = ground.wait(13.0)
    assert outputs.servos_us == {9: 1900}
    assert current(ground) == 3
    said += ground.wait(3.0)
    assert (outputs.servos_us, outputs.relays) == ({9: 1100}, {3: True})
    assert current(ground) == 6
    said += ground.wait(10.0)
    assert reached(said) == [3, 6], "the servo behind it took the waypoint's; DO commands send none"
    assert "Reached waypoint #1" in [text for text in ground.texts() if text.startswith("Reached")]


def test_of_the_commands_at_the_end_only_the_first_is_done() -> None:
    ground = carrier()
    ground.start([delay(1, -1, -1, -1), do(RELAY, 1, 0), do(RELAY, 5, 1)])
    ground.wait(3.0)
    assert ground.rover.autopilot.outputs.relays == {1: False}
    assert "Mission Complete" in ground.texts()


def test_made_current_in_hold_a_command_is_done_when_auto_is_entered() -> None:
    ground = carrier()
    ground.start([delay(50, -1, -1, -1), do(SERVO, 9, 1900), delay(50, -1, -1, -1)])
    outputs = ground.rover.autopilot.outputs
    ground.mode(mavlink.ROVER_MODE_HOLD)
    assert ground.command(mavlink.MAV_CMD_DO_SET_MISSION_CURRENT, 2.0) == mavlink.MAV_RESULT_ACCEPTED
    assert (current(ground), outputs.servos_us) == (3, {})
    ground.mode(mavlink.ROVER_MODE_AUTO)
    assert outputs.servos_us == {9: 1900}
    outputs.servos_us.clear()
    ground.mode(mavlink.ROVER_MODE_HOLD)
    ground.mode(mavlink.ROVER_MODE_AUTO)
    assert (current(ground), outputs.servos_us) == (3, {}), "only the delay begins anew"


def test_what_is_wrong_with_a_command_is_not_refused_on_upload() -> None:
    ground = carrier()
    ground.start([delay(1, -1, -1, -1), do(SERVO, 9, 99999), do(SERVO, 1, 1500), do(GRIPPER, 1, 1),
                  do(mavlink.MAV_CMD_DO_WINCH, 1, 0), delay(9, -1, -1, -1)])  # fmt: skip
    ground.wait(1.5)
    assert ground.rover.autopilot.outputs.servos_us == {9: 34463}
    texts = ground.texts()
    assert "ServoRelayEvent: Channel 1 is already in use" in texts
    assert "Gripper Grabbed" in texts
    assert any("Skipping invalid cmd" in text for text in texts)
    assert reached(ground.heard) == [1, 5]


def test_an_output_that_is_not_set_up_does_nothing_whatever_the_rover_says() -> None:
    parameters = "simulation: {parameters: {SERVO9_FUNCTION: 70, RELAY3_FUNCTION: 0, GRIP_ENABLE: 0}}"
    ground = ground_for(site(f"{PROFILE}{parameters}"), "carrier")
    world = ground.rover.world
    world.act("scout", Action.COLLECT, 1, BASE)
    world.act("scout", Action.DROP, 1, BASE)
    ground.start([delay(1, -1, -1, -1), do(SERVO, 9, 1900), do(RELAY, 2, 1), do(RELAY, 1, 1),
                  do(GRIPPER, 1, 0), delay(9, -1, -1, -1)])  # fmt: skip
    ground.wait(5.0)
    outputs = ground.rover.autopilot.outputs
    assert (outputs.servos_us, outputs.relays, outputs.outcome) == ({}, {1: True}, None)
    assert "ServoRelayEvent: Channel 9 is already in use" in ground.texts()
    assert "Gripper Released" in ground.texts()


def test_a_gripper_action_that_does_not_exist_hangs_the_autopilot_until_it_is_restarted() -> None:
    ground = carrier()
    ground.start([do(GRIPPER, 1, 2), delay(9, -1, -1, -1)])
    ground.take()
    assert ground.wait(30.0) == []
    assert ground.send(mavlink.MAVLink_mission_request_list_message(1, 1)) == []
    ground.rover.reboot(ground.now_s)
    assert of(ground.wait(3.0), "HEARTBEAT")


@pytest.mark.parametrize(
    ("params", "waited_s"),
    [
        ((2.5, -1, -1, -1), 2.5),
        ((0, -1, -1, -1), 0.0),
        ((-1, -1, -1, 10), 9.5),
        ((-1, -1, 1, 0), 59.5),
        ((-1, 0, 0, 7), 6.5),
        ((-1, 0, 0, 0), 86399.5),
        ((0, 0, 0, 0), 86399.5),
    ],
)
def test_a_delay_is_relative_or_until_a_time_of_day(params: tuple[float, ...], waited_s: float) -> None:
    ground = carrier()
    ground.now_s = MIDNIGHT_S - 5.5
    ground.rover.reboot(ground.now_s)
    ground.start([delay(*params)])  # begins half a second past midnight, which then is that of tomorrow
    assert ground.now_s == pytest.approx(MIDNIGHT_S + 0.5, abs=0.01)
    step_s = 0.1 if waited_s < 100.0 else 100.0
    ground.wait(waited_s - 4 * step_s, step_s=step_s)
    assert "Mission Complete" not in ground.texts()
    ground.wait(6 * step_s if waited_s else step_s, step_s=step_s)
    assert "Mission Complete" in ground.texts()


@pytest.mark.parametrize(("late_s", "waited_s"), [(-20.0, 20.0), (4.0, 0.0), (3600.0, 0.0)])
def test_the_script_passes_its_gate_at_the_time_of_day_and_at_once_when_late(
    late_s: float, waited_s: float
) -> None:
    ground = ground_for(site(PROFILE))
    gate_s = START_S + 6.0 - late_s
    gate = action(Action.WAIT, stop=1, tag=5)._replace(y=gate_code(gate_s))
    ground.start([gate])
    ground.wait(waited_s - 1.0)
    assert "Mission Complete" not in ground.texts()
    ground.wait(5.5 if waited_s else 0.2)  # the time travels in units of four seconds
    assert "Mission Complete" in ground.texts()


def test_the_script_goes_on_without_a_missing_container_only_where_it_is_told_to() -> None:
    lenient, strict = ground_for(site(PROFILE)), ground_for(site(PROFILE))
    pick = action(Action.PICK, stop=1, tag=9)
    lenient.start([pick._replace(y=1), delay(1, -1, -1, -1)])
    strict.start([pick, delay(1, -1, -1, -1)])
    for ground in (lenient, strict):
        ground.wait(30.0)
        assert {(r.tag, r.result) for r in ground.reports()} == {(9, "missing")}
    assert "Mission Complete" in lenient.texts()
    assert strict.rover.autopilot.mode == mavlink.ROVER_MODE_HOLD


def test_hardware_that_knows_no_tags_moves_what_came_first() -> None:
    world = World(site(PROFILE))
    for node in (A, B):
        assert world.work("carrier", {Action.COLLECT}, node) == Outcome("ok")
    assert [world.containers[tag].node for tag in world.on_board("carrier")] == ["a", "b"]
    world.work("carrier", {Action.DROP, Action.UNLOAD}, B)
    ((lying, place),) = world.caches().items()
    assert (world.containers[lying].node, place) == ("a", B)
    assert world.work("carrier", {Action.PICK}, B).result == "missing", "it does not fetch what it left"
    world.work("carrier", {Action.DROP, Action.UNLOAD}, BASE)
    assert [world.containers[tag].node for tag in world.delivered()] == ["b"], "a depot is no cache"
    assert world.work("carrier", {Action.DROP}, B).result == "missing"


def test_a_script_takes_a_container_without_a_label_for_its_own_and_labels_it() -> None:
    world = World(site(PROFILE))
    world.work("carrier", {Action.COLLECT}, A)
    world.work("carrier", {Action.DROP}, A)
    assert world.act("scout", Action.PICK, 3, B).result == "missing"
    assert world.act("scout", Action.PICK, 3, A).result == "ok"
    assert (world.on_board("scout"), world.containers[3].sampler) == ([3], "carrier")
    world.act("scout", Action.DROP, 3, A)
    world.work("carrier", {Action.PICK}, A)
    assert world.on_board("carrier") == [3]


def test_a_movement_of_the_mission_moves_a_container_and_its_rest_does_not() -> None:
    ground = carrier()
    world = ground.rover.world
    ground.start([waypoint(world, "a"), do(SERVO, 9, 1900), delay(5, -1, -1, -1), do(SERVO, 9, 1100),
                  do(GRIPPER, 1, 0), delay(3, -1, -1, -1)])  # fmt: skip
    ground.wait(103.0)
    assert [world.containers[tag].node for tag in world.on_board("carrier")] == ["a"]
    ground.wait(10.0)
    assert world.on_board("carrier") == []
    assert list(world.caches().values()) == [A]


def test_a_person_does_by_hand_what_is_manual_and_sees_what_hardware_did() -> None:
    ground = ground_for(site("vehicles: {scout: {payload: {pick: {by: manual}}}}"))
    pilot = ground.rover.autopilot
    assert pilot.attended(Action.COLLECT, 1).result == "unknown", "nothing has moved yet"
    assert pilot.attended(Action.PICK, 1).result == "missing"
    pilot.position = A
    ground.rover.world.act("carrier", Action.COLLECT, 1, A)
    ground.rover.world.act("carrier", Action.DROP, 1, A)
    assert pilot.attended(Action.PICK, 1).result == "ok"
    assert ground.rover.world.on_board("scout") == [1]
