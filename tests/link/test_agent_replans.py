from __future__ import annotations

import random
from typing import Any

import pytest
from agent_cases import ROUND, SET_CURRENT, WORK_DONE, Yard, fly, mode_of
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from malipp_field.bus.messages import Load, Release, Start

NEW_PLAN = ("drive a", "collect a 1", "drive base", "unload base 1")


def test_resume_goes_on_at_the_first_step_not_done() -> None:
    async def scene(yard: Yard) -> None:
        await fly(yard, *ROUND)
        await yard.until(lambda: yard.telemetry.step_uid == "collect a 1")
        reply = await yard.order(Load(mission=yard.mission(*NEW_PLAN, version=2), resume=True))
        assert reply.ok, reply.text
        assert mode_of(yard) == mavlink.ROVER_MODE_AUTO
        assert not yard.rover.autopilot.internal_error
        await yard.until(lambda: yard.telemetry.finished)
        assert yard.telemetry.mission_version == 2
        assert [uid for _, uid, _ in yard.confirmed] == ["collect a 1", "unload base 1"]
        assert yard.world.delivered() == {1: "base"}

    Yard().run(scene)


@pytest.mark.parametrize("seed", range(4))
def test_replans_at_any_moment_on_a_bad_link_lose_and_double_nothing(seed: int) -> None:
    """The same mission again and again, under way: nothing is done twice, nothing is left out."""

    async def scene(yard: Yard) -> None:
        chance = random.Random(seed)
        while not (await yard.order(Load(mission=yard.mission(*ROUND)))).ok:
            pass
        while not (await yard.order(Start())).ok:
            pass
        for version in range(2, 6):
            await yard.live(chance.uniform(0.0, 12.0))
            await yard.order(Load(mission=yard.mission(*ROUND, version=version), resume=True))
        while not yard.telemetry.finished:
            if yard.telemetry.mission_version is None:
                await yard.order(Load(mission=yard.mission(*ROUND, version=9), resume=True))
            elif yard.telemetry.mode == "HOLD":
                await yard.order(Start())
            await yard.live(5.0)
            assert yard.clock.now_s() < 1e9 + 2000.0
        assert [uid for _, uid, ok in yard.confirmed if ok] == WORK_DONE
        assert all(ok for _, _, ok in yard.confirmed)
        assert set(yard.world.delivered()) == {1, 2, 3}

    Yard(seed, loss=0.2).run(scene)


def test_a_mission_the_vehicle_has_left_is_refused_before_anything_is_sent() -> None:
    async def scene(yard: Yard) -> None:
        await fly(yard, *ROUND)
        await yard.until(lambda: yard.telemetry.step_uid == "drive b")
        heard = len(yard.heard)
        reply = await yard.order(Load(mission=yard.mission(*NEW_PLAN, version=2), resume=True))
        assert not reply.ok
        assert "drive b already" in reply.text
        commands = {"COMMAND_LONG", "MISSION_COUNT", "MISSION_CLEAR_ALL"}
        assert not commands & {message.get_type() for message in yard.heard[heard:]}
        assert (yard.telemetry.mission_version, mode_of(yard)) == (1, mavlink.ROVER_MODE_AUTO)

    Yard().run(scene)


def test_a_vehicle_that_leaves_the_common_part_while_it_is_held_goes_on_with_the_old_mission() -> None:
    async def scene(yard: Yard) -> None:
        await fly(yard, *ROUND)
        await yard.until(lambda: yard.telemetry.step_uid == "collect a 2")
        autopilot = yard.rover.autopilot
        honest = autopilot.set_mode

        def late(mode: int) -> bool:
            """Enter HOLD only after the next step has begun."""
            if mode == mavlink.ROVER_MODE_HOLD:
                autopilot.run.item_ended()
                autopilot.set_mode = honest  # type: ignore[method-assign]
            return honest(mode)

        autopilot.set_mode = late  # type: ignore[method-assign]
        new = yard.mission("drive a", "collect a 1", "collect a 2", "drive base", version=2)
        reply = await yard.order(Load(mission=new, resume=True))
        assert not reply.ok
        assert yard.telemetry.mission_version == 1
        assert mode_of(yard) == mavlink.ROVER_MODE_AUTO

    Yard().run(scene)


def test_a_step_passed_without_confirmation_stops_a_replan() -> None:
    async def scene(yard: Yard) -> None:
        await fly(yard, *ROUND)
        await yard.until(lambda: yard.telemetry.step_uid == "collect a 1")
        yard.rover.autopilot.run.item_ended()  # "reached" as if it had been done
        await yard.until(lambda: yard.telemetry.step_uid == "collect a 2")
        reply = await yard.order(Load(mission=yard.mission(*ROUND, version=2), resume=True))
        assert reply.text == "the vehicle went past collect a 1 without a confirmation"
        assert not yard.telemetry.finished

    Yard().run(scene)


GATED = ("drive a", "wait a 9", "collect a 1", "drive base", "unload base 1")


@pytest.mark.parametrize("loss", [0.0, 0.3])
def test_a_gate_opens_once_and_only_for_a_vehicle_that_stands_there(loss: float) -> None:
    async def scene(yard: Yard) -> None:
        while not (await yard.order(Load(mission=yard.mission(*GATED)))).ok:
            pass
        while not (await yard.order(Start())).ok:
            pass
        reply = await yard.order(Release(uid="wait a 9"))
        assert not reply.ok
        assert "not at wait a 9" in reply.text
        assert "no verified mission on board has a step" in (await yard.order(Release(uid="wait b 9"))).text
        assert "is not a gate" in (await yard.order(Release(uid="collect a 1"))).text
        await yard.until(lambda: yard.telemetry.step_uid == "wait a 9")
        await yard.live(60.0)
        assert yard.telemetry.step_uid == "wait a 9"
        jumps: list[float] = []
        yard.watch = lambda message: (
            jumps.append(message.param1) if message.get_type() == "COMMAND_LONG" else None
        )
        assert (await yard.order(Release(uid="wait a 9"))).ok
        assert set(jumps) == {3.0}
        again = await yard.order(Release(uid="wait a 9"))
        assert (again.ok, again.text) == (True, "passed already")
        await yard.until(lambda: yard.telemetry.finished)
        assert [uid for _, uid, _ in yard.confirmed] == ["collect a 1", "unload base 1"]

    Yard(seed=3, loss=loss).run(scene)


def test_a_release_is_not_repeated_before_it_is_known_where_the_vehicle_is() -> None:
    """A vehicle that has gone on must not be set back to the step after the gate."""

    async def scene(yard: Yard) -> None:
        await fly(yard, *GATED)
        await yard.until(lambda: yard.telemetry.step_uid == "wait a 9")
        jumps: list[float] = []

        def deafen(message: Any) -> None:
            if message.get_type() == "COMMAND_LONG" and message.command == SET_CURRENT:
                jumps.append(message.param1)
                yard.deaf = True

        yard.watch = deafen
        release = yard.begin(Release(uid="wait a 9"))
        await yard.live(7.0)
        yard.deaf = False
        await yard.until(release.done)
        assert release.result().ok
        assert jumps == [3.0]
        await yard.until(lambda: yard.telemetry.finished)

    Yard().run(scene)


def test_what_the_script_says_twice_under_two_numbers_is_published_once() -> None:
    async def scene(yard: Yard) -> None:
        await fly(yard, *GATED)
        await yard.until(lambda: yard.telemetry.step_uid == "wait a 9")
        assert (await yard.order(Release(uid="wait a 9"))).ok
        await yard.until(lambda: yard.telemetry.step_uid == "drive base")
        yard.rover.autopilot.set_current(3, reset=False)  # somebody has it do its work again
        await yard.until(lambda: yard.telemetry.finished)
        await yard.live(1.0)  # for the last acknowledgement to arrive
        assert yard.confirmed == [(1, "collect a 1", True), (2, "unload base 1", True)]
        assert max(m.value for m in yard.heard if m.get_type() == "NAMED_VALUE_INT") == 3

    Yard().run(scene)


def test_a_replan_at_the_gate() -> None:
    async def scene(yard: Yard) -> None:
        await fly(yard, *GATED)
        await yard.until(lambda: yard.telemetry.step_uid == "wait a 9")
        new = yard.mission("drive a", "drive b", "collect b 2", version=2)
        assert not (await yard.order(Load(mission=new, resume=True, diverges_at="collect a 1"))).ok
        assert (await yard.order(Load(mission=new, resume=True, diverges_at="wait a 9"))).ok
        await yard.until(lambda: yard.telemetry.finished)
        assert [uid for _, uid, _ in yard.confirmed] == ["collect b 2"]

    Yard().run(scene)


def test_a_finished_vehicle_goes_on_with_a_longer_mission() -> None:
    async def scene(yard: Yard) -> None:
        await fly(yard, "drive a", "collect a 1")
        await yard.until(lambda: yard.telemetry.finished)
        await yard.live(5.0)
        longer = yard.mission("drive a", "collect a 1", "drive base", "unload base 1", version=2)
        assert (await yard.order(Load(mission=longer, resume=True))).ok
        await yard.until(lambda: yard.telemetry.finished)
        assert yard.world.delivered() == {1: "base"}

    Yard().run(scene)
