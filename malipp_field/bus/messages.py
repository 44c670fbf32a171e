"""Everything that is said on the bus: keys, message types and their versions, in this one place.

Keys begin with ``malipp/MISSION``; times are seconds since the Unix epoch (UTC) of the team's clock.
Messages are JSON; what does not validate on arrival is counted and dropped, never acted upon.

=============================  ==================  ====================================================
key after ``malipp/MISSION/``  type                who says it
=============================  ==================  ====================================================
``mission``                    `MissionText`       coordinator, once, before all else
``plan``                       `PlanAdopted`       coordinator, for every plan version in force
``ledger``                     `Ledger`            coordinator, whenever custody changes
``event``                      `Event`             anybody
``vehicle/ROBOT/telemetry``    `Telemetry`         the robot's agent
``vehicle/ROBOT/confirmation`` `Confirmation`      the robot's agent, for every payload action done
``vehicle/ROBOT/command``      `Command` (query)   coordinator or a person asks, agent answers with `Reply`
``alive/NAME``                 liveliness token    agents (by robot) and the recorder, while they listen
=============================  ==================  ====================================================
"""

from __future__ import annotations

from typing import Annotated, Literal, TypeAlias

from pydantic import BaseModel, ConfigDict, Field

from malipp_field.plan import Plan
from malipp_field.vehicle.steps import Action, Sample, VehicleMission, Witness


class Message(BaseModel):
    """Base of all messages: frozen, unknown keys refused."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    time_s: float


class MissionText(Message):
    """The mission file, as it was read."""

    kind: Literal["mission/1"] = "mission/1"
    text: str


class PlanAdopted(Message):
    """A plan in force on every vehicle it concerns, with the vehicle missions that carry it out.

    `time_s` is when it came into force. Version 1 comes with the start of the mission.
    """

    kind: Literal["plan/1"] = "plan/1"
    start_s: float
    """When mission time 0 was; times in plans count from it."""
    plan: Plan
    missions: tuple[VehicleMission, ...]
    samples: tuple[Sample, ...]
    """Provenance of every container that the missions name."""
    reason: str
    """Why this plan: the trigger of a replan, in words."""


class Event(Message):
    """Something a person reviewing the mission wants to see on the timeline."""

    kind: Literal["event/1"] = "event/1"
    source: str
    severity: Literal["info", "warning", "error"]
    text: str
    robot: str | None = None


class Awaited(BaseModel):
    """A payload action that stands still until a person has confirmed it."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    uid: str
    action: Action
    node: str
    tag: int
    since_s: float
    problem: str = ""
    """What the vehicle says is wrong, where it tried by itself: ``missing``, ``full`` or ``unknown``."""

    def __str__(self) -> str:
        trouble = f" ({self.problem})" if self.problem else ""
        return f"{self.action} container {self.tag} at {self.node}{trouble}"


class Telemetry(Message):
    """State of one vehicle as its autopilot reports it."""

    kind: Literal["telemetry/1"] = "telemetry/1"
    robot: str
    lat_deg: float
    lon_deg: float
    heading_deg: float
    speed_m_s: float
    mode: str
    armed: bool
    ready_to_arm: bool
    energy_used_j: float
    """Since the vehicle was switched on."""
    mission_version: int | None
    """Version of the verified mission on board; null while there is none."""
    step_uid: str | None
    """The step being carried out."""
    finished: bool
    """All steps are done."""
    link_ok: bool
    """Heartbeats arrive."""
    awaits: Awaited | None = None
    """What the vehicle waits for a person to do or to judge; see `Confirm`."""


class Confirmation(Message):
    """A payload action that is done, or could not be done."""

    kind: Literal["confirmation/1"] = "confirmation/1"
    robot: str
    number: int
    """Counts what this vehicle's agent has confirmed since it was started, from 1 and without gaps. An agent
    that is started again begins at 1: only the uid, or action and tag, tell one confirmation from another."""
    uid: str
    action: Action
    node: str
    tag: int
    ok: bool
    value: float | None = None
    """In-situ reading of a collected sample, where the sensor gives one."""
    text: str = ""
    """Why it is not done."""
    by: Witness = "script"
    """Who says so."""
    goes_on: bool = False
    """It is not done, and the vehicle goes on without it: as the mission has it, or as a person decided."""


class CustodyEvent(BaseModel):
    """One link of a chain of custody."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    time_s: float
    action: Action
    robot: str
    node: str


class SampleRecord(BaseModel):
    """Where one container is, and its whole way so far."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    sample: Sample
    state: Literal["planned", "withdrawn", "on_board", "cached", "delivered", "lost"]
    holder: str | None
    """The robot that carries it, or the node where it lies; null before it is taken."""
    value: float | None = None
    history: tuple[CustodyEvent, ...] = ()


class Ledger(Message):
    """Custody of every container of the mission."""

    kind: Literal["ledger/1"] = "ledger/1"
    samples: tuple[SampleRecord, ...]


class Load(BaseModel):
    """Put a mission on the vehicle: hold it if it is under way, upload, read back, compare.

    With `resume` the vehicle then goes on, in AUTO, at the first step of the new mission that is not done
    yet. The agent refuses before it sends or holds anything, when the vehicle has left the part that the old
    and the new mission share: the step being carried out must be part of the new mission, or be the gate
    (a `WAIT` step) named by `diverges_at`; a vehicle that has finished is always at its last step's node.
    A first mission (nothing `done`, not `begun`) is refused, too, where the vehicle is not at its home. After
    a failure the vehicle is left holding, never driving.

    An agent that was started again in mid-mission knows nothing of it. Told by `begun` or `done` that the
    vehicle is part-way, it reads what is on board first; where that is this mission, it follows it from the
    item that the vehicle reports, and neither stops the vehicle nor uploads anything. A vehicle that drives
    another one then is left alone, unless `begun` says that it should not.
    """

    do: Literal["load"] = "load"
    mission: VehicleMission
    resume: bool = False
    diverges_at: str | None = None
    """The first step of the mission in force that the new one does not keep."""
    done: tuple[str, ...] = ()
    """Uids of steps known to be done, for an agent that may not know: they are neither done nor confirmed
    again. Those that are not of the mission do no harm."""
    begun: bool = False
    """The vehicle was seen to carry out this very mission: also in HOLD, the item it reports is one of it."""


class Start(BaseModel):
    """Arm and enter AUTO with the verified mission, or go on with it; refused where it is another version."""

    do: Literal["start"] = "start"
    version: int | None = None
    """The mission that is meant; null for whichever is on board."""


class Release(BaseModel):
    """Let the vehicle pass the gate (a `WAIT` step) of that uid."""

    do: Literal["release"] = "release"
    uid: str


class Hold(BaseModel):
    """Stop where it is."""

    do: Literal["hold"] = "hold"
    reason: str


class Confirm(BaseModel):
    """A person's word on the action a vehicle waits for (`Telemetry.awaits`), named by uid or by tag.

    The agent publishes the `Confirmation`, and the vehicle goes on, done or not. Refused for any other step.
    """

    do: Literal["confirm"] = "confirm"
    uid: str | None = None
    tag: int | None = None
    ok: bool = True
    text: str = ""
    """What went wrong."""
    value: float | None = None
    """Reading of a collected sample."""


Order: TypeAlias = Load | Start | Release | Hold | Confirm


class Command(Message):
    """What the coordinator, or a person, asks of one agent."""

    order: Annotated[Order, Field(discriminator="do")]


class Reply(Message):
    """The agent's answer: done, or not and why."""

    ok: bool
    text: str = ""


AnyMessage = MissionText | PlanAdopted | Event | Telemetry | Confirmation | Ledger


def root(mission: str) -> str:
    """Return the prefix of every key of a mission."""
    return f"malipp/{mission}"


def vehicle_key(mission: str, robot: str, what: str) -> str:
    """Return the key of something that one vehicle's agent says or answers."""
    return f"{root(mission)}/vehicle/{robot}/{what}"


def presence_key(mission: str, name: str) -> str:
    """Return the key of the liveliness token of a robot's agent, or of the recorder."""
    return f"{root(mission)}/alive/{name}"
