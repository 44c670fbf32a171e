"""What waits to be sent over a link that is slower than we are."""

from __future__ import annotations

from collections.abc import Hashable
from typing import Generic, TypeVar

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from malipp_field.link.exchange import MavMessage

MAX_WAITING = 256
"""Messages waiting on a link that takes none any more; there are never as many on one that only is slow."""
HEARTBEAT_KEPT_S = 1.0
"""How long a heartbeat may wait to be sent."""

_REQUESTS = (mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, mavlink.MAV_CMD_REQUEST_MESSAGE)

SenderT = TypeVar("SenderT", bound=Hashable)


class Outbox(Generic[SenderT]):
    """Messages in the order in which they are to be sent, each with who sends it.

    A heartbeat or a request for telemetry takes the place of an older one that still waits, and so does a
    message that says the same as one that waits, unless it is a command: HOLD, AUTO, HOLD ends in HOLD. A
    heartbeat that has waited for a second is left out: it speaks for the moment, and whoever stops them must
    know when the last one goes. Nothing else is ever left out.

    Attributes
    ----------
    superseded : int
        Messages that were never sent because a newer one took their place, or is due.
    """

    def __init__(self) -> None:
        self._waiting: dict[Hashable, tuple[SenderT, MavMessage, float]] = {}
        self.superseded = 0

    def __len__(self) -> int:
        return len(self._waiting)

    @property
    def full(self) -> bool:
        """Whether so much waits that the link cannot be working."""
        return len(self._waiting) >= MAX_WAITING

    def put(self, sender: SenderT, message: MavMessage, now_s: float) -> None:
        """Add a message, or put it in the place of an older one."""
        key = (sender, _subject(message))
        self.superseded += key in self._waiting
        self._waiting[key] = (sender, message, now_s)

    def take(self, now_s: float) -> tuple[SenderT, MavMessage] | None:
        """Remove and return the first that is still to be sent, if there is one."""
        while self._waiting:
            sender, message, since_s = self._waiting.pop(next(iter(self._waiting)))
            if message.get_msgId() != mavlink.MAVLINK_MSG_ID_HEARTBEAT or now_s <= since_s + HEARTBEAT_KEPT_S:
                return sender, message
            self.superseded += 1
        return None

    def clear(self) -> int:
        """Throw everything away; return how much that was."""
        count = len(self._waiting)
        self._waiting.clear()
        return count


def _subject(message: MavMessage) -> Hashable:
    """Return what a message is about: the newest on a subject is all that needs to be sent."""
    kind = int(message.get_msgId())
    if kind == mavlink.MAVLINK_MSG_ID_HEARTBEAT:
        return kind
    if kind == mavlink.MAVLINK_MSG_ID_COMMAND_LONG:
        asked = (kind, int(message.command), float(message.param1))
        return asked if message.command in _REQUESTS else object()
    return kind, str([getattr(message, name) for name in message.fieldnames])
