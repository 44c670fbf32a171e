"""One vehicle's share of a link: signatures are checked, what somebody wants is decoded, all is counted."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, Protocol, TypeAlias

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from malipp_field.errors import LinkError
from malipp_field.link.exchange import (
    AUTOPILOT_COMPONENT,
    GROUND_COMPONENT,
    GROUND_SYSTEM,
    MavMessage,
)
from malipp_field.link.frames import Frame, decoded
from malipp_field.link.keys import KeyRing
from malipp_field.link.signing import Refusal, SigningKey
from malipp_field.mission import Mission
from malipp_field.mission.link_url import LinkUrl, parse_link_url

REFUSALS_TOLD_S = 10.0
"""Frames that are refused are told of at most this often."""

log = logging.getLogger(__name__)

OnMessage: TypeAlias = Callable[[MavMessage], object]
OnEvent: TypeAlias = Callable[[Literal["info", "warning", "error"], str], None]


@dataclass(frozen=True)
class VehicleLink:
    """How one vehicle is reached.

    Attributes
    ----------
    url
        Its wire, which other vehicles may share.
    system_id, component_id
        The autopilot's MAVLink address.
    key
        To sign with, and to believe nothing that is not signed with it.
    own
        As whom to speak: system and component id.
    shared
        Whether this vehicle may hear, and believe, heartbeats of ours that are for another on the same link.
    """

    url: LinkUrl
    system_id: int
    component_id: int = AUTOPILOT_COMPONENT
    key: SigningKey | None = None
    own: tuple[int, int] = (GROUND_SYSTEM, GROUND_COMPONENT)
    shared: bool = False


def vehicle_link(mission: Mission, robot: str, folder: Path, keys: KeyRing) -> VehicleLink:
    """Return how a robot of a mission is reached.

    Parameters
    ----------
    folder
        Where the mission file is; key files are named relative to it.
    keys
        Opens the key file, and holds it until it is closed.

    Raises
    ------
    LinkError
        When the mission names no link for it.
    InputError
        When its key file cannot be used.
    """
    settings = mission.vehicle(robot)
    if settings.link is None:
        raise LinkError(f"vehicles.{robot}: no link is given; add link: udpin:0.0.0.0:14550, or another")
    key = None if settings.signing_key is None else keys.key(folder / settings.signing_key)
    assert settings.system_id is not None
    url, ground = parse_link_url(settings.link), mission.ground_station
    own = (ground.system_id, ground.component_id)
    others = [mission.vehicle(other.id) for other in mission.team.robots if other.id != robot]
    together = [other for other in others if other.link is not None and parse_link_url(other.link) == url]
    # A vehicle without a key believes what is signed for another, too.
    shared = any(settings.signing_key in (None, other.signing_key) for other in together)
    return VehicleLink(url, settings.system_id, settings.component_id, key, own, shared)


class SharedLink(Protocol):
    """What a channel needs of its link."""

    def send(self, channel: Channel, message: MavMessage) -> None:
        """Send a message of a channel."""
        ...

    def detach(self, channel: Channel) -> None:
        """Let a channel hear no more."""
        ...


class Channel:
    """One vehicle's share of a link; made by `Links.open`.

    Attributes
    ----------
    heard : int
        Messages handed on.
    skipped, undecodable : int
        Frames nobody wants, and frames whose fields make no message.
    refused : Counter of Refusal
        Frames not believed, by reason.
    faults : int
        Messages whose handling raised an exception; logged, and never the end of the link.
    """

    def __init__(
        self,
        link: SharedLink,
        where: VehicleLink,
        on_message: OnMessage,
        on_event: OnEvent,
        skip: frozenset[int],
    ) -> None:
        self._link, self.where = link, where
        self._on_message, self.on_event = on_message, on_event
        self._skip = skip
        self._packer = mavlink.MAVLink(None, srcSystem=where.own[0], srcComponent=where.own[1])
        self._told_s = -REFUSALS_TOLD_S
        self._untold: Counter[Refusal] = Counter()
        self.heard = self.skipped = self.undecodable = self.faults = 0
        self.refused: Counter[Refusal] = Counter()

    def send(self, message: MavMessage) -> None:
        """Send a message; a vehicle that is not there is noticed by its silence, not here."""
        self._link.send(self, message)

    def close(self) -> None:
        """Hear no more; the link is closed with its last channel."""
        self._link.detach(self)

    def pack(self, message: MavMessage, seq: int, now_s: float) -> bytes:
        """Return the frame of a message, signed where the vehicle has a key."""
        key, self._packer.seq = self.where.key, seq
        return bytes(message.pack(self._packer)) if key is None else key.pack(message, self._packer, now_s)

    def take(self, frame: Frame, now_s: float) -> Refusal | None:
        """Take in a frame of this vehicle or its radio; return why it is not believed, if it is not."""
        key = self.where.key
        refusal = None if key is None else key.refusal(frame, now_s)
        if refusal is not None:
            self._refuse(refusal, now_s)
        elif frame.message_id in self._skip:
            self.skipped += 1
        else:
            self._hand_on(frame)
        return refusal

    def vouches(self, frame: Frame) -> bool:
        """Whether a frame that was taken is the autopilot's own, as far as that can be known."""
        autopilot = (self.where.system_id, self.where.component_id)
        return (frame.system, frame.component) == autopilot and (self.where.key is None or frame.signed)

    def _hand_on(self, frame: Frame) -> None:
        message = decoded(frame)
        if message is None:
            self.undecodable += 1
            return
        self.heard += 1
        try:
            self._on_message(message)
        except Exception:
            self.faults += 1
            log.exception("handling %s failed", message.get_type())

    def _refuse(self, refusal: Refusal, now_s: float) -> None:
        self.refused[refusal] += 1
        self._untold[refusal] += 1
        if now_s < self._told_s + REFUSALS_TOLD_S:
            return
        counts = ", ".join(f"{count} {reason}" for reason, count in sorted(self._untold.items()))
        self._untold.clear()
        self._told_s = now_s
        self.on_event("warning", f"link: not believed: {counts}")
