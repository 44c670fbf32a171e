"""AUTO on a virtual clock: driving, payload actions, energy, and what goes wrong."""

from __future__ import annotations

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from sim_cases import Ground, action, ground_for, numbered, of, site, waypoint

from malipp_field.sim import RoverConfig, World
from malipp_field.vehicle.items import MissionItem
from malipp_field.vehicle.steps import Action

HOLD, AUTO = mavlink.ROVER_MODE_HOLD, mavlink.ROVER_MODE_AUTO
DIAGONAL_M = math.hypot(100.0, 60.0)
ROUND_J = 3.0 * (100.0 * 15.0 + 1.5 * 90.0 * 19.0 + DIAGONAL_M * 17.0)
"""The paper's sum of alpha_e (m^0 + m^s Q) over the tour of `tour`, by hand."""
ROUND_S = 100.0 / 2.0 + 12.0 + 90.0 / 1.0 + 12.0 + DIAGONAL_M / 2.0 + 12.0
SLOPE = """
simulation:
  terrain: [{x_m: 50.0, y_m: 0.0, radius_m: 10.0, speed_factor: 0.5, energy_factor: 2.0}]
"""


def tour(world: World) -> list[MissionItem]:
    """Return a tour of the small site: two samples at a, one dropped at b, the other brought home."""
    return [
        waypoint(world, "a"), action(Action.COLLECT, 1, 1), action(Action.COLLECT, 1, 2),
        waypoint(world, "b"), action(Action.DROP, 2, 1),
        waypoint(world, "base"), action(Action.UNLOAD, 3, 2),
    ]  # fmt: skip


def test_a_mission_with_payload_actions_end_to_end() -> None:
    ground = ground_for(site())
    world = ground.rover.world
    ground.start(tour(world))
    began_s = ground.now_s
    while "Mission Complete" not in ground.texts():
        ground.wait(0.5)
    assert ground.now_s - began_s == pytest.approx(ROUND_S, abs=0.6)
    assert ground.texts() == [
        "Reached waypoint #1", "Reached waypoint #4", "Reached waypoint #6", "Mission Complete",
    ]  # fmt: skip
    assert [m.seq for m in of(ground.heard, "MISSION_ITEM_REACHED")] == [1, 2, 3, 4, 5, 6, 7]
    assert world.caches() == {1: (100.0, 60.0)}
    assert world.delivered() == {2: "base"}
    assert ground.rover.autopilot.energy_used_j == pytest.approx(ROUND_J, rel=1e-9)
    assert (ground.rover.autopilot.mode, ground.rover.autopilot.armed) == (AUTO, True)
    last = of(ground.heard, "MISSION_CURRENT")[-1]
    assert (last.mission_state, last.total) == (mavlink.MISSION_STATE_COMPLETE, 7)
    confirmed = {r.number: (r.action, r.tag, r.result) for r in ground.reports()}
    assert confirmed == {
        1: ("collect", 1, "ok"), 2: ("collect", 2, "ok"), 3: ("drop", 1, "ok"), 4: ("unload", 2, "ok"),
    }  # fmt: skip
    assert all((r.value is not None) == (r.action is Action.COLLECT) for r in ground.reports())


@pytest.mark.parametrize("terrain", ["", SLOPE])
@settings(max_examples=15, deadline=None)
@given(steps=st.lists(st.floats(0.01, 70.0), min_size=1, max_size=20))
def test_the_step_size_makes_no_difference(terrain: str, steps: list[float]) -> None:
    ends = []
    for sizes in (steps, [400.0]):
        ground = ground_for(site(terrain))
        ground.start(tour(ground.rover.world))
        end_s = ground.now_s + 400.0
        for size in [*sizes, 400.0]:
            ground.wait(min(size, end_s - ground.now_s), step_s=size)
        pilot = ground.rover.autopilot
        ends.append((pilot.position, pilot.energy_used_j, ground.texts()))
        assert "Mission Complete" in ground.texts()
    assert ends[0][0] == ends[1][0]
    assert ends[0][1] == pytest.approx(ends[1][1], rel=1e-9)
    assert ends[0][2] == ends[1][2]


def test_stepping_part_of_the_way_gives_the_same_place_as_one_step() -> None:
    places = []
    for step_s in (0.05, 3.7, 137.0):
        ground = ground_for(site(SLOPE))
        ground.start(tour(ground.rover.world))
        ground.wait(137.0, step_s)
        places.append((*ground.rover.autopilot.position, ground.rover.autopilot.energy_used_j))
    assert places[0] == pytest.approx(places[2], rel=1e-9)
    assert places[1] == pytest.approx(places[2], rel=1e-9)


def test_terrain_delays_and_drains_and_telemetry_shows_it() -> None:
    ground = ground_for(site(SLOPE))
    ground.start([waypoint(ground.rover.world, "a")])
    ground.wait(25.0)
    assert of(ground.heard, "VFR_HUD")[-1].groundspeed == pytest.approx(1.0)
    ground.wait(34.0)
    assert not ground.texts()
    ground.wait(3.0)
    assert ground.texts() == ["Reached waypoint #1", "Mission Complete"]
    energy_wh = of(ground.heard, "NAMED_VALUE_FLOAT")[-1]
    assert energy_wh.name == "MLP_WH"
    assert energy_wh.value * 3600.0 == pytest.approx(3.0 * 120.0 * 15.0, rel=1e-6)
    battery = of(ground.heard, "BATTERY_STATUS")[-1]
    assert battery.energy_consumed == 54
    assert battery.current_consumed == round(5400.0 / 12.0 / 3.6)


def test_the_actions_of_a_stop_share_its_service_time() -> None:
    ground = ground_for(site())
    world = ground.rover.world
    ground.start([
        waypoint(world, "a"), *[action(Action.COLLECT, 1, tag) for tag in (1, 2)],
        *[action(Action.DROP, 1, tag) for tag in (1, 2)], waypoint(world, "base"),
    ])  # fmt: skip
    ground.wait(50.0 + 8.9)
    assert {r.number for r in ground.reports()} == {1, 2}
    ground.wait(3.2)
    assert {r.number for r in ground.reports()} == {1, 2, 3, 4}
    assert of(ground.heard, "MISSION_CURRENT")[-1].seq == 6


def test_a_confirmation_is_repeated_every_second_until_acknowledged() -> None:
    ground = ground_for(site())
    ground.start([waypoint(ground.rover.world, "a"), *[action(Action.COLLECT, 1, t) for t in (1, 2)]])
    ground.wait(62.05)
    ground.heard.clear()
    ground.wait(5.0)
    for number in (1, 2):
        assert [r.number for r in ground.reports()].count(number) in (4, 5)
    ground.acknowledge(99)  # never given: no acknowledgement of anything
    ground.acknowledge(2, system_id=2)  # another vehicle on the same radio
    ground.acknowledge(1)
    ground.heard.clear()
    ground.wait(5.0)
    assert {r.number for r in ground.reports()} == {2}
    ground.acknowledge(2)
    ground.heard.clear()
    ground.wait(5.0)
    assert ground.reports() == []


def test_a_missing_container_is_confirmed_as_missing_and_the_rover_holds() -> None:
    ground = ground_for(site())
    world = ground.rover.world
    ground.start([waypoint(world, "a"), action(Action.PICK, 1, 5), waypoint(world, "base")])
    ground.wait(120.0)
    assert {(r.number, r.action, r.tag, r.result) for r in ground.reports()} == {(1, "pick", 5, "missing")}
    assert ground.rover.autopilot.mode == HOLD
    assert ground.rover.autopilot.position == (100.0, 0.0)
    assert "Cannot pick 5: holding" in ground.texts()
    heartbeat = of(ground.heard, "HEARTBEAT")[-1]
    assert heartbeat.custom_mode == HOLD


def test_going_on_after_a_hold_tries_the_action_again() -> None:
    world = World(site())
    world.act("carrier", Action.COLLECT, 5, (100.0, 0.0))
    ground = ground_for(site(), world=world)
    ground.start([waypoint(world, "a"), action(Action.PICK, 1, 5), waypoint(world, "base")])
    ground.wait(100.0)
    assert ground.rover.autopilot.mode == HOLD
    world.act("carrier", Action.DROP, 5, (100.0, 0.0))
    ground.mode(AUTO)
    ground.wait(100.0)
    assert [r.result for r in ground.reports() if r.number == 2][:1] == ["ok"]
    assert "Mission Complete" in ground.texts()
    assert world.on_board("scout") == [5]


def test_a_gate_holds_until_the_ground_lets_the_rover_pass() -> None:
    ground = ground_for(site())
    world = ground.rover.world
    ground.start([waypoint(world, "a"), action(Action.WAIT, 1, 5), waypoint(world, "base")])
    ground.wait(3600.0, step_s=10.0)
    assert ground.rover.autopilot.position == (100.0, 0.0)
    assert of(ground.heard, "MISSION_CURRENT")[-1].seq == 2
    assert ground.reports() == []
    assert ground.command(mavlink.MAV_CMD_DO_SET_MISSION_CURRENT, 3.0) == mavlink.MAV_RESULT_ACCEPTED
    assert of(ground.heard, "MISSION_CURRENT")[-1].seq == 3
    ground.wait(51.0)
    assert "Mission Complete" in ground.texts()


def test_an_action_done_before_a_restart_is_confirmed_again_and_done_once() -> None:
    ground = ground_for(site())
    world = ground.rover.world
    ground.start([waypoint(world, "a"), action(Action.COLLECT, 1, 7), waypoint(world, "base")])
    ground.wait(70.0)
    first = ground.reports()[0]
    ground.rover.reboot(ground.now_s)
    ground.wait(6.0)
    ground.heard.clear()
    ground.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)
    ground.command(mavlink.MAV_CMD_DO_SET_MISSION_CURRENT, 1.0)
    ground.mode(AUTO)
    ground.wait(30.0)
    again = ground.reports()[0]
    assert (again.number, again.action, again.tag, again.value) == (1, Action.COLLECT, 7, first.value)
    assert world.on_board("scout") == [7]


def test_an_empty_battery_strands_the_rover_where_it_stands() -> None:
    ground = ground_for(site(energy_budget_j=str(3.0 * 15.0 * 70.0)))
    ground.start(tour(ground.rover.world))
    ground.wait(60.0)
    assert ground.texts() == ["Battery empty: cannot move"]
    assert ground.rover.autopilot.position == pytest.approx((70.0, 0.0), abs=1e-3)
    stranded_at = ground.rover.autopilot.position
    ground.mode(HOLD)
    ground.mode(AUTO)
    ground.wait(600.0, step_s=5.0)
    assert ground.rover.autopilot.position == pytest.approx(stranded_at, abs=1e-6)
    assert ground.texts().count("Battery empty: cannot move") == 1
    assert of(ground.heard, "VFR_HUD")[-1].groundspeed == 0.0
    assert of(ground.heard, "HEARTBEAT")[-1].system_status == mavlink.MAV_STATE_CRITICAL
    assert of(ground.heard, "BATTERY_STATUS")[-1].battery_remaining == 0


def test_a_budget_used_to_the_last_joule_is_enough() -> None:
    ground = ground_for(site(energy_budget_j=repr(ROUND_J)))
    ground.start(tour(ground.rover.world))
    ground.wait(300.0, step_s=0.7)
    assert "Mission Complete" in ground.texts()


def test_without_a_script_on_board_reached_proves_nothing() -> None:
    ground = ground_for(site(), config=RoverConfig(has_script=False))
    world = ground.rover.world
    ground.start([waypoint(world, "a"), action(Action.COLLECT, 1, 7, timeout_s=5.0), waypoint(world, "b")])
    ground.wait(60.0)
    assert [m.seq for m in of(ground.heard, "MISSION_ITEM_REACHED")] == [1, 2]
    assert ground.reports() == []
    assert world.on_board("scout") == []


def test_without_a_script_and_a_timeout_the_rover_waits_for_ever() -> None:
    ground = ground_for(site(), config=RoverConfig(has_script=False))
    world = ground.rover.world
    ground.start([waypoint(world, "a"), action(Action.COLLECT, 1, 7), waypoint(world, "b")])
    ground.wait(36000.0, step_s=100.0)
    assert ground.rover.autopilot.position == (100.0, 0.0)


def test_an_action_code_the_script_does_not_know_holds_the_rover() -> None:
    ground = ground_for(site())
    ground.start([action(Action.COLLECT, 1, 7)._replace(param1=99.0), waypoint(ground.rover.world, "b")])
    ground.wait(5.0)
    assert ground.rover.autopilot.mode == HOLD
    assert ground.texts() == ["MLP unknown action code 99"]


def test_set_current_takes_up_the_new_mission_at_once() -> None:
    ground = ground_for(site())
    world = ground.rover.world
    ground.start([waypoint(world, "a"), waypoint(world, "b")])
    ground.wait(10.0)
    ground.upload(numbered(world, [waypoint(world, "b"), waypoint(world, "base")]))
    assert ground.command(mavlink.MAV_CMD_DO_SET_MISSION_CURRENT, 2.0) == mavlink.MAV_RESULT_ACCEPTED
    ground.wait(9.0)
    assert ground.rover.autopilot.position == pytest.approx((2.0, 0.0), abs=0.3)


def test_a_mission_shorter_than_the_present_item_is_complete_when_that_ends() -> None:
    ground = ground_for(site())
    world = ground.rover.world
    ground.start([waypoint(world, "base"), waypoint(world, "base"), waypoint(world, "a")])
    ground.wait(10.0)
    ground.upload(numbered(world, [waypoint(world, "b")]))
    ground.wait(45.0)
    assert ground.texts()[-3:] == [
        "Auto mission changed but failed to restart command", "Reached waypoint #3", "Mission Complete",
    ]  # fmt: skip


def test_a_completed_mission_goes_on_only_with_reset() -> None:
    ground = ground_for(site())
    world = ground.rover.world
    ground.start([waypoint(world, "a")])
    ground.wait(60.0)
    ground.upload(numbered(world, [waypoint(world, "base"), waypoint(world, "b")]))
    assert ground.command(mavlink.MAV_CMD_DO_SET_MISSION_CURRENT, 1.0) == mavlink.MAV_RESULT_ACCEPTED
    ground.wait(20.0)
    assert ground.rover.autopilot.position == (100.0, 0.0)
    assert ground.command(mavlink.MAV_CMD_DO_SET_MISSION_CURRENT, 1.0, 1.0) == mavlink.MAV_RESULT_ACCEPTED
    ground.wait(20.0)
    assert ground.rover.autopilot.position == pytest.approx((60.0, 0.0), abs=0.5)


def test_delays_holds_and_the_way_home() -> None:
    ground = ground_for(site())
    world = ground.rover.world
    nothing = waypoint(world, "base")
    ground.start([
        waypoint(world, "a", hold_s=7.0),
        nothing._replace(command=mavlink.MAV_CMD_NAV_DELAY, param1=2.5),
        nothing._replace(command=mavlink.MAV_CMD_NAV_DELAY, param2=-1.0, param3=-1.0, param4=-1.0),
        nothing._replace(command=mavlink.MAV_CMD_DO_GRIPPER, param2=1.0),
        waypoint(world, "a")._replace(command=mavlink.MAV_CMD_NAV_LOITER_TIME, param1=4.0),
        nothing._replace(command=mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH),
        waypoint(world, "a"),
    ])  # fmt: skip
    ground.wait(50.0 + 7.0 + 2.5 + 4.0 + 50.0 - 0.3)
    assert [m.seq for m in of(ground.heard, "MISSION_ITEM_REACHED")] == [1, 2, 3, 5]
    ground.wait(0.6)
    assert of(ground.heard, "MISSION_ITEM_REACHED")[-1].seq == 6
    assert "Reached waypoint #1. Loiter for 7 seconds" in ground.texts()
    ground.wait(51.0)
    assert "Mission Complete" in ground.texts()


def test_a_delay_of_all_zeros_waits_until_midnight_utc() -> None:
    ground = ground_for(site())
    ground.start([waypoint(ground.rover.world, "base")._replace(command=mavlink.MAV_CMD_NAV_DELAY)])
    until_midnight_s = 86400.0 - ground.now_s % 86400.0
    ground.wait(until_midnight_s - 5.0, step_s=60.0)
    assert not of(ground.heard, "MISSION_ITEM_REACHED")
    ground.wait(10.0)
    assert of(ground.heard, "MISSION_ITEM_REACHED")


def test_loitering_without_limit_never_ends() -> None:
    ground = ground_for(site())
    world = ground.rover.world
    ground.start([waypoint(world, "a")._replace(command=17), waypoint(world, "b")])
    ground.wait(10000.0, step_s=100.0)
    assert ground.rover.autopilot.position == (100.0, 0.0)


def test_two_rovers_hand_over_a_container() -> None:
    mission = site()
    world = World(mission)
    scout = ground_for(mission, "scout", world)
    carrier = ground_for(mission, "carrier", world)
    scout.start([waypoint(world, "a"), action(Action.COLLECT, 1, 1), action(Action.DROP, 1, 1)])
    carrier.start([
        waypoint(world, "a"), action(Action.WAIT, 1, 1), action(Action.PICK, 1, 1),
        waypoint(world, "base"), action(Action.UNLOAD, 2, 1),
    ])  # fmt: skip

    def both(duration_s: float) -> None:
        scout.wait(duration_s)
        carrier.wait(duration_s)

    both(120.0)
    assert world.caches() == {1: (100.0, 0.0)}
    carrier.command(mavlink.MAV_CMD_DO_SET_MISSION_CURRENT, 3.0)
    both(150.0)
    assert world.delivered() == {1: "base"}
    energy_j = carrier.rover.autopilot.energy_used_j
    assert energy_j == pytest.approx(3.0 * 100.0 * (90.0 + 92.0), rel=1e-9)


def distance_left_m(ground: Ground) -> float:
    return math.dist(ground.rover.autopilot.position, (100.0, 0.0))


def test_disarming_outside_auto_begins_the_mission_anew() -> None:
    ground = ground_for(site())
    world = ground.rover.world
    ground.start([waypoint(world, "a"), waypoint(world, "b"), waypoint(world, "base")])
    ground.wait(60.0)
    assert ground.rover.autopilot.run.seq == 2
    ground.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0.0)
    assert of(ground.wait(1.1), "MISSION_CURRENT")[-1].seq == 2  # in AUTO it keeps its place
    ground.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)
    ground.mode(mavlink.ROVER_MODE_HOLD)
    ground.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0.0)
    assert of(ground.wait(1.1), "MISSION_CURRENT")[-1].seq == 0
    ground.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)
    ground.mode(mavlink.ROVER_MODE_AUTO)
    assert of(ground.wait(1.1), "MISSION_CURRENT")[-1].seq == 1


def test_hold_and_disarm_stop_the_rover_and_it_goes_on_from_there() -> None:
    ground = ground_for(site())
    ground.start([waypoint(ground.rover.world, "a")])
    ground.wait(10.0)
    ground.mode(HOLD)
    ground.wait(10.0)
    assert distance_left_m(ground) == pytest.approx(80.0, abs=0.5)
    assert of(ground.heard, "MISSION_CURRENT")[-1].mission_state == mavlink.MISSION_STATE_NOT_STARTED
    ground.mode(AUTO)
    ground.wait(10.0)
    assert distance_left_m(ground) == pytest.approx(60.0, abs=0.5)
    ground.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0.0)
    ground.wait(10.0)
    assert distance_left_m(ground) == pytest.approx(60.0, abs=0.5)
    ground.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)
    ground.wait(31.0)
    assert distance_left_m(ground) == 0.0


def test_entering_auto_again_carries_out_what_is_stored_under_the_old_number() -> None:
    ground = ground_for(site())
    world = ground.rover.world
    ground.start([waypoint(world, "a"), waypoint(world, "base")])
    ground.wait(10.0)
    ground.mode(HOLD)
    ground.upload(numbered(world, [waypoint(world, "base"), waypoint(world, "a")]))
    ground.mode(AUTO)
    ground.wait(9.0)
    assert ground.rover.autopilot.position == pytest.approx((2.0, 0.0), abs=0.3)
