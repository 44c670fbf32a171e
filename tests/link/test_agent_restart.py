"""An agent that is started again while its vehicle is under way."""

from __future__ import annotations

import random

import pytest
from agent_cases import ROUND, STOP, TEXT, WORK_DONE, Yard, fly, mode_of
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from malipp_field.bus.messages import Confirm, Confirmation, Load, Release, Reply, Start, Telemetry
from malipp_field.mission import parse_mission
from malipp_field.vehicle.layout import lay_out
from malipp_field.vehicle.steps import Action, VehicleMission

SERVO = (
    "{collect: {by: servo, channel: 9, pwm_us: 1900, rest_us: 1100, duration_s: 4.0}, drop: {by: manual}, "
    "pick: {by: manual}, unload: {by: relay, relay: 2, duration_s: 2.0}}"
)
TASKS = ("drive a", "collect a 1", "collect a 2", "drive b", "collect b 3", "drive base", "unload base 1",
         "unload base 2", "unload base 3")  # fmt: skip
AUTO, HOLD, MANUAL = mavlink.ROVER_MODE_AUTO, mavlink.ROVER_MODE_HOLD, mavlink.ROVER_MODE_MANUAL
OF_A_LOAD = {"MISSION_COUNT", "MISSION_ITEM_INT", "MISSION_CLEAR_ALL"}


def yard_with(payload: str, seed: int = 0, loss: float = 0.0) -> Yard:
    return Yard(seed, loss, mission=parse_mission(f"{TEXT}vehicles:\n  scout: {{payload: {payload}}}\n"))


def tasks(yard: Yard, *work: str, version: int = 1) -> VehicleMission:
    payload = yard.world.mission.vehicle("scout").payload
    return yard.mission(*(work or TASKS), version=version).model_copy(update={"payload": payload})


def known(yard: Yard, mission: VehicleMission) -> tuple[str, ...]:
    """Return what a coordinator knows to be done, from all that was said on the bus."""
    confirmed = {c.uid for c in yard.bus.of(Confirmation) if c.ok or c.goes_on}
    at = [mission.index_of(t.step_uid) or 0 for t in yard.bus.of(Telemetry) if t.step_uid is not None]
    passed = mission.steps[: at[-1]] if at else ()
    return (*confirmed, *(s.uid for s in passed if s.action in (Action.DRIVE, Action.WAIT)))


async def begin(yard: Yard, mission: VehicleMission) -> None:
    for order in (Load(mission=mission), Start()):
        while not (await yard.order(order)).ok:
            await yard.live(1.0)


async def put_back(yard: Yard, mission: VehicleMission) -> Reply:
    return await yard.order(Load(mission=mission, done=known(yard, mission), begun=True))


def been(yard: Yard) -> list[str]:
    return [c.uid for c in yard.bus.of(Confirmation)]


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("payload", ["script", SERVO, "manual"])
def test_the_vehicle_is_followed_on_without_a_stop_and_everything_is_done_once(
    payload: str, seed: int
) -> None:
    chance = random.Random(seed)
    modes: set[int] = set()
    hands: dict[str, bool] = {}

    async def attend(yard: Yard) -> None:
        awaited = yard.telemetry.awaits
        if awaited is None:
            return
        if awaited.uid not in hands:
            hands[awaited.uid] = yard.rover.autopilot.attended(awaited.action, awaited.tag).result == "ok"
        if chance.random() < 0.7:
            await yard.order(Confirm(uid=awaited.uid, ok=hands[awaited.uid]))

    async def scene(yard: Yard) -> None:
        mission = tasks(yard)
        await begin(yard, mission)
        yard.watch = lambda message: modes.add(mode_of(yard))
        heard, restarts = len(yard.heard), 0
        while not yard.telemetry.finished:
            for _ in range(chance.randint(1, 8)):
                await yard.live(chance.uniform(0.0, 2.0))
                await attend(yard)
            if restarts < 6 and not yard.telemetry.finished:
                restarts += 1
                await yard.restart_agent(chance.uniform(0.0, 8.0))
                assert yard.telemetry.mission_version is None
                reply = await put_back(yard, mission)
                assert reply.text == "version 1 was on board; the vehicle was not stopped"
                assert (await yard.order(Start(version=1))).ok
            assert yard.clock.now_s() < 1e9 + 900.0
        await yard.live(15.0)
        assert restarts > 2
        assert sorted(been(yard)) == sorted(WORK_DONE)
        assert all(c.ok for c in yard.bus.of(Confirmation))
        assert len(yard.world.containers) == len(yard.world.delivered()) == 3
        assert not OF_A_LOAD & {message.get_type() for message in yard.heard[heard:]}
        assert yard.rover.autopilot.script.due(1e12) == []

    yard_with(payload, seed).run(scene)
    assert modes == {AUTO}


@pytest.mark.parametrize("seed", range(2))
def test_over_a_bad_link_nothing_is_done_twice_either(seed: int) -> None:
    async def scene(yard: Yard) -> None:
        chance, mission = random.Random(seed), tasks(yard)
        await begin(yard, mission)
        while not yard.telemetry.finished:
            await yard.live(chance.uniform(5.0, 20.0))
            if yard.telemetry.finished:
                break
            await yard.restart_agent(chance.uniform(0.0, 8.0))
            while not (await put_back(yard, mission)).ok:
                pass
            assert yard.clock.now_s() < 1e9 + 2000.0
        await yard.live(40.0)
        assert sorted(been(yard)) == sorted(WORK_DONE)
        assert len(yard.world.containers) == len(yard.world.delivered()) == 3

    yard_with("script" if seed % 2 else SERVO, seed, loss=0.2).run(scene)


@pytest.mark.parametrize("payload", ["script", SERVO])
def test_a_vehicle_that_has_come_to_the_end_meanwhile(payload: str) -> None:
    async def scene(yard: Yard) -> None:
        mission = tasks(yard)
        await begin(yard, mission)
        await yard.until(lambda: yard.telemetry.step_uid == "drive b")
        await yard.restart_agent(120.0)
        assert yard.agent.vehicle.mission_complete
        assert (await put_back(yard, mission)).ok
        await yard.until(lambda: yard.telemetry.finished, limit_s=20.0)
        assert been(yard) == WORK_DONE
        assert set(yard.world.delivered()) == set(yard.world.containers)

    yard_with(payload).run(scene)


def test_a_vehicle_that_was_held_meanwhile_goes_on_where_it_is_and_sets_no_servo_again() -> None:
    """As its own failsafe holds it: what it did before that nobody has heard of."""

    async def scene(yard: Yard) -> None:
        mission = tasks(yard)
        await begin(yard, mission)
        await yard.until(lambda: yard.telemetry.step_uid == "drive a")
        pilot = yard.rover.autopilot
        await yard.kill_agent()
        await yard.until(lambda: pilot.run.seq > lay_out(mission).first_item(2))
        pilot.set_mode(HOLD)
        await yard.start_agent()
        assert "collect a 1" not in been(yard)
        reply = await put_back(yard, mission)
        assert reply.text.endswith("was not stopped")
        await yard.live(5.0)
        assert mode_of(yard) == HOLD
        disarmed = []
        yard.watch = lambda message: disarmed.append(not pilot.armed)
        assert (await yard.order(Start())).ok
        await yard.until(lambda: yard.telemetry.finished)
        assert been(yard) == WORK_DONE
        assert len(yard.world.containers) == 3
        assert not any(disarmed)

    yard_with(SERVO).run(scene)


@pytest.mark.parametrize("payload", ["script", SERVO])
def test_where_another_mission_is_on_board_the_vehicle_is_held_and_begins_at_what_is_not_done(
    payload: str,
) -> None:
    async def scene(yard: Yard) -> None:
        mission = tasks(yard)
        await begin(yard, mission)
        await yard.until(lambda: yard.telemetry.step_uid == "drive b")
        await yard.restart_agent(1.0)
        yard.rover.autopilot.store.items[1:] = lay_out(tasks(yard, "drive b", "drive base")).items[1:]
        assert (await put_back(yard, mission)).text == "version 1 is on board and verified"
        assert mode_of(yard) == HOLD
        assert (await yard.order(Start(version=1))).ok
        await yard.until(lambda: yard.telemetry.finished)
        assert been(yard) == WORK_DONE
        assert len(yard.world.containers) == len(yard.world.delivered()) == 3

    yard_with(payload).run(scene)


def test_what_the_script_did_while_nobody_listened_is_heard_before_another_mission_is_begun() -> None:
    async def scene(yard: Yard) -> None:
        mission = tasks(yard, "drive a", "collect a 1", "drive b", "collect b 2", "drive base")
        await begin(yard, mission)
        await yard.live(2.0)
        await yard.restart_agent(0.0)
        await yard.until(lambda: yard.rover.autopilot.run.seq == 3)
        await yard.live(4.0)
        yard.rover.autopilot.store.items[1:] = lay_out(tasks(yard, "drive base")).items[1:]
        order = Load(mission=mission, done=("drive a",), begun=True)
        assert (await yard.order(order)).ok
        assert been(yard) == ["collect a 1"]
        assert (await yard.order(Start())).ok
        await yard.until(lambda: yard.telemetry.step_uid is not None)
        assert yard.telemetry.step_uid == "drive b"
        await yard.until(lambda: yard.telemetry.finished)
        assert been(yard) == ["collect a 1", "collect b 2"]

    yard_with("script").run(scene)


def test_a_gate_opens_after_a_restart() -> None:
    async def scene(yard: Yard) -> None:
        mission = tasks(yard, "drive a", "wait a", "drive base")
        await begin(yard, mission)
        await yard.until(lambda: yard.telemetry.step_uid == "wait a")
        await yard.restart_agent(3.0)
        assert not (await yard.order(Release(uid="wait a"))).ok
        assert (await put_back(yard, mission)).ok
        assert yard.telemetry.step_uid == "wait a"
        assert (await yard.order(Release(uid="wait a"))).ok
        await yard.until(lambda: yard.telemetry.finished)

    yard_with("script").run(scene)


def test_a_vehicle_that_holds_at_a_step_it_failed_at_tries_again_when_it_is_let_go() -> None:
    async def scene(yard: Yard) -> None:
        mission = tasks(yard, "drive a", "pick a 5", "drive base")
        await begin(yard, mission)
        await yard.until(lambda: yard.telemetry.awaits is not None)
        await yard.restart_agent(2.0)
        assert (await put_back(yard, mission)).ok
        assert yard.telemetry.awaits is None
        assert mode_of(yard) == HOLD
        assert (await yard.order(Start())).ok
        await yard.until(lambda: yard.telemetry.awaits is not None)
        assert (await yard.order(Confirm(tag=5))).ok
        await yard.until(lambda: yard.telemetry.finished)
        assert [(c.ok, c.by) for c in yard.bus.of(Confirmation)] == [
            (False, "script"), (False, "script"), (True, "person"),
        ]  # fmt: skip

    yard_with("script").run(scene)


def test_confirmations_that_are_known_already_are_acknowledged_and_not_published_again() -> None:
    async def scene(yard: Yard) -> None:
        mission = tasks(yard, "drive a", "collect a 1", "drive b", "drive base")
        await begin(yard, mission)
        yard.on_send = lambda message: setattr(yard, "cut", message.get_type() == "NAMED_VALUE_INT")
        await yard.until(lambda: been(yard) == ["collect a 1"])
        yard.on_send = lambda message: None
        await yard.restart_agent(1.0)
        assert yard.rover.autopilot.script.due(1e12), "it was not acknowledged"
        assert (await put_back(yard, mission)).ok
        await yard.until(lambda: yard.telemetry.finished)
        await yard.live(15.0)
        assert been(yard) == ["collect a 1"]
        assert yard.rover.autopilot.script.due(1e12) == []

    yard_with("script").run(scene)


def test_after_a_load_of_its_own_the_item_reported_is_not_believed() -> None:
    """A vehicle that stands with a new mission still reports an item of the one before."""

    async def scene(yard: Yard) -> None:
        mission = tasks(yard)
        await begin(yard, mission)
        await yard.until(lambda: yard.telemetry.step_uid == "drive b")
        await yard.restart_agent(1.0)
        pilot = yard.rover.autopilot
        pilot.store.items[1:] = lay_out(tasks(yard, "drive b", "drive base", "drive a")).items[1:]
        pilot.set_current(3, reset=False)
        done = ("drive a", "collect a 1", "collect a 2")
        for _ in range(2):  # the second time it is on board
            reply = await yard.order(Load(mission=mission, done=done, begun=True))
            assert reply.text == "version 1 is on board and verified"
            assert yard.telemetry.step_uid is None
        assert (await yard.order(Start())).ok
        assert yard.telemetry.step_uid == "drive b"

    yard_with(SERVO).run(scene)


def test_a_vehicle_on_another_mission_than_ordered_is_left_alone_where_that_was_not_begun() -> None:
    """A replan that meets a new agent: what the vehicle has done since is not known."""

    async def scene(yard: Yard) -> None:
        mission = tasks(yard)
        await begin(yard, mission)
        await yard.until(lambda: yard.telemetry.step_uid == "drive b")
        await yard.restart_agent(1.0)
        new = tasks(yard, *TASKS[3:], version=2)
        reply = await yard.order(Load(mission=new, done=known(yard, mission)))
        assert (reply.ok, "not by this agent" in reply.text) == (False, True)
        assert mode_of(yard) == AUTO
        assert (await put_back(yard, mission)).text.endswith("not stopped")
        await yard.until(lambda: yard.telemetry.finished)
        assert been(yard) == WORK_DONE

    yard_with(SERVO).run(scene)


@pytest.mark.parametrize("strange", [False, True])
def test_a_team_that_is_started_anew_begins_from_the_beginning(strange: bool) -> None:
    """Nothing is said to be done, so it is put back and begins, whatever the vehicle was on."""

    async def scene(yard: Yard) -> None:
        await fly(yard, *ROUND)
        await yard.until(lambda: yard.telemetry.step_uid == "drive b")
        await yard.restart_agent(1.0)
        if strange:
            yard.rover.autopilot.store.items[1:] = lay_out(yard.mission("drive b", "drive base")).items[1:]
        assert "from the start of its mission" in (await yard.order(Load(mission=yard.mission(*ROUND)))).text
        assert mode_of(yard) == HOLD
        yard.rover.autopilot.position = yard.world.places["base"]
        await yard.live(1.0)
        assert (await yard.order(Load(mission=yard.mission(*ROUND)))).text.endswith("verified")
        assert mode_of(yard) == HOLD
        assert (await yard.order(Start())).ok
        assert yard.telemetry.step_uid == "drive a"

    Yard().run(scene)


def test_a_vehicle_that_a_person_drives_is_neither_loaded_nor_started() -> None:
    async def scene(yard: Yard) -> None:
        await fly(yard, *ROUND)
        await yard.until(lambda: yard.telemetry.step_uid == "drive b")
        yard.rover.autopilot.set_mode(MANUAL)
        await yard.until(lambda: yard.telemetry.mode == "MANUAL")
        for order in (Load(mission=yard.mission(*ROUND, version=2)), Start()):
            reply = await yard.order(order)
            assert reply.text == "the vehicle is armed and in MANUAL: a person has it; HOLD gives it back"
        assert mode_of(yard) == MANUAL
        assert (await yard.order(STOP)).ok
        assert (await yard.order(Start())).ok
        await yard.until(lambda: yard.telemetry.finished)

    Yard().run(scene)
