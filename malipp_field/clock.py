"""Time as every process of the toolkit reads it: real, or simulated and faster.

All waiting goes through a `Clock`. Simulated time advances in small steps, so a process that stalls slows
the simulated world down instead of making everybody else's timeouts expire.
"""

from __future__ import annotations

import asyncio
import contextlib
import heapq
import itertools
import time
from collections.abc import Iterator
from typing import Protocol


class Clock(Protocol):
    """What time it is, and how to wait."""

    def now_s(self) -> float:
        """Return the time in seconds since the Unix epoch (UTC)."""
        ...

    async def sleep(self, duration_s: float) -> None:
        """Wait for ``duration_s`` seconds of this clock."""
        ...

    def real_time(self) -> contextlib.AbstractContextManager[None]:
        """Hold simulated time to the pace of wall time while the context lasts.

        What costs the team real seconds in the field (thinking about a plan, agreeing on it) must cost them
        as many simulated seconds, however fast the simulation runs. A real clock does nothing here.
        """
        ...


class WallClock:
    """The time of this machine."""

    def now_s(self) -> float:
        """Return the time in seconds since the Unix epoch (UTC)."""
        return time.time()

    async def sleep(self, duration_s: float) -> None:
        """Wait for ``duration_s`` seconds."""
        await asyncio.sleep(max(0.0, duration_s))

    def real_time(self) -> contextlib.AbstractContextManager[None]:
        """Return a context that changes nothing: this clock always is real."""
        return contextlib.nullcontext()


class SimClock:
    """Simulated time that moves only when `advance` is called, by a test or by `run`.

    Parameters
    ----------
    start_s
        First reading, in seconds since the Unix epoch.
    speed
        Simulated seconds for each wall second while `run` drives the clock.
    step_s
        Largest step of simulated time; everything that sleeps less than this wakes late by at most it.
    """

    def __init__(self, start_s: float, speed: float = 1.0, step_s: float = 0.05) -> None:
        if speed <= 0 or step_s <= 0:
            raise ValueError(f"speed and step_s must be positive, found {speed} and {step_s}")
        self._now_s = start_s
        self.speed = speed
        self.step_s = step_s
        self._real_time_depth = 0
        self._order = itertools.count()
        self._sleepers: list[tuple[float, int, asyncio.Future[None]]] = []

    def now_s(self) -> float:
        """Return the simulated time in seconds since the Unix epoch."""
        return self._now_s

    async def sleep(self, duration_s: float) -> None:
        """Wait until simulated time has advanced by ``duration_s`` seconds."""
        future: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        heapq.heappush(self._sleepers, (self._now_s + max(0.0, duration_s), next(self._order), future))
        await future

    @contextlib.contextmanager
    def real_time(self) -> Iterator[None]:
        """Hold `run` to one simulated second for each wall second while the context lasts."""
        self._real_time_depth += 1
        try:
            yield
        finally:
            self._real_time_depth -= 1

    def advance(self, duration_s: float) -> None:
        """Move time forward and wake whoever's time has come, in the order of their times."""
        self._now_s += duration_s
        while self._sleepers and self._sleepers[0][0] <= self._now_s + 1e-9:
            _, _, future = heapq.heappop(self._sleepers)
            if not future.done():
                future.set_result(None)

    async def run(self) -> None:
        """Drive the clock at `speed` until cancelled; never catches up after a stall."""
        while True:
            speed = 1.0 if self._real_time_depth else self.speed
            # Below ~5 ms the event loop's own resolution would set the pace: take larger steps instead.
            step_s = max(self.step_s, 0.005 * speed) if speed > 1.0 else min(self.step_s, 0.02)
            await asyncio.sleep(step_s / speed)
            self.advance(step_s)
