"""Somebody else changes the mission of a vehicle while its agent is at work."""

from __future__ import annotations

from agent_cases import ROUND, Yard, fly, mode_of
from link_cases import framed
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from malipp_field.bus.messages import Confirmation, Load, Start
from malipp_field.link.mission_protocol import MissionUpload
from malipp_field.link.mission_watch import MissionWatch
from malipp_field.vehicle.layout import lay_out

OTHER = ("drive b", "drive base")
AS_MANY = (*ROUND[:-1], "unload base 7")
STRANGER = (254, 190)
AUTO, HOLD = mavlink.ROVER_MODE_AUTO, mavlink.ROVER_MODE_HOLD


async def upload(yard: Yard, *work: str) -> None:
    """Upload as another ground station, over the same radio."""
    exchange = MissionUpload(lay_out(yard.mission(*work)).items, 7, 1, *STRANGER)
    hear = yard._on_message
    answers = exchange.start(yard.clock.now_s())

    def overhear(message: object) -> None:
        answers.extend(exchange.receive(message, yard.clock.now_s()))
        hear(message)

    yard._on_message = overhear
    while not exchange.ended:
        while answers:
            yard.rover.receive(framed(answers.pop(0), *STRANGER), "stranger", yard.clock.now_s())
        await yard.live()
    yard._on_message = hear
    assert exchange.done


def put_unheard(yard: Yard, *work: str) -> None:
    """Replace what is stored as an upload over another link does."""
    yard.rover.autopilot.store.items[1:] = lay_out(yard.mission(*work)).items[1:]


def test_an_upload_that_is_overheard_ends_the_trust_in_the_mission_on_board() -> None:
    async def scene(yard: Yard) -> None:
        assert (await yard.order(Load(mission=yard.mission(*ROUND)))).ok
        await upload(yard, *AS_MANY)
        assert yard.telemetry.mission_version is None
        assert any("somebody else changes the mission" in text for text in yard.events)
        assert (await yard.order(Start())).text == "there is no verified mission on board"
        assert not yard.telemetry.armed
        await fly(yard, *ROUND)
        await yard.until(lambda: yard.telemetry.finished)

    Yard().run(scene)


def test_another_number_of_items_is_noticed_where_nothing_is_overheard() -> None:
    async def scene(yard: Yard) -> None:
        assert (await yard.order(Load(mission=yard.mission(*ROUND)))).ok
        put_unheard(yard, *OTHER)
        await yard.live(3.0)
        assert not (await yard.order(Start())).ok
        assert any("2 items are on board, not 9" in text for text in yard.events)

    Yard().run(scene)


def test_a_mission_verified_long_ago_is_read_again_before_it_is_started() -> None:
    async def scene(yard: Yard) -> None:
        assert (await yard.order(Load(mission=yard.mission(*ROUND)))).ok
        put_unheard(yard, *AS_MANY)
        await yard.live(60.0)
        reply = await yard.order(Start())
        assert not reply.ok
        assert "not the verified one any more: item 9" in reply.text
        assert yard.telemetry.mission_version is None
        assert not yard.telemetry.armed

    Yard().run(scene)


def test_a_vehicle_under_way_is_held_and_goes_on_with_a_mission_of_ours() -> None:
    async def scene(yard: Yard) -> None:
        await fly(yard, *ROUND)
        await yard.until(lambda: yard.telemetry.step_uid == "drive b")
        await upload(yard, *OTHER)
        await yard.until(lambda: mode_of(yard) == HOLD, limit_s=3.0)
        assert not (await yard.order(Start())).ok
        assert (await yard.order(Load(mission=yard.mission(*ROUND, version=2)))).ok
        assert (await yard.order(Start())).ok
        await yard.until(lambda: yard.telemetry.finished)
        uids = [c.uid for c in yard.bus.of(Confirmation)]
        assert len(uids) == len(set(uids)) == 6

    Yard().run(scene)


def test_it_is_not_started_on_when_the_trust_is_lost_in_the_middle_of_that() -> None:
    async def scene(yard: Yard) -> None:
        assert (await yard.order(Load(mission=yard.mission(*ROUND)))).ok
        start = yard.begin(Start())
        put_unheard(yard, *OTHER)
        await yard.until(start.done)
        assert not start.result().ok
        await yard.live(5.0)
        assert mode_of(yard) == HOLD

    Yard().run(scene)


def test_what_is_no_sign_of_another_mission() -> None:
    watch, mission = MissionWatch((255, 190)), Yard().mission(*ROUND)
    ours = mavlink.MAVLink_mission_request_int_message(255, 190, 3)
    fence = mavlink.MAVLink_mission_request_int_message(*STRANGER, 3, mavlink.MAV_MISSION_TYPE_FENCE)
    refusal = mavlink.MAVLink_mission_ack_message(*STRANGER, mavlink.MAV_MISSION_DENIED)
    silent = mavlink.MAVLink_mission_current_message(1)  # an old firmware: it tells no number of items
    late = mavlink.MAVLink_mission_current_message(1, total=4)
    right = mavlink.MAVLink_mission_current_message(1, total=9)
    unknown = mavlink.MAVLink_mission_current_message(1, total=65535)
    for message in (ours, fence, refusal, silent, silent, silent, silent, late, right, late, late, unknown):
        assert watch.suspicion(message, mission, 100.0) is None
    assert watch.suspicion(ours, mission, 115.0), "a ground station of our own ids"


def test_a_load_that_is_refused_meanwhile_leaves_nothing_driving_what_is_not_ours() -> None:
    async def scene(yard: Yard) -> None:
        await fly(yard, *ROUND)
        await yard.until(lambda: yard.telemetry.step_uid == "drive b")
        load = yard.begin(Load(mission=yard.mission("drive a", version=2)))  # without the leg it is on
        yard.agent._distrust("a test says so")
        await yard.until(load.done)
        assert not load.result().ok
        await yard.until(lambda: mode_of(yard) == HOLD, limit_s=3.0)

    Yard().run(scene)
