"""What one vehicle is to do, step by step.

`malipp_field.vehicle.layout` makes one or more mission items of each, after the vehicle's payload hardware. A
step keeps its `uid` when a replan leaves it in force, so progress made under the old mission counts under the
new one.
"""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated, Literal, TypeAlias

from pydantic import Field

from malipp_field.documents import StrictModel
from malipp_field.mission.vehicles import PayloadProfile

MAX_TAG = 32767
"""Container tags travel in an int16 of NAV_SCRIPT_TIME."""
MAX_RUN = 2**14 - 1
"""The number of a run shares an int16 of NAV_SCRIPT_TIME with one bit."""


class Action(StrEnum):
    """What a step does."""

    DRIVE = "drive"
    WAIT = "wait"  # hold until a teammate's drop is confirmed, or due
    COLLECT = "collect"
    DROP = "drop"
    PICK = "pick"
    UNLOAD = "unload"


Witness: TypeAlias = Literal["script", "progress", "person"]
"""Who says that a payload action is done: the script, a person, or that the vehicle has gone past it."""


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
    not_before_s: float | None = None
    """Of a `WAIT`: when the vehicle may pass by itself, in seconds since the Unix epoch; null: never."""
    if_missing: Literal["hold", "go_on"] = "hold"
    """What to do where the container is not there, or not on board since it was not there to be picked."""


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
    payload: PayloadProfile = PayloadProfile()
    run: Annotated[int, Field(ge=0, le=MAX_RUN)] = 0
    """Tells confirmations of this run of the mission from those of earlier ones; 0: none is told."""

    @property
    def keeps_time(self) -> bool:
        """Whether a gate of it opens by time."""
        return any(step.not_before_s is not None for step in self.steps)

    def index_of(self, uid: str) -> int | None:
        """Return the index of a step, or `None` when this mission does not contain it."""
        return next((i for i, step in enumerate(self.steps) if step.uid == uid), None)


def run_at(time_s: float) -> int:
    """Return the number of a run that begins at a time (seconds since the Unix epoch).

    It counts minutes, and comes back after eleven days: nothing unheard is kept on a vehicle for so long.
    """
    return 1 + int(time_s // 60.0) % MAX_RUN
