"""A mission changed under a rover in AUTO, and a rover in AUTO that is not armed."""

from __future__ import annotations

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from sim_cases import Ground, action, ground_for, item_int, numbered, of, site, waypoint

from malipp_field.vehicle.steps import Action

AUTO = mavlink.ROVER_MODE_AUTO
RESTARTED = "Auto mission changed, restarted command"


def driving(*nodes: str) -> Ground:
    """Return the ground of a rover that has driven for ten seconds."""
    ground = ground_for(site())
    ground.start([waypoint(ground.rover.world, node) for node in nodes])
    ground.wait(10.0)
    return ground


def test_an_upload_in_auto_has_the_rover_begin_the_item_of_the_current_number_anew() -> None:
    ground = driving("a", "b")
    world = ground.rover.world
    ground.upload(numbered(world, [waypoint(world, "b"), waypoint(world, "base"), waypoint(world, "a")]))
    ground.wait(0.2)
    assert set(ground.texts()) == {RESTARTED}  # whenever it looks, in the middle of the upload too
    ground.wait(49.4)
    assert ground.rover.autopilot.position == pytest.approx((100.0, 60.0), abs=2.0)
    assert of(ground.heard, "MISSION_CURRENT")[-1].seq == 1


def test_a_leg_begun_anew_as_it_was_goes_on_as_if_nothing_had_been() -> None:
    changed, left = driving("a", "b"), driving("a", "b")
    world = changed.rover.world
    changed.upload(numbered(world, [waypoint(world, "a"), waypoint(world, "base")]))
    for ground in (changed, left):
        ground.wait(30.0)
    assert (set(changed.texts()), left.texts()) == ({RESTARTED}, [])
    assert changed.rover.autopilot.position == pytest.approx(left.rover.autopilot.position)
    assert changed.rover.autopilot.energy_used_j == pytest.approx(left.rover.autopilot.energy_used_j)


def test_what_is_stored_in_the_middle_of_an_upload_counts() -> None:
    ground = driving("base", "a", "b")
    assert of(ground.heard, "MISSION_CURRENT")[-1].seq == 2
    world = ground.rover.world
    ground.send(mavlink.MAVLink_mission_count_message(1, 1, 3))
    ground.wait(0.2)
    assert ground.texts()[-1] == RESTARTED
    for node in ("base", "base", "b"):
        request = of(ground.heard, "MISSION_REQUEST")[-1]
        ground.send(item_int(waypoint(world, node)._replace(seq=request.seq)))
        ground.wait(0.2)
    assert ground.texts().count(RESTARTED) == 2
    ground.wait(5.0)
    assert ground.rover.autopilot.position[1] > 4.0  # to b


def test_changes_beyond_the_next_three_and_during_an_action_are_not_acted_on() -> None:
    ground = driving("a", "b", "base", "a")
    world = ground.rover.world
    ground.upload(numbered(world, [waypoint(world, node) for node in ("a", "b", "base", "b")]))
    ground.wait(10.0)
    assert ground.texts() == []
    waits = ground_for(site())
    waits.start([action(Action.WAIT, 1, 5), waypoint(world, "b")])
    waits.wait(5.0)
    waits.upload(numbered(world, [waypoint(world, "a"), waypoint(world, "b")]))
    waits.wait(20.0)
    assert (waits.texts(), waits.rover.autopilot.position) == ([], (0.0, 0.0))


def test_in_auto_all_but_driving_goes_on_disarmed() -> None:
    ground = ground_for(site(start="a"))
    world = ground.rover.world
    delay = waypoint(world, "a")._replace(command=mavlink.MAV_CMD_NAV_DELAY, param1=3.0)
    ground.upload(numbered(world, [delay, action(Action.COLLECT, 1, 7), waypoint(world, "a"), delay]))
    ground.mode(AUTO)
    ground.wait(60.0)
    assert not ground.rover.autopilot.armed
    assert world.on_board("scout") == [7]
    assert [m.seq for m in of(ground.heard, "MISSION_ITEM_REACHED")] == [1, 2]
    assert of(ground.heard, "MISSION_CURRENT")[-1].seq == 3  # it is there, but has not reached it
    ground.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)
    ground.wait(4.0)
    assert "Mission Complete" in ground.texts()
