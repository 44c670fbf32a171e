"""Vehicles as the mission file describes them: their links, and how their payload hardware is worked.

All of it is optional. A robot without an entry is an ArduPilot rover with the payload script on board, whose
MAVLink system id is its position in the team, counted from 1.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal, TypeAlias

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from malipp_field.documents import StrictModel
from malipp_field.mission.link_url import parse_link_url

ARDUPILOT_MAX_ITEMS = 655
"""Mission items, home included, that an ArduPilot Rover stores (measured on the 4.7 development line)."""

_ACTIONS = ("collect", "drop", "pick", "unload")

SystemId: TypeAlias = Annotated[int, Field(ge=1, le=255)]
Seconds: TypeAlias = Annotated[float, Field(gt=0, le=3600)]
Pulse: TypeAlias = Annotated[int, Field(ge=500, le=2500)]
"""Servo pulse in microseconds; ArduPilot does not check its range, so this does."""
LinkText: TypeAlias = Annotated[str, AfterValidator(lambda text: str(parse_link_url(text)))]
"""A MAVLink URL in its one spelling."""
Confirmed: TypeAlias = Literal["progress", "operator"]
"""What confirms an action of hardware that cannot speak: that the vehicle has gone past it, or a person."""


class ByScript(StrictModel):
    """By the payload script on the vehicle, which confirms what it has done."""

    by: Literal["script"] = "script"


class ByHand(StrictModel):
    """By a person: the vehicle holds at the stop until somebody confirms (`malipp confirm`)."""

    by: Literal["manual"]


class ByServo(StrictModel):
    """By a servo output, set for a while and then to rest, where a rest position is given."""

    by: Literal["servo"]
    channel: Annotated[int, Field(ge=1, le=32)]
    pwm_us: Pulse
    rest_us: Pulse | None = None
    duration_s: Seconds
    confirm: Confirmed = "progress"


class ByRelay(StrictModel):
    """By a relay, switched on for a while and then off; relays count from 0."""

    by: Literal["relay"]
    relay: Annotated[int, Field(ge=0, le=15)]
    duration_s: Seconds
    confirm: Confirmed = "progress"


class ByGripper(StrictModel):
    """By a gripper, which grabs or releases and is given time to do so."""

    by: Literal["gripper"]
    gripper: Annotated[int, Field(ge=1, le=8)] = 1
    move: Literal["grab", "release"]
    duration_s: Seconds
    confirm: Confirmed = "progress"


def _no_bare_word(data: Any) -> Any:
    if isinstance(data, str):
        raise ValueError(f"expected keys, such as {{by: manual}}, found '{data}'")
    return data


Actuator: TypeAlias = ByServo | ByRelay | ByGripper
Means: TypeAlias = Annotated[
    ByScript | ByHand | Actuator, Field(discriminator="by"), BeforeValidator(_no_bare_word)
]


class PayloadProfile(StrictModel):
    """How one vehicle collects, drops, picks and unloads.

    ``payload: manual`` or ``payload: script`` in a mission file stands for all four.
    """

    collect: Means = ByScript()
    drop: Means = ByScript()
    pick: Means = ByScript()
    unload: Means = ByScript()

    @model_validator(mode="before")
    @classmethod
    def _one_word_for_all(cls, data: Any) -> Any:
        if data in ("script", "manual"):
            return {action: {"by": data} for action in _ACTIONS}
        if isinstance(data, str):
            raise ValueError(
                f"expected script or manual for all actions, or keys for {', '.join(_ACTIONS)}; "
                f"found '{data}'"
            )
        return data


class VehicleSettings(StrictModel):
    """One robot's vehicle.

    Attributes
    ----------
    link
        MAVLink URL: ``udpin:HOST:PORT``, ``udpout:HOST:PORT``, ``tcp:HOST:PORT`` or ``serial:DEVICE:BAUD``.
        Vehicles on one radio name the same link.
    system_id, component_id
        The autopilot's MAVLink address; the system id is the robot's position in the team where not given.
    signing_key
        File with the vehicle's MAVLink 2 signing key, readable by its owner only; relative to the mission
        file. Without it nothing is signed.
    payload
        How actions are done.
    gate
        How the vehicle waits for a teammate's drop: ``custody``, until the coordinator has seen it
        confirmed; ``time``, until then or until the pick is due by the plan, by the vehicle's own clock.
    gate_margin_s
        What a time gate adds to the time of the pick by the plan. The gates after it, and those of who waits
        for this vehicle, allow for it.
    if_missing
        What the vehicle does where a container is not there to be picked.
    max_items
        Mission items it can store, home included.
    """

    link: LinkText | None = None
    system_id: SystemId | None = None
    component_id: Annotated[int, Field(ge=1, le=255)] = 1
    signing_key: str | None = None
    payload: PayloadProfile = PayloadProfile()
    gate: Literal["custody", "time"] = "custody"
    gate_margin_s: Annotated[float, Field(ge=0, le=43200)] = 30.0
    if_missing: Literal["hold", "go_on"] = "hold"
    max_items: Annotated[int, Field(ge=2, le=65535)] = ARDUPILOT_MAX_ITEMS


class GroundStation(StrictModel):
    """As whom we speak on the link: ArduPilot's failsafe counts the heartbeats of one system id only."""

    system_id: SystemId = 255
    component_id: Annotated[int, Field(ge=1, le=255)] = 190
