"""What all conversations with an autopilot have in common: ask, repeat, be patient, end.

An exchange does no I/O and owns no clock: it is told what arrived and what time it is, and hands back the
messages to send. Whoever drives it calls `start` once, `receive` for every message of the link, and `tick`
often (50 ms is plenty).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TypeAlias

from pymavlink.dialects.v20 import ardupilotmega as mavlink

MavMessage: TypeAlias = mavlink.MAVLink_message

GROUND_SYSTEM = 255
"""Heartbeats of this system id feed ArduPilot's ground station failsafe by default."""
GROUND_COMPONENT = 190
AUTOPILOT_COMPONENT = 1

DEFAULT_TIMEOUT_S = 1.5
RETRIES = 5
"""Repeats of an unanswered message, at least (MAVLink mission protocol, "Timeouts and Retries")."""
SILENCE_LIMIT_S = 10.0
"""Never give up earlier than the vehicle: ArduPilot waits 8 s for an item."""


class Exchange(ABC):
    """One conversation with one component of one vehicle.

    Parameters
    ----------
    target_system, target_component
        Whom to talk to; what anybody else says is not heard.
    own_system, own_component
        Who is talking; answers to another ground station are not ours.

    Attributes
    ----------
    done : bool
        It has succeeded.
    failure : str or None
        Why it has failed, in words.
    """

    def __init__(
        self,
        target_system: int,
        target_component: int = AUTOPILOT_COMPONENT,
        own_system: int = GROUND_SYSTEM,
        own_component: int = GROUND_COMPONENT,
    ) -> None:
        self._target = (target_system, target_component)
        self._own = (own_system, own_component)
        self.done = False
        self.failure: str | None = None
        self._interval_s = DEFAULT_TIMEOUT_S
        self._asked_s = 0.0
        self._heard_s = 0.0
        self._repeats = 0

    @property
    def ended(self) -> bool:
        """Whether it has succeeded or failed."""
        return self.done or self.failure is not None

    @abstractmethod
    def start(self, now_s: float) -> list[MavMessage]:
        """Begin; return the messages to send."""

    @abstractmethod
    def receive(self, message: MavMessage, now_s: float, /) -> list[MavMessage]:
        """Take in a message of the link, whoever sent it; return the messages to send."""

    def tick(self, now_s: float) -> list[MavMessage]:
        """Let time pass; return the messages to send (again)."""
        if self.ended or now_s < self._asked_s + self._interval_s:
            return []
        if self._repeats >= RETRIES and now_s >= self._heard_s + SILENCE_LIMIT_S:
            return self._unanswered()
        self._asked_s = now_s
        self._repeats += 1
        return self._question()

    @abstractmethod
    def _question(self) -> list[MavMessage]:
        """Return the pending question, to be sent again."""

    @abstractmethod
    def _unanswered(self) -> list[MavMessage]:
        """Deal with a vehicle that has been silent for too long."""

    def _ask(self, now_s: float, interval_s: float = DEFAULT_TIMEOUT_S) -> list[MavMessage]:
        """Send a new question, to be repeated every ``interval_s`` seconds."""
        self._expect(now_s, interval_s)
        return self._question()

    def _expect(self, now_s: float, interval_s: float) -> None:
        """Note that a new question is sent, to be repeated every ``interval_s`` seconds."""
        self._interval_s = interval_s
        self._asked_s = self._heard_s = now_s
        self._repeats = 0

    def _finish(self) -> list[MavMessage]:
        self.done = True
        return []

    def _fail(self, why: str) -> list[MavMessage]:
        self.failure = why
        return []

    def _sent_by_target(self, message: MavMessage) -> bool:
        return (message.get_srcSystem(), message.get_srcComponent()) == self._target
