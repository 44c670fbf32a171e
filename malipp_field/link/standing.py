"""Whether a vehicle stands where its mission starts: one elsewhere would drive there across country."""

from __future__ import annotations

import math

from malipp_field.link.compare import METRES_PER_DEGREE
from malipp_field.link.driver import Driver
from malipp_field.vehicle.check_way import HOME_OFF_M
from malipp_field.vehicle.items import MissionItem

POSITION_LIMIT_S = 3.0
"""So long is waited for a position; one that has none yet cannot be armed either."""


async def displacement(driver: Driver, home: MissionItem) -> str | None:
    """Return how far from the start of its mission a vehicle stands, in words.

    None where it is near enough (`HOME_OFF_M`), or where it is not known; an ArduPilot without a position
    reports latitude 0, longitude 0.

    Parameters
    ----------
    home
        Item 0 of its mission.
    """
    vehicle = driver.vehicle
    await driver.until(lambda: bool(vehicle.lat_deg or vehicle.lon_deg), POSITION_LIMIT_S)
    if vehicle.lat_deg is None or vehicle.lon_deg is None or not (vehicle.lat_deg or vehicle.lon_deg):
        return None
    north_deg = vehicle.lat_deg - home.x / 1e7
    east_deg = math.remainder(vehicle.lon_deg - home.y / 1e7, 360.0) * math.cos(math.radians(home.x / 1e7))
    off_m = METRES_PER_DEGREE * math.hypot(north_deg, east_deg)
    if off_m <= HOME_OFF_M:
        return None
    return f"it stands {off_m:.0f} m from the start of its mission: bring it there, or correct `start`"
