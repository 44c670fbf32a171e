"""Items of the MAVLink mission protocol, and the few commands this project sends to a rover."""

from __future__ import annotations

from typing import NamedTuple

MAV_FRAME_GLOBAL = 0
MAV_FRAME_MISSION = 2
MAV_FRAME_GLOBAL_RELATIVE_ALT = 3

MAV_CMD_NAV_WAYPOINT = 16
MAV_CMD_NAV_LOITER_UNLIM = 17
MAV_CMD_NAV_DELAY = 93
MAV_CMD_DO_SET_RELAY = 181
MAV_CMD_DO_SET_SERVO = 183
MAV_CMD_DO_GRIPPER = 211
MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION = 5001
MAV_CMD_NAV_FENCE_POLYGON_VERTEX_EXCLUSION = 5002
MAV_CMD_NAV_RALLY_POINT = 5100
MAV_CMD_NAV_SCRIPT_TIME = 42702

WITH_PLACE = frozenset({MAV_CMD_NAV_WAYPOINT, MAV_CMD_NAV_LOITER_UNLIM})
"""Commands of ours whose x and y are degrees; the others travel in the frame without a place."""

IN_PASSING = frozenset({MAV_CMD_DO_SET_RELAY, MAV_CMD_DO_SET_SERVO, MAV_CMD_DO_GRIPPER})
"""Commands of ours that a vehicle does on its way to the next item: it never reports to be at one."""


class MissionItem(NamedTuple):
    """One item of the MAVLink mission protocol, in the fields of MISSION_ITEM_INT.

    ``x`` and ``y`` are degrees times 1e7 for items with a position, raw int16 for NAV_SCRIPT_TIME.
    """

    seq: int
    frame: int
    command: int
    current: int
    autocontinue: int
    param1: float
    param2: float
    param3: float
    param4: float
    x: int
    y: int
    z: float


def degrees_e7(degrees: float) -> int:
    """Return degrees as MAVLink's int32 of 1e-7 degree."""
    return round(degrees * 1e7)


def item_at(seq: int, command: int, lat_deg: float, lon_deg: float, *, param1: float = 0.0) -> MissionItem:
    """Return an item with a place, at the height of home."""
    return MissionItem(
        seq, MAV_FRAME_GLOBAL_RELATIVE_ALT, command, 0, 1, param1, 0.0, 0.0, 0.0,
        degrees_e7(lat_deg), degrees_e7(lon_deg), 0.0,
    )  # fmt: skip


def item_without_place(seq: int, command: int, *params: float, x: int = 0, y: int = 0) -> MissionItem:
    """Return an item without a place; up to four params, the rest is 0."""
    p1, p2, p3, p4 = (*params, *(0.0,) * (4 - len(params)))
    return MissionItem(seq, MAV_FRAME_MISSION, command, 0, 1, p1, p2, p3, p4, x, y, 0.0)
