"""Whether a vehicle has the same time of day as this computer: its gates by time rest on that."""

from __future__ import annotations

from malipp_field.errors import LinkError
from malipp_field.link.driver import EFFECT_LIMIT_S, Driver

CLOCK_LIMIT_S = 10.0
"""A vehicle that is to keep gates by time may be so far from our time of day, the link's delay included."""


async def compare_clocks(driver: Driver) -> None:
    """See that the vehicle knows the time of day as we do: without it an ArduPilot waits at no gate.

    Raises
    ------
    LinkError
        When it does not know the time, or its clock and ours are more than `CLOCK_LIMIT_S` apart.
    """
    vehicle = driver.vehicle
    if not await driver.until(lambda: vehicle.clock_ahead_s is not None, EFFECT_LIMIT_S):
        raise LinkError("the vehicle does not know the time of day, and its mission has gates by time")
    ahead_s = vehicle.clock_ahead_s or 0.0
    if abs(ahead_s) > CLOCK_LIMIT_S:
        side = "ahead of" if ahead_s > 0.0 else "behind"
        raise LinkError(
            f"its clock is {abs(ahead_s):.0f} s {side} this computer's: gates by time would open at "
            "another; set this computer's clock (UTC)"
        )
