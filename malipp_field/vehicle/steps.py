"""What one vehicle is to do, step by step, and each step as the MAVLink item that makes it do so.

Steps and mission items correspond one to one: item 0 is home, item ``i + 1`` is step ``i``. A step keeps its
`uid` when a replan leaves it in force, so progress made under the old mission counts under the new one.
"""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated, NamedTuple

from pydantic import Field

from malipp_field.documents import StrictModel

MAV_FRAME_GLOBAL = 0
MAV_FRAME_MISSION = 2
MAV_FRAME_GLOBAL_RELATIVE_ALT = 3
MAV_CMD_NAV_WAYPOINT = 16
MAV_CMD_NAV_SCRIPT_TIME = 42702

MAX_TAG = 32767
"""Container tags travel in an int16 of NAV_SCRIPT_TIME."""


class Action(StrEnum):
    """What a step does."""

    DRIVE = "drive"
    WAIT = "wait"  # hold until a teammate's drop is confirmed
    COLLECT = "collect"
    DROP = "drop"
    PICK = "pick"
    UNLOAD = "unload"


ACTION_CODES = {Action.WAIT: 1, Action.COLLECT: 2, Action.DROP: 3, Action.PICK: 4, Action.UNLOAD: 5}
"""``command`` (param 1) of NAV_SCRIPT_TIME, as the payload script on the vehicle knows it."""


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


class GeoPoint(StrictModel):
    """Degrees (WGS 84) and metres above the site's origin."""

    lat_deg: float
    lon_deg: float
    alt_m: float = 0.0


class Step(StrictModel):
    """One thing to do: drive to a node, handle one container there, or wait for a drop."""

    uid: str
    action: Action
    node: str
    stop: Annotated[int, Field(ge=0)]
    """Index of the stop in the robot's route; a drive belongs to the stop it leads to."""
    place: GeoPoint
    tags: tuple[Annotated[int, Field(ge=1, le=MAX_TAG)], ...] = Field(default=(), strict=False)
    """The container handled; for `WAIT` all containers that must be there first."""
    peer: str | None = None
    """The other robot of a drop or pick."""


class Sample(StrictModel):
    """Provenance of one container: which robot's sensor takes it, and where."""

    tag: Annotated[int, Field(ge=1, le=MAX_TAG)]
    node: str
    sampler: str


class VehicleMission(StrictModel):
    """Everything one vehicle is to do under one version of the plan."""

    robot: str
    version: int
    home: GeoPoint
    steps: tuple[Step, ...] = Field(strict=False)

    def items(self) -> list[MissionItem]:
        """Return the MAVLink mission, home first."""
        return [_home_item(self.home), *(_item(step, i + 1) for i, step in enumerate(self.steps))]

    def index_of(self, uid: str) -> int | None:
        """Return the index of a step, or `None` when this mission does not contain it."""
        return next((i for i, step in enumerate(self.steps) if step.uid == uid), None)


def degrees_e7(degrees: float) -> int:
    """Return degrees as MAVLink's int32 of 1e-7 degree."""
    return round(degrees * 1e7)


def _home_item(home: GeoPoint) -> MissionItem:
    return MissionItem(
        0, MAV_FRAME_GLOBAL, MAV_CMD_NAV_WAYPOINT, 0, 1, 0.0, 0.0, 0.0, 0.0,
        degrees_e7(home.lat_deg), degrees_e7(home.lon_deg), home.alt_m,
    )  # fmt: skip


def _item(step: Step, seq: int) -> MissionItem:
    if step.action is Action.DRIVE:
        return MissionItem(
            seq, MAV_FRAME_GLOBAL_RELATIVE_ALT, MAV_CMD_NAV_WAYPOINT, 0, 1, 0.0, 0.0, 0.0, 0.0,
            degrees_e7(step.place.lat_deg), degrees_e7(step.place.lon_deg), 0.0,
        )  # fmt: skip
    # Timeout 0: ArduPilot then waits for the script's word for ever. A vehicle that stands still is found
    # again; one that drives on without its sample is not noticed ("reached" is no proof).
    return MissionItem(
        seq, MAV_FRAME_MISSION, MAV_CMD_NAV_SCRIPT_TIME, 0, 1,
        float(ACTION_CODES[step.action]), 0.0, float(step.stop), float(len(step.tags)),
        step.tags[0] if step.tags else 0, 0, 0.0,
    )  # fmt: skip
