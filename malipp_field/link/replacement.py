"""Replacing the mission of a vehicle under way without stopping it, where that is provably safe.

An upload is not atomic, and a Rover that drives does not wait for its end: each time it sees the stored
items from the current one on changed, it begins the item stored at the current number anew
(`AP_Mission_ChangeDetector`). So a vehicle may go on along a leg while its mission is replaced if two
things hold. At the current number the same leg is stored all the time: it has that number in both missions
(whoever calls sees to it), an item is overwritten by itself alone, and the count, which cuts the mission
off as it arrives, is never below it. Begun anew, the leg is the same from where the vehicle is. And the
vehicle is certain to stand still before the end of that leg whenever the replacement is not complete and
verified by then:

- At a deadline, and at any failure before it, the vehicle is ordered to hold, and our heartbeats stop until
  it is seen to do so.
- The vehicle's own ground station failsafe holds it when it hears no heartbeats. That works only as its
  parameters say, which are read from it each time (`safe_until_s`).

The deadline is set so that the failsafe acts before the vehicle can have reached the end of the leg. Where
any of it cannot be shown, the vehicle is held before anything is sent.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Sequence
from typing import NamedTuple

from malipp_field.errors import LinkError
from malipp_field.link.compare import METRES_PER_DEGREE
from malipp_field.link.driver import TICK_S, Driver
from malipp_field.link.vehicle import Vehicle
from malipp_field.vehicle.items import MissionItem
from malipp_field.vehicle.steps import GeoPoint

LATENCY_S = 3.0
"""Longest time that a message may be under way, each way."""
STOPPING_S = 3.0
"""For ArduPilot to look at its failsafe, and to come to a stop."""
SPEED_MARGIN = 1.25
"""How much faster than its cruising speed a vehicle may drive."""
POSITION_AGE_LIMIT_S = 2.0
HEARD_FOR_S = 10.0
"""The failsafe counts heartbeats only once it has seen one: so many seconds of ours must have gone out."""
UPLOAD_BASE_S = 3.0
TRANSFERS = 2
"""Each item goes up once and comes back once."""

_ENABLED, _HOLD = 1, 2  # of FS_GCS_ENABLE (2 drives on in AUTO), of FS_ACTION
_THROTTLE_FAILSAFE_OFF = 0

GCS_ENABLE = ("FS_GCS_ENABLE",)
REST = (
    ("FS_ACTION",), ("FS_GCS_TIMEOUT",), ("FS_TIMEOUT",), ("MAV_GCS_SYSID", "SYSID_MYGCS"),
    ("FS_THR_ENABLE",), ("WP_SPEED",), ("WP_RADIUS",),
)  # fmt: skip


class NotProvableError(LinkError):
    """It cannot be shown that the mission may be replaced without stopping."""


class Guard(NamedTuple):
    """What a vehicle's own failsafe promises.

    Attributes
    ----------
    holds_within_s
        After the last heartbeat that it has heard.
    speed_m_s
        It does not drive faster.
    radius_m
        It has reached a waypoint when it is so near.
    """

    holds_within_s: float
    speed_m_s: float
    radius_m: float


async def safe_until_s(driver: Driver, target: GeoPoint, items: int) -> float:
    """Return until when a replacement must be complete, for a vehicle that drives to ``target``.

    Parameters
    ----------
    driver
        The vehicle, armed and in AUTO.
    target
        The end of the leg.
    items
        How many items the new mission has.

    Raises
    ------
    NotProvableError
        With the reason why the vehicle must be held.
    LinkError
        When it does not tell its parameters.
    """
    begun_s = driver.clock.now_s()
    (enabled,) = await driver.parameters(GCS_ENABLE)
    round_trip_s = max(TICK_S, driver.clock.now_s() - begun_s)
    if enabled != _ENABLED:
        raise NotProvableError(f"FS_GCS_ENABLE is {enabled:g}: it does not hold when the link is lost")
    guard = _guard(*await driver.parameters(*REST), own_system=driver.own[0])
    now_s, vehicle = driver.clock.now_s(), driver.vehicle
    if not driver.heartbeats.are_all_it_hears(now_s):
        raise NotProvableError("it hears heartbeats of our system id that are not this agent's")
    if vehicle.heard_since_s is None or now_s < vehicle.heard_since_s + HEARD_FOR_S:
        raise NotProvableError("it may not have heard our heartbeats yet")
    # A heartbeat sent at the deadline arrives up to a latency later, and only then does the failsafe count.
    deadline_s = (
        now_s + driving_s(vehicle, target, guard, now_s) - LATENCY_S - guard.holds_within_s - STOPPING_S
    )
    needed_s = UPLOAD_BASE_S + TRANSFERS * items * round_trip_s
    if deadline_s - now_s < needed_s:
        left_s = max(0.0, deadline_s - now_s)
        raise NotProvableError(f"{left_s:.0f} s are left before it must be held, {needed_s:.0f} s are needed")
    return deadline_s


def _guard(
    action: float, gcs_timeout_s: float, timeout_s: float, counted: float, throttle: float,
    speed_m_s: float, radius_m: float, *, own_system: int,
) -> Guard:  # fmt: skip
    """Return what the failsafe promises, by its parameters in the order of `REST`."""
    if action != _HOLD:
        raise NotProvableError(f"FS_ACTION is {action:g}, not {_HOLD} (Hold)")
    if counted != own_system:
        raise NotProvableError(f"it counts heartbeats of system {counted:g}, ours are of {own_system}")
    if throttle != _THROTTLE_FAILSAFE_OFF:
        # While one failsafe is in force ArduPilot Rover does not act on another.
        raise NotProvableError(f"FS_THR_ENABLE is {throttle:g}: a lost RC link may mask a lost station")
    if not (math.isfinite(gcs_timeout_s + timeout_s + radius_m) and speed_m_s > 0.0):
        raise NotProvableError(f"WP_SPEED is {speed_m_s:g}: how fast it drives is not known")
    return Guard(gcs_timeout_s + timeout_s, speed_m_s, radius_m)


def driving_s(vehicle: Vehicle, target: GeoPoint, guard: Guard, now_s: float) -> float:
    """Return for how long at least a vehicle will still drive before it is at ``target``.

    Its position may be as old as its report and a latency; it may drive faster than it does now.
    """
    if vehicle.lat_deg is None or vehicle.lon_deg is None or vehicle.position_s is None:
        raise NotProvableError("its position is not known")
    age_s = now_s - vehicle.position_s
    if age_s > POSITION_AGE_LIMIT_S:
        raise NotProvableError(f"its position is {age_s:.0f} s old")
    north_deg = target.lat_deg - vehicle.lat_deg
    east_deg = math.remainder(target.lon_deg - vehicle.lon_deg, 360.0) * math.cos(
        math.radians(target.lat_deg)
    )
    distance_m = METRES_PER_DEGREE * math.hypot(north_deg, east_deg) - guard.radius_m
    return distance_m / (SPEED_MARGIN * max(guard.speed_m_s, vehicle.speed_m_s)) - age_s - LATENCY_S


async def replace_under_way(
    driver: Driver, items: Sequence[MissionItem], item: int, deadline_s: float
) -> None:
    """Put a mission on a vehicle that drives, read it back, and make ``item`` current, all by the deadline.

    ``item`` is the leg it drives, and its number in the mission on board as well. Should this fail or be
    cancelled, our heartbeats have stopped, and whoever called must hold the vehicle at once.

    Raises
    ------
    LinkError
        When it was not done.
    """
    beats, vehicle = driver.heartbeats, driver.vehicle
    legs = {vehicle.current_seq, item}
    beats.only_until(deadline_s)
    work = asyncio.create_task(_put_and_point(driver, items, item))
    try:
        while not work.done():
            if driver.clock.now_s() >= deadline_s:
                raise LinkError("the new mission was not on board in time")
            if not vehicle.armed or vehicle.mode != "AUTO" or vehicle.current_seq not in legs:
                raise LinkError("the vehicle left its leg while its mission was replaced")
            await driver.clock.sleep(TICK_S)
        work.result()
    except BaseException:
        beats.stop()
        raise
    finally:
        work.cancel()
        await asyncio.gather(work, return_exceptions=True)
    beats.go_on()


async def _put_and_point(driver: Driver, items: Sequence[MissionItem], item: int) -> None:
    await driver.put(items)
    await driver.point_at(item)
    await driver.hear_mode("AUTO")
