"""Simulated time: moves only when told, wakes sleepers in order, falls back to real pace."""

from __future__ import annotations

import asyncio
import time

import pytest

from malipp_field.clock import SimClock


def test_time_stands_still_until_it_is_advanced_and_sleepers_wake_in_order() -> None:
    async def main() -> list[tuple[str, float]]:
        clock = SimClock(start_s=100.0)
        woken: list[tuple[str, float]] = []

        async def sleeper(name: str, duration_s: float) -> None:
            await clock.sleep(duration_s)
            woken.append((name, clock.now_s()))

        tasks = [
            asyncio.ensure_future(sleeper(name, duration_s))
            for name, duration_s in (("late", 2.0), ("soon", 1.0), ("at once", 0.0))
        ]
        for _ in range(5):
            await asyncio.sleep(0)
        assert not woken
        for _ in range(3):
            clock.advance(1.0)
            await asyncio.sleep(0)
        await asyncio.gather(*tasks)
        return woken

    assert asyncio.run(main()) == [("at once", 101.0), ("soon", 101.0), ("late", 102.0)]


def test_a_cancelled_sleeper_is_left_alone() -> None:
    async def main() -> None:
        clock = SimClock(start_s=0.0)
        task = asyncio.ensure_future(clock.sleep(1.0))
        await asyncio.sleep(0)
        task.cancel()
        clock.advance(2.0)
        with pytest.raises(asyncio.CancelledError):
            await task

    asyncio.run(main())


def simulated_s(wall_s: float, *, real: bool, stall_s: float = 0.0) -> float:
    """Return how far a clock of speed 100 gets in some wall time."""

    async def main() -> float:
        clock = SimClock(start_s=0.0, speed=100.0)
        driver = asyncio.ensure_future(clock.run())
        begun = time.monotonic()
        if stall_s:
            await asyncio.sleep(0)
            while time.monotonic() < begun + stall_s:  # a process that does not yield
                pass
            before = clock.now_s()
            await asyncio.sleep(0)
            driver.cancel()
            return clock.now_s() - before
        if real:
            with clock.real_time():
                await asyncio.sleep(wall_s)
        else:
            await asyncio.sleep(wall_s)
        driver.cancel()
        return clock.now_s()

    return asyncio.run(main())


def test_real_time_holds_an_accelerated_clock_to_wall_pace() -> None:
    assert simulated_s(0.2, real=False) > 5.0
    assert 0.0 < simulated_s(0.2, real=True) <= 0.5


def test_a_stall_is_not_caught_up() -> None:
    assert simulated_s(0.0, real=False, stall_s=0.1) <= 1.0


@pytest.mark.parametrize(("speed", "step_s"), [(0.0, 0.1), (1.0, 0.0), (-1.0, 0.1)])
def test_impossible_settings_are_refused(speed: float, step_s: float) -> None:
    with pytest.raises(ValueError, match="must be positive"):
        SimClock(0.0, speed, step_s)
