from __future__ import annotations

import random
from typing import Any

import pytest
from agent_cases import ROUND, STOP, WHERE, WORK_DONE, FakeBus, Yard, fly, mode_of
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from malipp_field.bus.messages import Confirmation, Event, Load, Start, Telemetry
from malipp_field.link import Agent
from malipp_field.link.agent import TELEMETRY_S
from malipp_field.link.compare import differences
from malipp_field.sim import RoverConfig
from malipp_field.sim.mission_run import RunState
from malipp_field.vehicle.layout import lay_out
from malipp_field.vehicle.steps import Action


def test_the_whole_way_on_a_good_link() -> None:
    async def scene(yard: Yard) -> None:
        assert yard.telemetry.mission_version is None
        assert (await yard.order(Load(mission=yard.mission(*ROUND)))).ok
        assert yard.telemetry.mission_version == 1
        assert yard.telemetry.step_uid is None
        assert (await yard.order(Start())).ok
        await yard.until(lambda: yard.telemetry.finished)
        assert yard.confirmed == [(n, uid, True) for n, uid in enumerate(WORK_DONE, start=1)]
        assert set(yard.world.delivered()) == {1, 2, 3}
        values = [c.value is not None for c in yard.bus.of(Confirmation)]
        assert values == [True] * 3 + [False] * 3
        seen = list(dict.fromkeys(t.step_uid for t in yard.bus.of(Telemetry)))
        assert seen == [None, *ROUND]
        assert (await yard.order(Start())).ok  # nothing is left to do

    Yard().run(scene)


def test_ticks_that_come_late_do_not_slow_telemetry() -> None:
    """Every tick takes half as long again as it should."""

    async def scene(yard: Yard) -> None:
        on_time = yard.clock.sleep
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(yard.clock, "sleep", lambda duration_s: on_time(1.5 * duration_s))
            before = len(yard.bus.of(Telemetry))
            await yard.live(20.0)
        assert 20.0 / TELEMETRY_S - 2 <= len(yard.bus.of(Telemetry)) - before <= 20.0 / TELEMETRY_S + 2

    Yard().run(scene)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("loss", [0.15, 0.3])
def test_the_whole_way_on_a_bad_link(seed: int, loss: float) -> None:
    """Loss, duplicates and late messages: every confirmation once, in order, and none before its time."""

    async def scene(yard: Yard) -> None:
        def acknowledged_only_what_is_published(message: Any) -> None:
            if message.get_type() == "NAMED_VALUE_INT":
                assert message.value <= len(yard.confirmed)

        yard.watch = acknowledged_only_what_is_published
        mission = yard.mission(*ROUND)
        while not (await yard.order(Load(mission=mission))).ok:
            assert yard.telemetry.mission_version is None
        while not (await yard.order(Start())).ok:
            await yard.live(1.0)
        await yard.until(lambda: yard.telemetry.finished, limit_s=900.0)
        assert yard.confirmed == [(n, uid, True) for n, uid in enumerate(WORK_DONE, start=1)]
        await yard.live(30.0)
        assert yard.rover.autopilot.script.due(1e12) == []  # the script has heard of all of it

    yard = Yard(seed, loss)
    yard.run(scene)


def test_only_a_verified_mission_is_started() -> None:
    async def scene(yard: Yard) -> None:
        reply = await yard.order(Start())
        assert (reply.ok, reply.text) == (False, "there is no verified mission on board")
        assert (await yard.order(Load(mission=yard.mission(*ROUND)))).ok

        # From now on the vehicle stores something else than it is sent.
        store = yard.rover.autopilot.store
        honest = store._store
        store._store = lambda item: honest(item._replace(param1=item.param1 + 1))  # type: ignore[method-assign]
        reply = await yard.order(Load(mission=yard.mission(*ROUND, version=2)))
        assert not reply.ok
        assert "item 1 (NAV_WAYPOINT): param1 is 1, not 0; " in reply.text.replace(": item", "; item") + "; "
        assert yard.telemetry.mission_version is None
        assert store.items == []  # a mixed mission was not left behind
        assert not (await yard.order(Start())).ok
        assert not yard.rover.autopilot.armed
        assert any(text.startswith("load was not done") for text in yard.events)

    Yard().run(scene)


def test_a_mission_that_is_too_large_or_for_another_robot() -> None:
    async def scene(yard: Yard) -> None:
        reply = await yard.order(Load(mission=yard.mission(*["drive a"] * 700)))
        assert "MAV_MISSION_NO_SPACE" in reply.text
        other = yard.mission("drive a").model_copy(update={"robot": "carrier"})
        assert "for 'carrier', not for 'scout'" in (await yard.order(Load(mission=other))).text

    Yard().run(scene)


def test_a_mission_of_nothing_is_finished_at_once() -> None:
    async def scene(yard: Yard) -> None:
        assert (await yard.order(Load(mission=yard.mission()))).ok
        await yard.live(0.5)
        assert yard.telemetry.finished
        assert (await yard.order(Start())).ok
        assert not yard.rover.autopilot.armed

    Yard().run(scene)


def test_another_version_than_the_one_meant_is_not_started() -> None:
    async def scene(yard: Yard) -> None:
        assert (await yard.order(Load(mission=yard.mission(*ROUND)))).ok
        reply = await yard.order(Start(version=2))
        assert (reply.ok, reply.text) == (False, "version 1 is on board, not version 2")
        assert not yard.rover.autopilot.armed
        assert (await yard.order(Start(version=1))).ok

    Yard().run(scene)


def test_start_waits_for_the_position_estimate() -> None:
    async def scene(yard: Yard) -> None:
        await yard.order(Load(mission=yard.mission(*ROUND)))
        assert not yard.telemetry.ready_to_arm
        assert (await yard.order(Start())).ok
        assert yard.clock.now_s() >= 1e9 + 40.0

    Yard(config=RoverConfig(ready_after_s=40.0)).run(scene)

    async def never(yard: Yard) -> None:
        await yard.order(Load(mission=yard.mission(*ROUND)))
        assert "not ready to arm" in (await yard.order(Start())).text
        assert mode_of(yard) == mavlink.ROVER_MODE_HOLD
        assert yard.telemetry.step_uid is None

    Yard(config=RoverConfig(ready_after_s=4000.0)).run(never)


def test_a_vehicle_that_will_not_arm_can_be_given_another_mission() -> None:
    async def scene(yard: Yard) -> None:
        await yard.order(Load(mission=yard.mission(*ROUND)))
        yard.rover.autopilot.arm = lambda force=False: False  # type: ignore[method-assign]
        reply = await yard.order(Start())
        assert reply.text == "COMPONENT_ARM_DISARM was refused (MAV_RESULT_FAILED)"
        assert mode_of(yard) == mavlink.ROVER_MODE_HOLD
        assert yard.telemetry.step_uid is None
        assert (await yard.order(Load(mission=yard.mission("drive b", version=2)))).ok

    Yard().run(scene)


def test_what_a_vehicle_does_counts_even_if_the_link_is_lost_while_it_is_launched() -> None:
    async def scene(yard: Yard) -> None:
        await fly(yard, *ROUND)
        await yard.until(lambda: yard.telemetry.step_uid == "collect a 1")
        yard.watch = lambda message: cut_at_auto(yard, message)
        reply = await yard.order(Load(mission=yard.mission(*ROUND, version=2), resume=True))
        assert not reply.ok
        assert mode_of(yard) == mavlink.ROVER_MODE_AUTO  # it cannot be told
        yard.cut, yard.watch = False, lambda message: None
        await yard.until(lambda: yard.telemetry.finished)
        assert [uid for _, uid, _ in yard.confirmed] == WORK_DONE

    Yard().run(scene)


def cut_at_auto(yard: Yard, message: Any) -> None:
    """Cut the link as soon as the order to enter AUTO has arrived."""
    if message.get_type() == "COMMAND_LONG" and message.command == mavlink.MAV_CMD_DO_SET_MODE:
        yard.cut = yard.cut or message.param2 == mavlink.ROVER_MODE_AUTO


def test_work_that_cannot_be_done_is_confirmed_as_such_and_can_be_done_later() -> None:
    async def scene(yard: Yard) -> None:
        await fly(yard, "drive a", "pick a 5", "drive base")
        await yard.until(lambda: bool(yard.confirmed))
        assert yard.confirmed == [(1, "pick a 5", False)]
        assert yard.bus.of(Confirmation)[0].text == "missing"
        await yard.until(lambda: yard.telemetry.mode == "HOLD")
        assert "Cannot pick 5: holding" in yard.events
        assert yard.telemetry.step_uid == "pick a 5"
        without = yard.mission("drive a", "drive base", version=2)
        assert not (await yard.order(Load(mission=without, resume=True))).ok  # it stands at a step of the old
        yard.world.act("scout", Action.COLLECT, 5, yard.world.places["a"])
        yard.world.act("scout", Action.DROP, 5, yard.world.places["a"])
        assert (await yard.order(Start())).ok
        await yard.until(lambda: yard.telemetry.finished)
        assert yard.confirmed == [(1, "pick a 5", False), (2, "pick a 5", True)]

    Yard().run(scene)


def test_hold_goes_before_all_else_and_start_goes_on() -> None:
    async def scene(yard: Yard) -> None:
        await fly(yard, *ROUND)
        await yard.until(lambda: yard.telemetry.step_uid == "drive b")
        load = yard.begin(Load(mission=yard.mission(*ROUND, version=2), resume=True))
        start = yard.begin(Start())
        await yard.until(lambda: yard.rover.autopilot.store.receiving)
        assert (await yard.order(STOP)).ok
        assert mode_of(yard) == mavlink.ROVER_MODE_HOLD
        assert not (await load).ok
        assert not (await start).ok
        assert yard.telemetry.mission_version is None
        assert not (await yard.order(Start())).ok
        assert (await yard.order(Load(mission=yard.mission(*ROUND, version=3)))).ok
        await yard.live(20.0)
        assert mode_of(yard) == mavlink.ROVER_MODE_HOLD
        assert (await yard.order(Start())).ok
        assert (await yard.order(Start())).text == "under way already"
        await yard.until(lambda: yard.telemetry.finished)
        assert [uid for _, uid, _ in yard.confirmed] == WORK_DONE

    Yard().run(scene)


def test_a_failed_load_leaves_the_vehicle_holding_and_can_be_made_good() -> None:
    async def scene(yard: Yard) -> None:
        await fly(yard, *ROUND)
        await yard.until(lambda: yard.telemetry.step_uid == "drive b")
        load = yard.begin(Load(mission=yard.mission(*ROUND, version=2), resume=True))
        await yard.until(lambda: yard.rover.autopilot.store.receiving)
        yard.cut = True
        await yard.until(load.done)
        assert not load.result().ok
        assert not yard.telemetry.link_ok
        assert yard.telemetry.mission_version is None
        assert mode_of(yard) == mavlink.ROVER_MODE_HOLD
        yard.cut = False
        await yard.live(3.0)
        assert yard.telemetry.link_ok
        assert (await yard.order(Load(mission=yard.mission(*ROUND, version=2), resume=True))).ok
        await yard.until(lambda: yard.telemetry.finished)
        assert [uid for _, uid, _ in yard.confirmed] == WORK_DONE
        links = [text for text in yard.events if text.startswith("link")]
        assert links == ["link: the vehicle is heard", "link: the vehicle is not heard any more", *links[:1]]
        assert differences(lay_out(yard.mission(*ROUND)).items, yard.rover.autopilot.store.items) == []

    Yard().run(scene)


def test_a_vehicle_that_is_not_there() -> None:
    async def scene(yard: Yard) -> None:
        reply = await yard.order(Start())
        assert reply.text == "vehicle 7 is not heard"
        assert yard.bus.of(Telemetry) == []

    yard = Yard()
    yard.cut = True
    yard.run(scene)


def test_an_armed_vehicle_that_somebody_else_started_is_not_resumed() -> None:
    async def scene(yard: Yard) -> None:
        await yard.live(5.0)
        yard.rover.autopilot.set_mode(mavlink.ROVER_MODE_HOLD)
        yard.rover.autopilot.arm()
        await yard.live(2.0)
        reply = await yard.order(Load(mission=yard.mission(*ROUND), resume=True))
        assert "not by this agent" in reply.text
        await fly(yard, *ROUND)  # nothing is said to be done: the operator begins
        assert not yard.rover.autopilot.internal_error
        await yard.until(lambda: yard.telemetry.finished)
        assert [uid for _, uid, _ in yard.confirmed] == WORK_DONE

    Yard().run(scene)


def test_what_the_agent_says_unasked() -> None:
    async def scene(yard: Yard) -> None:
        await yard.live(10.0)
        beats = [message for message in yard.heard if message.get_type() == "HEARTBEAT"]
        assert 10 <= len(beats) <= 13
        assert {(beat.get_srcSystem(), beat.get_srcComponent()) for beat in beats} == {(255, 190)}
        assert 45 <= len(yard.bus.of(Telemetry)) <= 60
        asked = {m.param1 for m in yard.heard if m.get_type() == "COMMAND_LONG" and m.command == 511}
        assert asked == {2.0, 33.0, 42.0, 147.0, 193.0}
        yard.rover.autopilot.say(mavlink.MAV_SEVERITY_WARNING, "PreArm: Compass not calibrated")
        yard.rover.autopilot.say(mavlink.MAV_SEVERITY_INFO, "Barometer 1 calibration complete")
        await yard.live(0.5)
        assert [(e.severity, e.text) for e in yard.bus.of(Event)][-1] == (
            "warning",
            "PreArm: Compass not calibrated",
        )

    Yard().run(scene)


def test_messages_of_all_kinds_with_any_contents_are_survived() -> None:
    """Valid frames with random contents, from this vehicle and from others."""

    async def scene(yard: Yard) -> None:
        noise = random.Random(11)
        for message_id in sorted(set(mavlink.mavlink_map) - {mavlink.MAVLINK_MSG_ID_BAD_DATA}):
            kind = mavlink.mavlink_map[message_id]
            for system in (7, 8):
                payload = noise.randbytes(kind.unpacker.size)
                message = kind.__new__(kind)
                mavlink.MAVLink_message.__init__(message, message_id, kind.msgname)
                data = message._pack(mavlink.MAVLink(None, system, 1), kind.crc_extra, payload)
                try:
                    decoded = mavlink.MAVLink(None).decode(bytearray(data))
                except mavlink.MAVError:
                    continue  # not for the agent to see
                yard._on_message(decoded)
        await yard.live(10.0)
        assert (await yard.order(Load(mission=yard.mission(*ROUND)))).ok

    Yard().run(scene)


def test_a_second_mission_without_a_restart_of_the_vehicle_is_heard_as_well() -> None:
    """The script counts on from the first mission; nobody repeats what another agent has acknowledged."""

    async def first(yard: Yard) -> None:
        await fly(yard, "drive a", "collect a 1", "drive base", "unload base 1")
        await yard.until(lambda: yard.telemetry.finished)

    async def second(yard: Yard) -> None:
        await fly(yard, "drive b", "collect b 2", "drive base", "unload base 2")
        await yard.until(lambda: yard.telemetry.finished)
        assert yard.confirmed == [(1, "collect b 2", True), (2, "unload base 2", True)]
        await yard.live(3.0)
        assert yard.rover.autopilot.script.due(1e12) == []

    yard = Yard()
    yard.run(first)
    yard.cut, yard.bus = False, FakeBus()
    yard.agent = Agent("yard", "scout", WHERE, yard, yard.bus, yard.clock)
    yard.run(second)


@pytest.mark.parametrize("earlier", [400, 0])
def test_what_was_left_unheard_by_an_earlier_run_is_no_confirmation_of_this_one(earlier: int) -> None:
    """The same steps, names and tags, in the morning and in the afternoon; another agent in between."""
    work = ("drive a", "collect a 1", "collect a 2", "drive base", "unload base 1", "unload base 2")

    async def load(yard: Yard, run: int) -> None:
        mission = yard.mission(*work).model_copy(update={"run": run})
        assert (await yard.order(Load(mission=mission))).ok

    async def morning(yard: Yard) -> None:
        await load(yard, earlier)
        yard.on_send = lambda message: setattr(yard, "cut", message.get_type() == "NAMED_VALUE_INT")
        assert (await yard.order(Start())).ok
        await yard.until(lambda: yard.rover.autopilot.run.state is RunState.COMPLETE)
        assert len(yard.rover.autopilot.script.due(yard.clock.now_s() + 2.0)) == 4

    async def afternoon(yard: Yard) -> None:
        await load(yard, 401)
        await yard.live(20.0)
        assert (yard.confirmed, yard.agent.progress.done) == ([], set())
        assert [text for text in yard.events if "confirmation" in text] == [
            f"a confirmation of an earlier mission: {action} of container {tag}, ok"
            for action in ("collect", "unload") for tag in (1, 2)
        ]  # fmt: skip
        assert yard.rover.autopilot.script.due(1e12) == []
        assert (await yard.order(Start())).ok
        await yard.until(lambda: yard.telemetry.finished)
        assert yard.confirmed == [(n, uid, True) for n, uid in enumerate(work[1:3] + work[4:], start=1)]
        assert len(yard.world.delivered()) == 4

    yard = Yard()
    yard.run(morning)
    yard.cut, yard.bus, yard.on_send = False, FakeBus(), lambda message: None
    yard.agent = Agent("yard", "scout", WHERE, yard, yard.bus, yard.clock)
    yard.run(afternoon)


def test_a_vehicle_that_is_not_heard_is_told_to_hold_all_the_same() -> None:
    """It may hear us: radios fail in one direction, too."""

    async def scene(yard: Yard) -> None:
        await fly(yard, *ROUND)
        yard.deaf = True
        await yard.live(10.0)
        reply = await yard.order(STOP)
        assert not reply.ok
        assert mode_of(yard) == mavlink.ROVER_MODE_HOLD

    Yard().run(scene)
