"""Vehicles whose payload would do nothing, and vehicles that stand elsewhere, before anything is sent."""

from __future__ import annotations

import pytest
from agent_cases import STOP, TEXT, Yard
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from transaction_cases import MISSION, Field

from malipp_field.bus.messages import Confirm, Confirmation, Event, Load, Start
from malipp_field.link.outputs import ANSWER_LIMIT_S, FREE_FUNCTIONS, needs, refused_channel
from malipp_field.mission import parse_mission
from malipp_field.mission.vehicles import ByGripper, ByRelay, ByServo, PayloadProfile
from malipp_field.vehicle.items import MissionItem, item_at, item_without_place
from malipp_field.vehicle.steps import VehicleMission

SERVO, RELAY, GRIPPER = mavlink.MAV_CMD_DO_SET_SERVO, mavlink.MAV_CMD_DO_SET_RELAY, mavlink.MAV_CMD_DO_GRIPPER
PROFILE = PayloadProfile(
    collect=ByServo(by="servo", channel=9, pwm_us=1900, rest_us=1100, duration_s=4.0),
    drop=ByRelay(by="relay", relay=2, duration_s=3.0),
    pick=ByServo(by="servo", channel=20, pwm_us=1900, duration_s=4.0),
    unload=ByGripper(by="gripper", move="release", duration_s=3.0),
)
WORK = ("drive a", "collect a 1", "drop a 1", "drive base", "unload base 1")
BASE = item_at(0, 16, 34.0219, -118.2870)


def yard_with(**parameters: float) -> Yard:
    changed = ", ".join(f"{name}: {value}" for name, value in parameters.items())
    return Yard(mission=parse_mission(f"{TEXT}simulation: {{parameters: {{{changed}}}}}\n"))


def mission(yard: Yard, *work: str, version: int = 1) -> VehicleMission:
    return yard.mission(*work, version=version).model_copy(update={"payload": PROFILE})


def work(command: int, *params: float) -> MissionItem:
    return item_without_place(0, command, *params)


def test_what_outputs_need_is_asked_once_each() -> None:
    items = [work(SERVO, 9, 1900), work(RELAY, 0, 1), work(SERVO, 9, 1100), work(GRIPPER, 1, 0), BASE]
    assert [need.parameter for need in needs(items)] == ["SERVO9_FUNCTION", "RELAY1_FUNCTION", "GRIP_ENABLE"]
    assert {0, 1, 51, 66} <= FREE_FUNCTIONS
    assert FREE_FUNCTIONS.isdisjoint({-1, 26, 50, 67, 70})
    assert refused_channel("ServoRelayEvent: Channel 12 is already in use") == 12
    assert refused_channel("Channel 12") is None


@pytest.mark.parametrize(
    ("name", "value", "right"),
    [("SERVO9_FUNCTION", 26, "0"), ("RELAY3_FUNCTION", 0, "1"), ("GRIP_ENABLE", 0, "1")],
)
def test_a_load_is_refused_while_an_output_would_do_nothing(name: str, value: int, right: str) -> None:
    async def scene(yard: Yard) -> None:
        reply = await yard.order(Load(mission=mission(yard, *WORK)))
        assert not reply.ok
        assert f"{name} is {value} and must be {right}" in reply.text
        assert len(yard.rover.autopilot.store.items) <= 1, "home at most"
        yard.rover.parameters._values[name] = float(right)
        assert (await yard.order(Load(mission=mission(yard, *WORK)))).ok

    yard_with(**{name: value}).run(scene)


def test_a_parameter_that_the_vehicle_does_not_have_is_a_warning_said_once() -> None:
    async def scene(yard: Yard) -> None:
        begun_s = yard.clock.now_s()
        assert (await yard.order(Load(mission=mission(yard, "drive a", "pick a 1", "drive base")))).ok
        assert yard.clock.now_s() < begun_s + ANSWER_LIMIT_S + 5.0
        said = [e for e in yard.bus.of(Event) if "SERVO20_FUNCTION" in e.text]
        assert [event.severity for event in said] == ["warning"]
        new = mission(yard, "drive a", "pick a 1", "drive b", version=2)
        assert (await yard.order(Load(mission=new, done=("drive x",)))).ok
        assert len([e for e in yard.bus.of(Event) if "SERVO20_FUNCTION" in e.text]) == 1

    Yard().run(scene)


def test_a_servo_refused_on_the_way_is_an_error_and_no_step_done() -> None:
    async def scene(yard: Yard) -> None:
        assert (await yard.order(Load(mission=mission(yard, *WORK)))).ok
        yard.rover.parameters._values["SERVO9_FUNCTION"] = 26.0
        assert (await yard.order(Start())).ok
        await yard.until(lambda: yard.telemetry.step_uid == "drive base")
        await yard.live(20.0)
        (error, *_) = [event for event in yard.bus.of(Event) if "Channel 9 is already in use" in event.text]
        assert error.severity == "error"
        assert "collect a 1" not in {c.uid for c in yard.bus.of(Confirmation)}
        assert not yard.telemetry.finished
        awaited = yard.telemetry.awaits
        assert awaited is not None
        assert (awaited.uid, awaited.problem) == ("collect a 1", "servo channel 9 is in use")
        assert (await yard.order(Confirm(uid="collect a 1", ok=False, text="not taken"))).ok
        await yard.until(lambda: yard.telemetry.finished)
        assert [(c.uid, c.ok, c.by) for c in yard.bus.of(Confirmation)] == [
            ("collect a 1", False, "person"), ("drop a 1", True, "progress"),
            ("unload base 1", True, "progress")
        ]  # fmt: skip

    Yard().run(scene)


def test_a_vehicle_that_stands_elsewhere_is_not_loaded_but_one_under_way_is() -> None:
    async def scene(yard: Yard) -> None:
        pilot, base = yard.rover.autopilot, yard.rover.autopilot.position
        pilot.position = (310.0, 0.0)
        await yard.live(2.0)
        reply = await yard.order(Load(mission=yard.mission("drive a")))
        assert (reply.ok, pilot.store.receiving) == (False, False)
        assert "it stands 310 m from the start of its mission" in reply.text
        pilot.position = base
        await yard.live(2.0)
        assert (await yard.order(Load(mission=yard.mission("drive a", "drive b")))).ok
        assert (await yard.order(Start())).ok
        await yard.until(lambda: yard.telemetry.step_uid == "drive b")
        assert (await yard.order(STOP)).ok
        new = Load(mission=yard.mission("drive b", "drive a", version=2), resume=True)
        assert (await yard.order(new)).ok

    Yard().run(scene)


def test_an_upload_is_refused_before_anything_is_sent_to_any_vehicle() -> None:
    async def scene(field: Field) -> None:
        field.radios["carrier"].rover.parameters._values["SERVO9_FUNCTION"] = 70.0
        transaction = field.transaction(wanted={MISSION: [BASE, work(SERVO, 9, 1900)._replace(seq=1)]})
        assert not await field.carry_out(transaction)
        assert field.aboard == ["old"] * 3
        assert [member.state for member in transaction.members] == ["had"] * 3
        faults = {member.robot: member.fault for member in transaction.members if member.fault}
        assert faults.keys() == {"carrier"}
        assert "SERVO9_FUNCTION is 70 and must be 0" in faults["carrier"]
        assert field.said == []

    Field().run(scene)


def test_an_upload_warns_of_a_vehicle_that_stands_elsewhere_or_tells_nothing() -> None:
    async def scene(field: Field) -> None:
        field.radios["scout"].rover.autopilot.position = (0.0, 60.0)
        await field.live(3.0)
        wanted = [BASE, work(SERVO, 20, 1900)._replace(seq=1)]
        transaction = field.transaction(wanted={MISSION: wanted})
        assert await field.carry_out(transaction)
        scout, carrier, _ = transaction.members
        assert [warning[:14] for warning in carrier.warnings] == ["it does not te"]
        assert scout.warnings == [
            carrier.warnings[0],
            "it stands 60 m from the start of its mission: bring it there, or correct `start`",
        ]

    Field().run(scene)
