"""How ArduPilot Rover stores mission items: what it refuses, and what is left of the rest when read back.

The tables follow `AP_Mission::mavlink_int_to_mission_cmd` and what was seen on a real Rover (4.7 development
line): params are cut to their storage type, frames come back as 0, 3 or 10, autocontinue as 1.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from malipp_field.vehicle.items import MissionItem

Cut = Callable[[float], float]


def _dropped(_: float) -> float:
    return 0.0


def _uint8(value: float) -> float:
    return float(int(value) % 2**8)


def _uint16(value: float) -> float:
    return float(int(value) % 2**16)


def _int8(value: float) -> float:
    return float((int(value) + 2**7) % 2**8 - 2**7)


def _int16(value: int) -> int:
    return (value + 2**15) % 2**16 - 2**15


def _half(value: float) -> float:
    return float(np.float16(np.clip(value, -65504.0, 65504.0)))


def _single(value: float) -> float:
    return float(np.float32(value))


_STORED: dict[int, tuple[Cut, Cut, Cut, Cut]] = {
    mavlink.MAV_CMD_NAV_WAYPOINT: (_uint16, _dropped, _dropped, _dropped),
    mavlink.MAV_CMD_NAV_LOITER_UNLIM: (_uint16, _dropped, _dropped, _dropped),
    mavlink.MAV_CMD_NAV_LOITER_TIME: (_uint16, _dropped, _dropped, _dropped),
    mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH: (_dropped, _dropped, _dropped, _dropped),
    mavlink.MAV_CMD_NAV_DELAY: (_single, _int8, _int8, _int8),
    mavlink.MAV_CMD_NAV_SCRIPT_TIME: (_uint8, _uint8, _half, _half),
    mavlink.MAV_CMD_CONDITION_DELAY: (_single, _dropped, _dropped, _dropped),
    mavlink.MAV_CMD_DO_SET_RELAY: (_uint8, _uint8, _dropped, _dropped),
    mavlink.MAV_CMD_DO_SET_SERVO: (_uint8, _uint16, _dropped, _dropped),
    mavlink.MAV_CMD_DO_GRIPPER: (_uint8, _uint8, _dropped, _dropped),
    mavlink.MAV_CMD_DO_SEND_SCRIPT_MESSAGE: (_uint16, _single, _single, _single),
    mavlink.MAV_CMD_DO_WINCH: (_uint8, _uint8, _single, _single),
}

WITH_POSITION = {
    mavlink.MAV_CMD_NAV_WAYPOINT, mavlink.MAV_CMD_NAV_LOITER_UNLIM, mavlink.MAV_CMD_NAV_LOITER_TIME,
}  # fmt: skip
"""Commands that drive to a place of their own."""

NAVIGATION = WITH_POSITION | {
    mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH, mavlink.MAV_CMD_NAV_DELAY, mavlink.MAV_CMD_NAV_SCRIPT_TIME,
}  # fmt: skip
"""Commands that last: the mission waits for each to end. All others are done at once, in passing."""

_NAN_IN_PARAM4 = {mavlink.MAV_CMD_NAV_WAYPOINT, mavlink.MAV_CMD_NAV_LOITER_UNLIM}

_FRAMES = {
    mavlink.MAV_FRAME_GLOBAL: mavlink.MAV_FRAME_GLOBAL,
    mavlink.MAV_FRAME_MISSION: mavlink.MAV_FRAME_GLOBAL,
    mavlink.MAV_FRAME_GLOBAL_INT: mavlink.MAV_FRAME_GLOBAL,
    mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT: mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT,
    mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT: mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT,
    mavlink.MAV_FRAME_GLOBAL_TERRAIN_ALT: mavlink.MAV_FRAME_GLOBAL_TERRAIN_ALT,
    mavlink.MAV_FRAME_GLOBAL_TERRAIN_ALT_INT: mavlink.MAV_FRAME_GLOBAL_TERRAIN_ALT,
}

_FENCE_AND_RALLY = {
    mavlink.MAV_MISSION_TYPE_FENCE: {
        mavlink.MAV_CMD_NAV_FENCE_RETURN_POINT,
        mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION,
        mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_EXCLUSION,
        mavlink.MAV_CMD_NAV_FENCE_CIRCLE_INCLUSION,
        mavlink.MAV_CMD_NAV_FENCE_CIRCLE_EXCLUSION,
    },
    mavlink.MAV_MISSION_TYPE_RALLY: {mavlink.MAV_CMD_NAV_RALLY_POINT},
}


_CORNERS = {
    mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION,
    mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_EXCLUSION,
}


class RefusedItemError(ValueError):
    """An item the autopilot does not store; `result` is the MAV_MISSION_RESULT it answers with."""

    def __init__(self, result: int) -> None:
        self.result = result
        super().__init__(mavlink.enums["MAV_MISSION_RESULT"][result].name)


def item_of(message: Any) -> MissionItem:
    """Return what a MISSION_ITEM_INT or a legacy MISSION_ITEM says.

    The latter has degrees in single precision: about 0.2 m of latitude are lost on the way.

    Raises
    ------
    RefusedItemError
        When x or y is no number, or no place on earth.
    """
    legacy = isinstance(message, mavlink.MAVLink_mission_item_message)
    raw = message.command in _STORED and message.command not in WITH_POSITION
    scale = 1e7 if legacy and not raw else 1.0
    for value, refusal in (
        (message.x, mavlink.MAV_MISSION_INVALID_PARAM5_X), (message.y, mavlink.MAV_MISSION_INVALID_PARAM6_Y)
    ):  # fmt: skip
        if not abs(value * scale) < 2**31:  # also refuses NaN
            raise RefusedItemError(refusal)
    fields = {name: getattr(message, name) for name in MissionItem._fields}
    return MissionItem(**(fields | {"x": round(message.x * scale), "y": round(message.y * scale)}))


def stored(item: MissionItem, mission_type: int) -> MissionItem:
    """Return an item as it will be read back.

    Raises
    ------
    RefusedItemError
        With the reason the autopilot gives.
    """
    if mission_type != mavlink.MAV_MISSION_TYPE_MISSION:
        return _stored_beside(item, mission_type)
    _refuse_impossible_params(item)
    if item.command not in _STORED:
        raise RefusedItemError(mavlink.MAV_MISSION_UNSUPPORTED)
    given = (item.param1, item.param2, item.param3, item.param4)
    cuts = _STORED[item.command]
    p1, p2, p3, p4 = (cut(0.0 if math.isnan(p) else p) for cut, p in zip(cuts, given, strict=True))
    frame, x, y, z = _stored_place(item)
    return MissionItem(item.seq, frame, item.command, 0, 1, p1, p2, p3, p4, x, y, z)


def _stored_beside(item: MissionItem, mission_type: int) -> MissionItem:
    """Return a corner of a fence or a rally point as it is kept: no more than its place, and one number."""
    if item.command not in _FENCE_AND_RALLY[mission_type]:
        raise RefusedItemError(mavlink.MAV_MISSION_UNSUPPORTED)
    rally = mission_type == mavlink.MAV_MISSION_TYPE_RALLY
    frame, x, y, z = _place_on_earth(item)
    if rally and frame != mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT:
        raise RefusedItemError(mavlink.MAV_MISSION_UNSUPPORTED_FRAME)
    if not rally:
        frame, z = mavlink.MAV_FRAME_GLOBAL, 0.0
    p1 = 0.0 if rally else _uint8(item.param1) if item.command in _CORNERS else _single(item.param1)
    return MissionItem(item.seq, frame, item.command, 0, 1, p1, 0.0, 0.0, 0.0, x, y, math.trunc(z))


def polygons_are_whole(items: Sequence[MissionItem]) -> bool:
    """Return whether every polygon of a fence has as many corners, all of a kind, as each of them says."""
    at = 0
    while at < len(items):
        first = items[at]
        if first.command not in _CORNERS:
            at += 1
            continue
        count = int(first.param1)
        polygon = items[at : at + count]
        alike = all((each.command, each.param1) == (first.command, first.param1) for each in polygon)
        if count < 3 or len(polygon) < count or not alike:
            return False
        at += count
    return True


def _refuse_impossible_params(item: MissionItem) -> None:
    """Refuse NaN (but in param 4 of 16 and 17) and infinities, as `AP_Mission::sanity_check_params` does."""
    for number, value in enumerate((item.param1, item.param2, item.param3, item.param4), start=1):
        nan_allowed = number == 4 and item.command in _NAN_IN_PARAM4
        if math.isinf(value) or (math.isnan(value) and not nan_allowed):
            raise RefusedItemError(mavlink.MAV_MISSION_INVALID_PARAM1 + number - 1)
    if not math.isfinite(item.z):
        raise RefusedItemError(mavlink.MAV_MISSION_INVALID_PARAM7)


def _stored_place(item: MissionItem) -> tuple[int, int, int, float]:
    """Return frame, x, y and z as they are kept."""
    if item.command == mavlink.MAV_CMD_NAV_SCRIPT_TIME:
        return mavlink.MAV_FRAME_GLOBAL, _int16(item.x), _int16(item.y), 0.0
    if item.command not in WITH_POSITION:
        return mavlink.MAV_FRAME_GLOBAL, 0, 0, 0.0
    return _place_on_earth(item)


def _place_on_earth(item: MissionItem) -> tuple[int, int, int, float]:
    if item.frame not in _FRAMES:
        raise RefusedItemError(mavlink.MAV_MISSION_UNSUPPORTED_FRAME)
    if abs(item.x) > 90 * 10**7:
        raise RefusedItemError(mavlink.MAV_MISSION_INVALID_PARAM5_X)
    if abs(item.y) > 180 * 10**7:
        raise RefusedItemError(mavlink.MAV_MISSION_INVALID_PARAM6_Y)
    if not abs(item.z) < 2**15:
        raise RefusedItemError(mavlink.MAV_MISSION_INVALID_PARAM7)
    return _FRAMES[item.frame], item.x, item.y, round(item.z * 100) / 100
