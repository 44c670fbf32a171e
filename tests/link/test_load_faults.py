"""What goes wrong while one vehicle is given a mission: nothing unverified is driven, and what is said is so.

The watch is kept by `GuardedYard`: whatever item the rover begins, its store then holds one of the two
missions, whole.
"""

from __future__ import annotations

import asyncio
from typing import Any

import pytest
from agent_cases import STOP
from fault_cases import (
    GUARDED,
    HELD,
    INITIAL,
    NEW,
    OCCASIONS,
    UNDER_WAY,
    GuardedYard,
    begin,
    check,
    make_good,
    settle,
    yard_for,
)
from link_cases import framed
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from malipp_field.bus.messages import Load
from malipp_field.sim.mission_store import Sender

STRANGER = (245, 190)


def messages_needed(occasion: str) -> int:
    """How many messages the ground needs on a good link."""
    return {INITIAL: 17, HELD: 29, UNDER_WAY: 27}[occasion]


@pytest.mark.parametrize("occasion", OCCASIONS)
def test_the_number_of_messages_is_as_the_cuts_suppose(occasion: str) -> None:
    async def scene(yard: GuardedYard) -> None:
        load = await begin(yard, occasion)
        await yard.until(load.done)
        assert load.result().ok
        assert yard.uplinks == messages_needed(occasion)
        assert ("not stopped" in load.result().text) is (occasion == UNDER_WAY)

    yard_for(occasion).run(scene)


@pytest.mark.parametrize(
    ("occasion", "cut_at"), [(each, n) for each in OCCASIONS for n in range(messages_needed(each) - 1)]
)
def test_a_link_cut_at_any_message(occasion: str, cut_at: int) -> None:
    """The last message is left out: a load is complete without the acknowledgement of its read-back."""

    async def scene(yard: GuardedYard) -> None:
        load = await begin(yard, occasion)
        yard.cut_at = cut_at
        await settle(yard, load)
        check(yard)
        assert not load.result().ok
        assert not yard.driving()
        yard.cut, yard.cut_at = False, None
        await yard.live(5.0)
        check(yard)
        assert not yard.driving()
        if cut_at % 6 == 5:
            await make_good(yard)

    yard_for(occasion).run(scene)


@pytest.mark.parametrize("occasion", OCCASIONS)
@pytest.mark.parametrize("loss", [0.1, 0.25, 0.4])
def test_loss_duplicates_delays_and_the_wrong_order(occasion: str, loss: float) -> None:
    async def scene(yard: GuardedYard) -> None:
        load = await begin(yard, occasion)
        await settle(yard, load)
        check(yard)
        await make_good(yard)

    GuardedYard(seed=int(100 * loss) + 7, loss=loss, **GUARDED).run(scene)


@pytest.mark.parametrize("occasion", OCCASIONS)
@pytest.mark.parametrize("at", [3, 6, 10, 16])
def test_a_restart_of_the_vehicle_in_the_middle(occasion: str, at: int) -> None:
    async def scene(yard: GuardedYard) -> None:
        load = await begin(yard, occasion)
        await yard.until(lambda: yard.uplinks >= at)
        yard.rover.reboot(yard.clock.now_s())
        yard.watch_items()
        assert not yard.driving()
        await settle(yard, load)
        check(yard)
        if not load.result().ok:
            assert not yard.driving()

    yard_for(occasion).run(scene)


@pytest.mark.parametrize("occasion", OCCASIONS)
def test_a_second_uploader(occasion: str) -> None:
    """Another station has begun an upload, and goes silent: its turn ends after 8 s, then it is ours."""

    async def scene(yard: GuardedYard) -> None:
        load = await begin(yard, occasion)
        began_s = yard.clock.now_s()
        count = framed(mavlink.MAVLink_mission_count_message(7, 1, 6), *STRANGER)
        yard.rover.receive(count, "stranger", began_s)
        await settle(yard, load)
        assert load.result().ok, load.result().text
        assert yard.clock.now_s() - began_s > 8.0
        check(yard)
        assert yard.aboard() == NEW

    yard_for(occasion).run(scene)


@pytest.mark.parametrize("occasion", OCCASIONS)
def test_a_full_store_keeps_what_it_has_but_it_is_not_relied_upon(occasion: str) -> None:
    async def scene(yard: GuardedYard) -> None:
        if occasion != INITIAL:
            await settle(yard, await begin(yard, INITIAL))  # only the items count below
        yard.rover.autopilot.store.max_items = 5
        load = yard.begin(Load(mission=yard.new(4), resume=True))
        await settle(yard, load)
        assert "MAV_MISSION_NO_SPACE" in load.result().text
        check(yard)
        assert not yard.driving()
        assert yard.telemetry.mission_version is None

    yard_for(occasion).run(scene)


@pytest.mark.parametrize("occasion", OCCASIONS)
@pytest.mark.parametrize("seq", [1, 3, 6])
def test_a_refused_item(occasion: str, seq: int) -> None:
    async def scene(yard: GuardedYard) -> None:
        store = yard.rover.autopilot.store
        honest = store.receive

        def receive(message: Any, sender: Sender, at_s: float) -> list[Any]:
            if message.get_type() == "MISSION_ITEM_INT" and message.seq == seq:
                message.param1 = float("nan")
            return honest(message, sender, at_s)

        load = await begin(yard, occasion)
        store.receive = receive  # type: ignore[method-assign, assignment]
        await settle(yard, load)
        assert f"item {seq} (NAV_" in load.result().text
        assert "MAV_MISSION_INVALID_PARAM1" in load.result().text
        check(yard)
        assert not yard.driving()
        store.receive = honest  # type: ignore[method-assign]
        await make_good(yard)

    yard_for(occasion).run(scene)


@pytest.mark.parametrize("occasion", OCCASIONS)
@pytest.mark.parametrize("after_s", [0.0, 0.05, 0.15, 0.3, 0.6, 0.9, 1.1, 1.4])
def test_an_order_broken_off_at_any_time_leaves_the_vehicle_holding(occasion: str, after_s: float) -> None:
    """A hold cancels the order at whatever it waits for."""

    async def scene(yard: GuardedYard) -> None:
        load = await begin(yard, occasion)
        await yard.live(after_s)
        assert (await yard.order(STOP)).ok
        await settle(yard, load)
        check(yard)
        assert not yard.driving()
        assert yard.telemetry.mode == "HOLD"
        if after_s in (0.3, 0.9):
            await make_good(yard)

    yard_for(occasion).run(scene)


@pytest.mark.parametrize("occasion", [HELD, UNDER_WAY])
@pytest.mark.parametrize("after_s", [0.1, 0.5, 0.9])
def test_an_agent_that_ends_in_the_middle(occasion: str, after_s: float) -> None:
    """Nobody is there any more to order a hold: the vehicle stands already, or holds of itself in time."""
    yard = yard_for(occasion)

    async def scene(yard: GuardedYard) -> None:
        await begin(yard, occasion)
        await yard.live(after_s)

    yard.run(scene)

    async def afterwards() -> None:
        await yard.live(60.0)

    asyncio.run(afterwards())
    assert not yard.driving()
