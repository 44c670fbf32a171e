"""A mission replaced under way: without a stop where the rover's own failsafe makes that safe, else held."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from agent_cases import STOP, Yard, mode_of
from fault_cases import ALL_DONE, GUARDED, NEW, GuardedYard
from link_cases import SYSTEM, framed
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from malipp_field.bus.messages import Load, Start, Telemetry
from malipp_field.link.heartbeats import Heartbeats
from malipp_field.link.replacement import Guard, NotProvableError, driving_s
from malipp_field.link.vehicle import Vehicle
from malipp_field.vehicle.steps import GeoPoint

AUTO, HOLD = mavlink.ROVER_MODE_AUTO, mavlink.ROVER_MODE_HOLD


async def under_way(yard: GuardedYard) -> None:
    """Let the rover drive its first leg, which takes a minute, for long enough to be known."""
    assert (await yard.order(Load(mission=yard.old()))).ok
    assert (await yard.order(Start())).ok
    await yard.live(9.0)


def held_since(yard: GuardedYard, when_s: float) -> bool:
    return any(t.mode == "HOLD" for t in yard.bus.of(Telemetry) if t.time_s > when_s)


@pytest.mark.parametrize("loss", [0.0, 0.1])
def test_a_vehicle_on_a_leg_of_both_missions_is_not_stopped(loss: float) -> None:
    async def scene(yard: GuardedYard) -> None:
        await under_way(yard)
        began_s = yard.clock.now_s()
        reply = await yard.order(Load(mission=yard.new(), resume=True))
        assert reply.text == "version 2 is on board and verified; the vehicle was not stopped for it"
        assert not held_since(yard, began_s)
        assert len(yard.begun) > 2  # begun, begun anew as the mission changed under it, and made current
        assert {item[2:] for item in yard.begun} == {yard.begun[0][2:]}
        assert yard.aboard() == NEW
        assert (yard.telemetry.mission_version, yard.telemetry.step_uid) == (2, "drive a")
        await yard.until(lambda: yard.telemetry.finished, limit_s=600.0)
        assert [uid for _, uid, _ in yard.confirmed] == ALL_DONE

    GuardedYard(seed=1, loss=loss, **GUARDED).run(scene)


@pytest.mark.parametrize(
    "parameters",
    [
        {"FS_GCS_ENABLE": 0.0},
        {"FS_GCS_ENABLE": 2.0},
        {"FS_ACTION": 1.0},
        {"FS_THR_ENABLE": 1.0},
        {"FS_GCS_TIMEOUT": 60.0},
        {"MAV_GCS_SYSID": 245.0},
        {"WP_SPEED": 0.0},
        {"WP_SPEED": 100.0},
    ],
    ids=lambda parameters: "-".join(f"{name}={value:g}" for name, value in parameters.items()),
)
def test_a_vehicle_whose_failsafe_would_not_hold_it_in_time_is_held(parameters: dict[str, float]) -> None:
    async def scene(yard: GuardedYard) -> None:
        await under_way(yard)
        began_s = yard.clock.now_s()
        reply = await yard.order(Load(mission=yard.new(), resume=True))
        assert reply.text == "version 2 is on board and verified"
        assert held_since(yard, began_s)
        assert (mode_of(yard), yard.aboard()) == (AUTO, NEW)

    GuardedYard(**(GUARDED | parameters)).run(scene)  # type: ignore[arg-type]


def test_a_vehicle_that_hears_somebody_else_of_our_system_id_is_held() -> None:
    async def scene(yard: GuardedYard) -> None:
        await under_way(yard)
        beat = mavlink.MAVLink_heartbeat_message(mavlink.MAV_TYPE_GCS, 8, 0, 0, 4, 3)
        yard._on_message(framed(beat, 255, 230))
        reply = await yard.order(Load(mission=yard.new(), resume=True))
        assert reply.text == "version 2 is on board and verified"

    GuardedYard(**GUARDED).run(scene)  # type: ignore[arg-type]


def test_a_leg_that_has_another_number_in_the_new_mission_is_held() -> None:
    async def scene(yard: GuardedYard) -> None:
        await under_way(yard)
        await yard.until(lambda: yard.telemetry.step_uid == "drive b", limit_s=700.0)
        await yard.live(8.0)
        began_s = yard.clock.now_s()
        new = yard.new()
        new = new.model_copy(update={"steps": (yard.old().steps[2], *new.steps[2:])})
        reply = await yard.order(Load(mission=new, resume=True))
        assert reply.text == "version 2 is on board and verified"
        assert held_since(yard, began_s)

    yard = GuardedYard(seed=1, **GUARDED)
    yard.aboard = lambda: ("any",)  # type: ignore[method-assign]
    yard.run(scene)


def test_a_mission_that_begins_with_work_does_nothing_before_the_vehicle_is_armed() -> None:
    work = ("collect a 1", "drive base", "unload base 1")

    async def scene(yard: Yard) -> None:
        pilot = yard.rover.autopilot
        pilot.position = yard.world.places["a"]
        arm, refusals = pilot.arm, 0

        def refuse(force: bool = False) -> bool:
            nonlocal refusals
            refusals += 1
            return False

        pilot.arm = refuse  # type: ignore[method-assign]
        assert (await yard.order(Load(mission=yard.mission(*work)))).ok
        start = yard.begin(Start())
        await yard.until(lambda: pilot.mode == AUTO, limit_s=60.0)
        await yard.until(start.done)
        assert (start.result().ok, refusals > 0, pilot.armed) == (False, True, False)
        pilot.set_mode(AUTO)  # whoever sets it
        await yard.live(20.0)
        assert (yard.world.on_board("scout"), yard.confirmed, pilot.run.seq) == ([], [], 1)
        pilot.arm = arm  # type: ignore[method-assign]
        assert (await yard.order(Start())).ok
        await yard.until(lambda: yard.telemetry.finished)
        assert [uid for _, uid, _ in yard.confirmed] == ["collect a 1", "unload base 1"]

    Yard().run(scene)


def test_near_the_end_of_its_leg_it_is_held() -> None:
    async def scene(yard: GuardedYard) -> None:
        await under_way(yard)
        await yard.live(25.0)
        began_s = yard.clock.now_s()
        assert (await yard.order(Load(mission=yard.new(), resume=True))).ok
        assert held_since(yard, began_s)

    GuardedYard(**GUARDED).run(scene)  # type: ignore[arg-type]


def test_without_resume_it_is_always_left_holding() -> None:
    async def scene(yard: GuardedYard) -> None:
        await under_way(yard)
        assert (await yard.order(Load(mission=yard.new()))).ok
        assert (mode_of(yard), yard.aboard()) == (HOLD, NEW)

    GuardedYard(**GUARDED).run(scene)  # type: ignore[arg-type]


def test_an_upload_that_takes_too_long_ends_in_hold_before_the_leg_does() -> None:
    """The vehicle hears us but asks for nothing more: heartbeats alone must not keep it going."""

    async def scene(yard: GuardedYard) -> None:
        await under_way(yard)
        store = yard.rover.autopilot.store
        honest = store.receive
        store.receive = lambda message, sender, now_s: (  # type: ignore[method-assign]
            [] if message.get_type() == "MISSION_ITEM_INT" else honest(message, sender, now_s)
        )
        load = yard.begin(Load(mission=yard.new(), resume=True))
        await yard.until(lambda: mode_of(yard) == HOLD, limit_s=60.0)
        assert yard.rover.autopilot.position[0] < 590.0
        assert {item.seq for item in yard.begun} == {1}
        await yard.until(load.done, limit_s=400.0)
        assert not load.result().ok
        assert (mode_of(yard), yard.telemetry.mission_version) == (HOLD, None)
        assert not (await yard.order(Start())).ok

    GuardedYard(**GUARDED).run(scene)  # type: ignore[arg-type]


def test_a_vehicle_that_does_not_hear_to_hold_gets_no_heartbeats_until_it_is_seen_to() -> None:
    """Heartbeats get through, commands do not: the failsafe must not be fed."""

    async def scene(yard: GuardedYard) -> None:
        await under_way(yard)
        honest = yard.rover.receive
        yard.rover.receive = lambda message, peer, now_s: (  # type: ignore[method-assign]
            honest(message, peer, now_s) if message.get_type().startswith(("HEART", "PARAM")) else None
        )
        load = yard.begin(Load(mission=yard.new(), resume=True))
        await yard.until(load.done, limit_s=100.0)
        assert not load.result().ok
        await yard.until(lambda: mode_of(yard) == HOLD, limit_s=10.0)
        assert yard.rover.autopilot.position[0] < 590.0
        beats = [m for m in yard.heard if m.get_type() == "HEARTBEAT"]
        await yard.live(5.0)
        assert len([m for m in yard.heard if m.get_type() == "HEARTBEAT"]) >= len(beats) + 3  # and then again
        assert yard.begun[-1].seq == 1

    GuardedYard(**GUARDED).run(scene)  # type: ignore[arg-type]


def test_a_hold_while_it_is_replaced_under_way_holds() -> None:
    async def scene(yard: GuardedYard) -> None:
        await under_way(yard)
        load = yard.begin(Load(mission=yard.new(), resume=True))
        await yard.until(lambda: yard.rover.autopilot.store.receiving)
        assert mode_of(yard) == AUTO
        assert (await yard.order(STOP)).ok
        assert not load.result().ok
        assert mode_of(yard) == HOLD
        assert not (await yard.order(Start())).ok
        assert (await yard.order(Load(mission=yard.new(3)))).ok
        assert (await yard.order(Start())).ok
        await yard.until(lambda: yard.telemetry.finished, limit_s=600.0)
        assert [uid for _, uid, _ in yard.confirmed] == ALL_DONE

    GuardedYard(**GUARDED).run(scene)  # type: ignore[arg-type]


def test_a_person_who_takes_over_meanwhile_is_noticed() -> None:
    async def scene(yard: GuardedYard) -> None:
        await under_way(yard)
        load = yard.begin(Load(mission=yard.new(), resume=True))
        await yard.until(lambda: yard.rover.autopilot.store.receiving)
        yard.rover.autopilot.set_mode(mavlink.ROVER_MODE_MANUAL)
        await yard.until(load.done)
        assert "not stopped" not in load.result().text

    GuardedYard(**GUARDED).run(scene)  # type: ignore[arg-type]


def vehicle(lon_deg: float, speed_m_s: float = 1.0, position_s: float | None = 100.0) -> Vehicle:
    found = Vehicle(SYSTEM)
    found.lat_deg, found.lon_deg, found.speed_m_s, found.position_s = 60.0, lon_deg, speed_m_s, position_s
    return found


@pytest.mark.parametrize("lon_deg", [0.01, -0.01])
def test_driving_time_is_counted_at_the_highest_speed_from_where_it_may_be_by_now(lon_deg: float) -> None:
    target = GeoPoint(lat_deg=60.0, lon_deg=0.0)
    guard = Guard(holds_within_s=6.5, speed_m_s=2.0, radius_m=2.0)
    metres = 0.01 * 111_320.0 / 2.0 - 2.0  # a degree of longitude is half as long at 60 degrees
    assert driving_s(vehicle(lon_deg), target, guard, 101.0) == pytest.approx(metres / 2.5 - 4.0)
    fast = driving_s(vehicle(lon_deg, speed_m_s=4.0), target, guard, 100.0)
    assert fast == pytest.approx(metres / 5.0 - 3.0)
    with pytest.raises(NotProvableError, match="3 s old"):
        driving_s(vehicle(lon_deg), target, guard, 103.0)
    with pytest.raises(NotProvableError, match="not known"):
        driving_s(vehicle(lon_deg, position_s=None), target, guard, 103.0)


def test_heartbeats_stop_at_the_deadline_and_until_the_vehicle_has_left_auto() -> None:
    rover = Vehicle(SYSTEM)
    beats = Heartbeats(rover, 255, alone=True)
    rover.mode = "AUTO"
    assert beats.allowed(10.0)
    beats.only_until(20.0)
    assert [beats.allowed(at_s) for at_s in (19.9, 20.0, 500.0)] == [True, False, False]
    rover.mode = "HOLD"
    assert beats.allowed(501.0)
    rover.mode = "AUTO"
    assert beats.allowed(502.0)
    beats.stop()
    assert not beats.allowed(503.0)
    beats.go_on()
    assert beats.allowed(504.0)


@pytest.mark.parametrize(
    ("say", "theirs"),
    [
        (lambda: framed(mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3), 255, 230), True),
        (lambda: framed(mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3), 245, 190), False),
        (lambda: framed(mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3), 255, 190), True),
        (lambda: framed(mavlink.MAVLink_mission_current_message(1), 255, 230), False),
    ],
)
def test_who_else_feeds_the_failsafe(say: Callable[[], object], theirs: bool) -> None:
    beats = Heartbeats(Vehicle(SYSTEM), 255, alone=True)
    beats.overhear(say(), 100.0)
    assert beats.are_all_it_hears(109.0) is not theirs
    assert beats.are_all_it_hears(110.0)
    assert not Heartbeats(Vehicle(SYSTEM), 255, alone=False).are_all_it_hears(110.0)
