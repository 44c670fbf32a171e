"""A load broken off at any message leaves a vehicle that holds, or drives a mission that is known and whole.

The messages of an undisturbed load are counted first, those that go out and those that come in; then there is
one load for some of them, every second or fewer (each takes a tenth of a second), broken off as it crosses.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

import pytest
from agent_cases import STOP
from fault_cases import GUARDED, OCCASIONS, UNDER_WAY, GuardedYard, begin, check

from malipp_field.bus.messages import Reply

OF_A_LOAD = ("MISSION_", "COMMAND_", "PARAM_")
REPORT = "MISSION_CURRENT"
"""Comes five times a second, whatever is being loaded."""
MANY, FEW = 2, 7
LEG_S = 70.0
"""Longer than the leg that the vehicle drives."""


class BrokenOff(GuardedYard):
    """A yard in which something happens as message ``at`` of the load crosses, whichever way it goes."""

    def __init__(self, occasion: str, at: int | None = None) -> None:
        super().__init__(0, 0.0, **(GUARDED if occasion == UNDER_WAY else {"FS_GCS_ENABLE": 1.0}))
        self._occasion, self._at = occasion, at
        self.crossed = 0
        self._loading = False
        self.strike: Callable[[], object] = lambda: None
        self.on_send = self.on_hear = self._cross

    def _cross(self, message: Any) -> None:
        kind = message.get_type()
        if self._loading and kind.startswith(OF_A_LOAD) and kind != REPORT:
            if self.crossed == self._at:
                self.strike()
            self.crossed += 1

    async def begin_load(self) -> asyncio.Future[Reply]:
        load = await begin(self, self._occasion)
        self._loading = True
        return load

    def end(self, duration_s: float) -> None:
        """Let the vehicle live on when nobody is there any more."""
        end_s = self.clock.now_s() + duration_s
        while self.clock.now_s() < end_s:
            self.clock.advance(0.25)
            self.rover.step(self.clock.now_s())


def messages(occasion: str, every: int) -> range:
    """Return the numbers of messages that cross in an undisturbed load."""

    async def scene(yard: BrokenOff) -> int:
        load = await yard.begin_load()
        await yard.until(load.done)
        assert load.result().ok
        assert ("not stopped" in load.result().text) is (occasion == UNDER_WAY)
        return yard.crossed

    count = BrokenOff(occasion).run(scene)
    assert count > 30
    return range(0, count, every)


@pytest.mark.parametrize("occasion", OCCASIONS)
def test_by_an_order_to_hold(occasion: str) -> None:
    async def scene(yard: BrokenOff) -> None:
        load = await yard.begin_load()
        holds: list[asyncio.Future[Reply]] = []
        yard.strike = lambda: holds.append(yard.begin(STOP))
        await yard.until(lambda: bool(holds) and holds[0].done() and load.done())
        assert holds[0].result().ok
        await yard.live(1.5)
        check(yard)
        assert not yard.driving()
        assert yard.telemetry.mode == "HOLD"

    for at in messages(occasion, MANY):
        print("broken off at message", at)
        BrokenOff(occasion, at).run(scene)


@pytest.mark.parametrize("occasion", OCCASIONS)
def test_by_whoever_gave_it(occasion: str) -> None:
    """Nobody orders a hold: a vehicle under way holds by the end of its leg, or its mission is known."""

    async def scene(yard: BrokenOff) -> None:
        load = await yard.begin_load()
        yard.strike = load.cancel
        await yard.until(load.done)
        await yard.live(LEG_S if occasion == UNDER_WAY else 2.0)
        check(yard)
        assert not yard.driving() or yard.telemetry.mission_version is not None

    for at in messages(occasion, FEW):
        print("broken off at message", at)
        BrokenOff(occasion, at).run(scene)


@pytest.mark.parametrize("occasion", OCCASIONS)
def test_by_the_end_of_the_agent(occasion: str) -> None:
    """The vehicle's own failsafe holds it, before it has reached anything that is not known to be whole."""

    async def scene(yard: BrokenOff) -> None:
        load = await yard.begin_load()
        yard.strike = yard.work.cancel
        await yard.until(lambda: yard.work.done() and load.done())
        yard.end(LEG_S)
        assert not yard.driving()

    for at in messages(occasion, FEW):
        print("broken off at message", at)
        BrokenOff(occasion, at).run(scene)
