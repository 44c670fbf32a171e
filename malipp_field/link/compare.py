"""Whether the mission (fence, rally points) read back from a vehicle makes it do what it was sent.

Byte for byte a read-back always differs: item 0 is home and the vehicle's own, autocontinue comes back as 1,
frames as 0, 3 or 10, and params are cut to their storage type. What is lost to the resolution of the storage
(fractions of a second of a hold, the last digits of a half float) is no difference; a value that wrapped
around or was dropped is one.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from malipp_field.link.commands import command_name
from malipp_field.vehicle.items import (
    MAV_CMD_NAV_FENCE_POLYGON_VERTEX_EXCLUSION,
    MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION,
    MAV_CMD_NAV_RALLY_POINT,
    MAV_CMD_NAV_SCRIPT_TIME,
    MAV_CMD_NAV_WAYPOINT,
    MissionItem,
)

PLACE_TOLERANCE_M = 0.5
"""Latitude and longitude through float32 are off by up to this; a rover's waypoint radius is 2 m."""
ALTITUDE_TOLERANCE_M = 0.011
"""Altitudes are kept to the centimetre, in float32."""
METRES_PER_DEGREE = 111_320.0

_WITH_PLACE = (
    MAV_CMD_NAV_WAYPOINT,
    mavlink.MAV_CMD_NAV_LOITER_UNLIM,
    mavlink.MAV_CMD_NAV_LOITER_TIME,
    MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION,
    MAV_CMD_NAV_FENCE_POLYGON_VERTEX_EXCLUSION,
    MAV_CMD_NAV_RALLY_POINT,
)
_WHOLE_PARAMS = {
    (MAV_CMD_NAV_WAYPOINT, 1),
    (mavlink.MAV_CMD_NAV_LOITER_UNLIM, 1),
    (mavlink.MAV_CMD_NAV_LOITER_TIME, 1),
    (MAV_CMD_NAV_SCRIPT_TIME, 1),
    (MAV_CMD_NAV_SCRIPT_TIME, 2),
}
_HALF_FLOAT_PARAMS = {(MAV_CMD_NAV_SCRIPT_TIME, 3), (MAV_CMD_NAV_SCRIPT_TIME, 4)}
_NAN_MEANS_ZERO = {(MAV_CMD_NAV_WAYPOINT, 4), (mavlink.MAV_CMD_NAV_LOITER_UNLIM, 4)}

_ALTITUDE_OF_FRAME = {
    mavlink.MAV_FRAME_GLOBAL: "absolute",
    mavlink.MAV_FRAME_GLOBAL_INT: "absolute",
    mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT: "above home",
    mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT: "above home",
    mavlink.MAV_FRAME_GLOBAL_TERRAIN_ALT: "above terrain",
    mavlink.MAV_FRAME_GLOBAL_TERRAIN_ALT_INT: "above terrain",
}


def differences(
    sent: Sequence[MissionItem], read_back: Sequence[MissionItem], *, home: bool = True
) -> list[str]:
    """Return what the vehicle would not do as it was sent, in words; empty when it will do all of it.

    Parameters
    ----------
    sent, read_back
        All items.
    home
        Whether item 0 is home, as in missions: it is not compared, and a mission of home alone may come back
        empty. Fences and rally points have none.
    """
    first = int(home)
    found = [
        f"item {ours.seq} ({command_name(ours.command)}): {'; '.join(faults)}"
        for ours, theirs in zip(sent[first:], read_back[first:], strict=False)
        if (faults := list(_item_differences(ours, theirs)))
    ]
    wanted, there = (max(0, len(items) - first) for items in (sent, read_back))
    if wanted != there:
        found.append(f"{there} items{' after home' * home} on board, not {wanted}")
    return found


def _item_differences(sent: MissionItem, there: MissionItem) -> Iterator[str]:
    if sent.command != there.command:
        yield f"{command_name(there.command)} is on board instead"
        return
    sent_params = (sent.param1, sent.param2, sent.param3, sent.param4)
    there_params = (there.param1, there.param2, there.param3, there.param4)
    for number, (ours, theirs) in enumerate(zip(sent_params, there_params, strict=True), start=1):
        if not _same_param((sent.command, number), ours, theirs):
            yield f"param{number} is {theirs:g}, not {ours:g}"
    yield from (_place_differences if sent.command in _WITH_PLACE else _argument_differences)(sent, there)


def _same_param(key: tuple[int, int], sent: float, there: float) -> bool:
    if math.isnan(sent):
        return math.isnan(there) or (key in _NAN_MEANS_ZERO and there == 0.0)
    if key in _WHOLE_PARAMS and math.isfinite(sent):
        return math.trunc(sent) == there
    if key in _HALF_FLOAT_PARAMS:
        return math.isclose(sent, there, rel_tol=2.0**-10, abs_tol=2.0**-24)
    return math.isclose(sent, there, rel_tol=2.0**-22, abs_tol=1e-30)


def _place_differences(sent: MissionItem, there: MissionItem) -> Iterator[str]:
    distance_m = _distance_m(sent, there)
    if distance_m > PLACE_TOLERANCE_M:
        yield f"its place is {distance_m:.1f} m off"
    if _ALTITUDE_OF_FRAME.get(sent.frame, sent.frame) != _ALTITUDE_OF_FRAME.get(there.frame, there.frame):
        yield f"frame is {there.frame}, not {sent.frame}"
    if not abs(sent.z - there.z) <= ALTITUDE_TOLERANCE_M:
        yield f"altitude is {there.z:g} m, not {sent.z:g} m"


def _distance_m(a: MissionItem, b: MissionItem) -> float:
    north = (b.x - a.x) / 1e7
    east = ((b.y - a.y) / 1e7 + 180.0) % 360.0 - 180.0
    return METRES_PER_DEGREE * math.hypot(north, east * math.cos(math.radians(a.x / 1e7)))


def _argument_differences(sent: MissionItem, there: MissionItem) -> Iterator[str]:
    """Compare x and y as what they are where there is no place: raw numbers. NAV_SCRIPT_TIME has no z."""
    if sent.x != there.x:
        yield f"x is {there.x}, not {sent.x}"
    if sent.y != there.y:
        yield f"y is {there.y}, not {sent.y}"
    if sent.command != MAV_CMD_NAV_SCRIPT_TIME and sent.z != there.z:
        yield f"z is {there.z:g}, not {sent.z:g}"
