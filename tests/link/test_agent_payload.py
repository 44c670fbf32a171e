"""What confirms an action of hardware that cannot speak, and what a person can say about one."""

from __future__ import annotations

import pytest
from agent_cases import Yard, mode_of
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from malipp_field.bus.messages import Confirm, Confirmation, Hold, Load, Start
from malipp_field.link.progress import Progress
from malipp_field.mission.vehicles import ByGripper, ByHand, ByRelay, ByServo, PayloadProfile
from malipp_field.vehicle.items import MissionItem
from malipp_field.vehicle.layout import lay_out
from malipp_field.vehicle.steps import VehicleMission

SERVO = ByServo(by="servo", channel=9, pwm_us=1900, rest_us=1100, duration_s=4.0)
WATCHED = ByRelay(by="relay", relay=1, duration_s=3.0, confirm="operator")
MIXED = PayloadProfile(collect=SERVO, drop=ByHand(by="manual"), pick=WATCHED,
                       unload=ByGripper(by="gripper", move="release", duration_s=3.0))  # fmt: skip


def with_hardware(yard: Yard, *work: str, version: int = 1) -> VehicleMission:
    return yard.mission(*work, version=version).model_copy(update={"payload": MIXED})


async def begin(yard: Yard, *work: str) -> None:
    assert (await yard.order(Load(mission=with_hardware(yard, *work)))).ok
    for _ in range(3):  # of a link that loses a third each way, arming may not get through at first
        reply = await yard.order(Start())
        if reply.ok:
            return
        assert "does not answer" in reply.text
    raise AssertionError(reply.text)


def heard(yard: Yard) -> list[tuple[str, bool, str, bool]]:
    return [(c.uid, c.ok, c.by, c.goes_on) for c in yard.bus.of(Confirmation)]


def test_hardware_without_a_voice_is_confirmed_once_when_the_vehicle_has_gone_past_it() -> None:
    async def scene(yard: Yard) -> None:
        await begin(
            yard, "drive a", "collect a 1", "collect a 2", "drive base", "unload base 1", "unload base 2"
        )
        await yard.until(lambda: yard.telemetry.step_uid == "collect a 1")
        assert heard(yard) == []
        await yard.until(lambda: yard.telemetry.finished)
        assert heard(yard) == [
            (uid, True, "progress", False)
            for uid in ("collect a 1", "collect a 2", "unload base 1", "unload base 2")
        ]

    for loss in (0.0, 0.3):
        Yard(loss=loss).run(scene)


def test_a_single_late_report_confirms_nothing() -> None:
    progress, mission = Progress(), with_hardware(Yard(), "drive a", "collect a 1", "drive b")
    progress.adopt(mission)
    progress.follow(1)
    last = lay_out(mission).last_item(2)
    assert progress.report(last, complete=False) == []
    assert progress.report(1, complete=False) == []
    assert progress.report(last, complete=False) == []
    assert [step.uid for step in progress.report(last, complete=False)] == ["collect a 1"]
    progress.settle(mission.steps[1])
    assert progress.report(last, complete=False) == []


def test_a_mission_that_begins_with_hardware_moves_it_once() -> None:
    moved: list[float] = []

    async def scene(yard: Yard) -> None:
        outputs = yard.rover.autopilot.outputs
        drive = outputs.drive

        def counted(item: MissionItem, place: tuple[float, float]) -> str | None:
            moved.append(item.param2)
            return drive(item, place)

        outputs.drive = counted  # type: ignore[method-assign]
        await begin(yard, "collect base 1", "drive a")
        await yard.until(lambda: yard.telemetry.finished)
        assert heard(yard) == [("collect base 1", True, "progress", False)]

    Yard().run(scene)
    assert moved == [1900.0, 1100.0]


def test_a_replan_in_the_middle_of_a_step_does_not_set_the_servo_again() -> None:
    async def scene(yard: Yard) -> None:
        await begin(yard, "drive a", "collect a 1", "drive b")
        await yard.until(lambda: 9 in yard.rover.autopilot.outputs.servos_us)
        yard.rover.autopilot.outputs.servos_us.clear()
        new = with_hardware(yard, "collect a 1", "drive base", version=2)
        assert (await yard.order(Load(mission=new, resume=True))).ok
        await yard.until(lambda: yard.telemetry.step_uid == "drive base")
        assert yard.rover.autopilot.outputs.servos_us == {9: 1100}
        await yard.until(lambda: yard.telemetry.finished)
        assert heard(yard) == [("collect a 1", True, "progress", False)]

    Yard().run(scene)


def test_the_vehicle_stands_until_a_person_confirms_and_then_goes_on() -> None:
    async def scene(yard: Yard) -> None:
        await begin(yard, "drive a", "drop a 5", "drive b", "drop b 6")
        await yard.until(lambda: yard.telemetry.awaits is not None)
        await yard.live(60.0)
        awaited = yard.telemetry.awaits
        assert awaited is not None
        assert (awaited.uid, awaited.tag, awaited.node, awaited.problem) == ("drop a 5", 5, "a", "")
        assert yard.clock.now_s() - awaited.since_s > 55.0
        assert not (await yard.order(Confirm(uid="drop b 6"))).ok
        assert not (await yard.order(Confirm(tag=6))).ok
        assert not (await yard.order(Confirm())).ok
        assert heard(yard) == []
        assert (await yard.order(Confirm(tag=5, value=1.5))).ok
        assert yard.telemetry.step_uid == "drive b"
        assert yard.telemetry.awaits is None
        refusal = await yard.order(Confirm(uid="drop a 5"))
        assert (refusal.ok, refusal.text) == (False, "nothing waits for a person's word")
        await yard.until(lambda: yard.telemetry.awaits is not None)
        assert (await yard.order(Confirm(uid="drop b 6", ok=False, text="no bag left"))).ok
        assert yard.telemetry.finished, "the last one is not waited for any longer either"
        assert yard.telemetry.awaits is None
        assert heard(yard) == [("drop a 5", True, "person", False), ("drop b 6", False, "person", True)]
        first, second = yard.bus.of(Confirmation)
        assert (first.value, second.text, second.number) == (1.5, "no bag left", 2)

    Yard().run(scene)


def test_hardware_that_a_person_watches_moves_first_and_waits_then() -> None:
    async def scene(yard: Yard) -> None:
        await begin(yard, "drive a", "pick a 5", "drive base")
        await yard.until(lambda: 1 in yard.rover.autopilot.outputs.relays)
        assert yard.telemetry.awaits is None
        await yard.until(lambda: yard.telemetry.awaits is not None)
        assert yard.rover.autopilot.outputs.relays == {1: False}
        assert (await yard.order(Confirm(uid="pick a 5"))).ok
        await yard.until(lambda: yard.telemetry.finished)
        assert heard(yard) == [("pick a 5", True, "person", False)]

    Yard().run(scene)


@pytest.mark.parametrize("seed", range(3))
def test_a_word_is_published_once_on_a_bad_link_and_can_be_given_again(seed: int) -> None:
    async def scene(yard: Yard) -> None:
        await begin(yard, "drive a", "drop a 5", "drive b")
        await yard.until(lambda: yard.telemetry.awaits is not None)
        yard.cut = True
        assert not (await yard.order(Confirm(uid="drop a 5"))).ok, "the vehicle is not heard"
        yard.cut = False
        while not yard.telemetry.finished:  # a late report can hide for a moment that it waits
            if yard.telemetry.awaits is not None:
                await yard.order(Confirm(uid="drop a 5"))
            await yard.live(1.0)
        assert heard(yard) == [("drop a 5", True, "person", False)]

    Yard(seed, loss=0.3).run(scene)


def test_a_vehicle_taken_past_a_hold_still_waits_for_the_word() -> None:
    async def scene(yard: Yard) -> None:
        await begin(yard, "drive a", "drop a 5", "drive b", "drive base")
        await yard.until(lambda: yard.telemetry.awaits is not None)
        yard.rover.autopilot.set_current(3, reset=False)  # by another ground station
        await yard.until(lambda: yard.telemetry.step_uid == "drive b")
        assert yard.telemetry.awaits is not None
        assert (await yard.order(Confirm(tag=5))).ok
        assert heard(yard) == [("drop a 5", True, "person", False)]
        await yard.until(lambda: yard.telemetry.finished)

    Yard().run(scene)


def test_a_replan_leaves_a_vehicle_at_its_hold() -> None:
    async def scene(yard: Yard) -> None:
        await begin(yard, "drive a", "drop a 5", "drive b")
        await yard.until(lambda: yard.telemetry.awaits is not None)
        new = with_hardware(yard, "drop a 5", "drive base", version=2)
        assert (await yard.order(Load(mission=new, resume=True))).ok
        await yard.live(5.0)
        assert yard.telemetry.awaits is not None
        assert (await yard.order(Confirm(tag=5))).ok
        await yard.until(lambda: yard.telemetry.finished)
        assert (await yard.order(Load(mission=with_hardware(yard, "drive a", version=3), resume=True))).ok

    Yard().run(scene)


def test_after_its_last_hold_a_vehicle_takes_a_new_mission() -> None:
    async def scene(yard: Yard) -> None:
        await begin(yard, "drive a", "drop a 5")
        await yard.until(lambda: yard.telemetry.awaits is not None)
        assert (await yard.order(Confirm(tag=5))).ok
        assert yard.telemetry.finished
        new = with_hardware(yard, "drive b", version=2)
        assert (await yard.order(Load(mission=new, resume=True))).ok
        await yard.until(lambda: yard.telemetry.finished and yard.telemetry.mission_version == 2)

    Yard().run(scene)


def test_a_missing_container_is_gone_on_without_where_the_mission_says_so() -> None:
    async def scene(yard: Yard) -> None:
        mission = yard.mission("drive a", "pick a 5", "drive base", "unload base 5")
        steps = [step.model_copy(update={"if_missing": "go_on"}) for step in mission.steps]
        assert (await yard.order(Load(mission=mission.model_copy(update={"steps": tuple(steps)})))).ok
        assert (await yard.order(Start())).ok
        await yard.until(lambda: yard.telemetry.finished)
        assert heard(yard) == [("pick a 5", False, "script", True), ("unload base 5", False, "script", True)]
        assert mode_of(yard) == mavlink.ROVER_MODE_AUTO

    Yard(loss=0.2).run(scene)


@pytest.mark.parametrize("ok", [True, False])
def test_a_person_can_settle_what_a_vehicle_failed_at(ok: bool) -> None:
    async def scene(yard: Yard) -> None:
        assert (await yard.order(Load(mission=yard.mission("drive a", "pick a 5", "drive base")))).ok
        assert (await yard.order(Start())).ok
        await yard.until(lambda: mode_of(yard) == mavlink.ROVER_MODE_HOLD)
        await yard.live(3.0)
        awaited = yard.telemetry.awaits
        assert awaited is not None
        assert str(awaited) == "pick container 5 at a (missing)"
        assert (await yard.order(Confirm(uid="pick a 5", ok=ok, text="" if ok else "not there"))).ok
        await yard.until(lambda: yard.telemetry.finished)
        assert heard(yard) == [("pick a 5", False, "script", False), ("pick a 5", ok, "person", not ok)]

    Yard().run(scene)


def test_a_hold_breaks_off_no_word_that_is_out() -> None:
    async def scene(yard: Yard) -> None:
        await begin(yard, "drive a", "drop a 5", "drive b")
        await yard.until(lambda: yard.telemetry.awaits is not None)
        word = yard.begin(Confirm(tag=5))
        await yard.live(0.05)
        hold = yard.begin(Hold(reason="a dog"))
        await yard.until(lambda: word.done() and hold.done())
        assert hold.result().ok
        assert mode_of(yard) == mavlink.ROVER_MODE_HOLD
        assert (await yard.order(Start())).ok
        await yard.until(lambda: yard.telemetry.awaits is not None or yard.telemetry.finished)
        if yard.telemetry.awaits is not None:
            assert (await yard.order(Confirm(tag=5))).ok
        await yard.until(lambda: yard.telemetry.finished)
        assert heard(yard) == [("drop a 5", True, "person", False)]

    Yard().run(scene)
