"""The MAVLink mission protocol of a ground station: upload, download and clear, as machines without I/O.

One protocol carries three kinds of items: missions, fences and rally points (`MissionType`).

Source: https://mavlink.io/en/services/mission.html, and what ArduPilot makes of it: it drives an upload by
requests, repeats each after about 1 s and gives up after 8 s; it truncates the stored mission at
MISSION_COUNT, so an upload is not atomic; it answers a duplicate with MAV_MISSION_INVALID_SEQUENCE, a second
uploader with MAV_MISSION_DENIED, and an item when no upload is going on with MAV_MISSION_ERROR.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from enum import IntEnum

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from malipp_field.link.commands import command_name
from malipp_field.link.exchange import (
    AUTOPILOT_COMPONENT,
    DEFAULT_TIMEOUT_S,
    GROUND_COMPONENT,
    GROUND_SYSTEM,
    RETRIES,
    SILENCE_LIMIT_S,
    Exchange,
    MavMessage,
)
from malipp_field.vehicle.items import MissionItem

ITEM_TIMEOUT_S = 0.25
REQUESTS_UNDER_WAY = 4
"""Items asked for at a time in a download: as many answers fit into an autopilot's buffer for a radio."""
BUSY_LIMIT_S = 30.0
"""How long to wait for another uploader to end, or for a vehicle that says it cannot just now."""
ATTEMPTS = 1 + RETRIES
"""Times an upload is begun (a lost final ACK leaves no way but to begin again)."""


class MissionType(IntEnum):
    """MAV_MISSION_TYPE: what a list of items is."""

    MISSION = mavlink.MAV_MISSION_TYPE_MISSION
    FENCE = mavlink.MAV_MISSION_TYPE_FENCE
    RALLY = mavlink.MAV_MISSION_TYPE_RALLY

    @property
    def word(self) -> str:
        """Its name in a sentence: mission, fence, rally points."""
        return {MissionType.RALLY: "rally points"}.get(self, self.name.lower())


_REQUESTS = (mavlink.MAVLINK_MSG_ID_MISSION_REQUEST, mavlink.MAVLINK_MSG_ID_MISSION_REQUEST_INT)
_NOT_NOW = (mavlink.MAV_MISSION_ERROR, mavlink.MAV_MISSION_DENIED)
_NEVER_FATAL = (
    mavlink.MAV_MISSION_INVALID_SEQUENCE,
    mavlink.MAV_MISSION_DENIED,
    mavlink.MAV_MISSION_OPERATION_CANCELLED,
)
_REFUSES_COUNT = (mavlink.MAV_MISSION_UNSUPPORTED, mavlink.MAV_MISSION_NO_SPACE)


def result_words(result: int) -> str:
    """Return a MAV_MISSION_RESULT as its name and meaning."""
    entry = mavlink.enums["MAV_MISSION_RESULT"].get(result)
    if entry is None or entry.name.endswith("ENUM_END"):
        return f"unknown result {result}"
    return f"{entry.name}: {entry.description.rstrip('.')}"


class MissionExchange(Exchange):
    """Base of the three conversations: whose messages count, and a vehicle that is busy."""

    def __init__(
        self,
        target_system: int,
        target_component: int = AUTOPILOT_COMPONENT,
        own_system: int = GROUND_SYSTEM,
        own_component: int = GROUND_COMPONENT,
        mission_type: MissionType = MissionType.MISSION,
    ) -> None:
        super().__init__(target_system, target_component, own_system, own_component)
        self._type = mission_type
        self._busy_since_s: float | None = None

    def receive(self, message: MavMessage, now_s: float) -> list[MavMessage]:
        """Take in a message of the link; only the vehicle's answers to us, about missions, count."""
        if not self._sent_by_target(message) or getattr(message, "mission_type", -1) != self._type:
            return []
        if (message.target_system, message.target_component) != self._own:
            return []
        return self._answered(message, now_s)

    @abstractmethod
    def _answered(self, message: MavMessage, now_s: float) -> list[MavMessage]:
        """Take in what the vehicle answers us about its mission."""

    def _wait_for_turn(self, result: int, now_s: float) -> list[MavMessage]:
        """Note that the vehicle cannot just now; the pending question is repeated until the limit."""
        self._busy_since_s = now_s if self._busy_since_s is None else self._busy_since_s
        self._heard_s = now_s
        if now_s >= self._busy_since_s + BUSY_LIMIT_S:
            return self._fail(f"the vehicle refused for {BUSY_LIMIT_S:.0f} s ({result_words(result)})")
        return []

    def _silent(self, question: str) -> list[MavMessage]:
        return self._fail(f"vehicle {self._target[0]} does not answer {question}")


class MissionUpload(MissionExchange):
    """Put a mission, a fence or rally points on a vehicle.

    `done` means that the vehicle acknowledged a transfer in which it was given every item.

    Parameters
    ----------
    items
        All of them, numbered from 0; of a mission item 0 is home, a fence and rally points have none.
    """

    def __init__(
        self,
        items: Sequence[MissionItem],
        target_system: int,
        target_component: int = AUTOPILOT_COMPONENT,
        own_system: int = GROUND_SYSTEM,
        own_component: int = GROUND_COMPONENT,
        mission_type: MissionType = MissionType.MISSION,
    ) -> None:
        super().__init__(target_system, target_component, own_system, own_component, mission_type)
        if [item.seq for item in items] != list(range(len(items))):
            raise ValueError("the items of a mission are numbered from 0 without gaps")
        self._items = list(items)
        self._given: set[int] = set()
        self._wanted: int | None = None  # how far it has asked; None while MISSION_COUNT is the question
        self._attempts = 0
        self._refusal: int | None = None

    @property
    def progress(self) -> tuple[int, int]:
        """Items the vehicle has been given, and all items."""
        return len(self._given), len(self._items)

    def start(self, now_s: float) -> list[MavMessage]:
        """Announce the mission."""
        self._attempts += 1
        self._wanted = self._refusal = None
        return self._ask(now_s)

    def _question(self) -> list[MavMessage]:
        if self._wanted is None:
            count = len(self._items)
            return [mavlink.MAVLink_mission_count_message(*self._target, count, mission_type=self._type)]
        # The vehicle drives: after the specified retries it is left to ask again.
        return [self._item_message(self._wanted)] if self._repeats <= RETRIES else []

    def _item_message(self, seq: int) -> MavMessage:
        item = self._items[seq]
        return mavlink.MAVLink_mission_item_int_message(*self._target, *item, mission_type=self._type)

    def tick(self, now_s: float) -> list[MavMessage]:
        """Let time pass; begin again when the vehicle neither asks for an item nor acknowledges."""
        if not self.ended and self._wanted is not None and now_s >= self._heard_s + self._patience_s:
            return self._again(now_s)
        return super().tick(now_s)

    @property
    def _patience_s(self) -> float:
        """How long the vehicle may be silent in mid-transfer before it must have ended it."""
        if self._refusal is not None:
            return DEFAULT_TIMEOUT_S
        # At the last item it is either about to repeat its request (1 s), or done and its only ACK is lost.
        return 2 * DEFAULT_TIMEOUT_S if self._wanted == len(self._items) - 1 else SILENCE_LIMIT_S

    def _again(self, now_s: float) -> list[MavMessage]:
        if self._attempts < ATTEMPTS:
            return self.start(now_s)
        asked = self._named(self._wanted or 0)
        why = "no answer" if self._refusal is None else result_words(self._refusal)
        return self._fail(f"{asked} did not get through in {ATTEMPTS} attempts ({why})")

    def _unanswered(self) -> list[MavMessage]:
        return self._silent("MISSION_COUNT")

    def _answered(self, message: MavMessage, now_s: float) -> list[MavMessage]:
        if message.get_msgId() in _REQUESTS:
            return self._requested(message.seq, now_s)
        if message.get_msgId() == mavlink.MAVLINK_MSG_ID_MISSION_ACK and not self.ended:
            return self._acknowledged(message.type, now_s)
        return []

    def _requested(self, seq: int, now_s: float) -> list[MavMessage]:
        """Answer a request, whichever of the two kinds, and even when it is late."""
        if seq >= len(self._items) or self.ended:
            return []
        self._given.add(seq)
        # A late request for an earlier item does not mean that the vehicle has gone back.
        self._wanted = seq if self._wanted is None else max(self._wanted, seq)
        self._refusal = self._busy_since_s = None
        self._expect(now_s, ITEM_TIMEOUT_S)
        return [self._item_message(seq)]

    def _acknowledged(self, result: int, now_s: float) -> list[MavMessage]:
        if result == mavlink.MAV_MISSION_ACCEPTED:
            return self._finish() if len(self._given) == len(self._items) else []
        if self._wanted is None:
            return self._count_refused(result, now_s)
        if result in (mavlink.MAV_MISSION_ERROR, mavlink.MAV_MISSION_OPERATION_CANCELLED):
            # It is not receiving: it gave up, or it has all and its ACK is lost; or this answers a duplicate.
            self._refusal = result
            return []
        if result in _NEVER_FATAL:
            return []
        return self._fail(f"{self._named(self._wanted)} was refused ({result_words(result)})")

    def _count_refused(self, result: int, now_s: float) -> list[MavMessage]:
        if result in _REFUSES_COUNT:
            return self._fail(
                f"a {self._type.word} upload of {len(self._items)} items was refused ({result_words(result)})"
            )
        # Whatever else there is to say about items is late news of an earlier attempt.
        return self._wait_for_turn(result, now_s) if result in _NOT_NOW else []

    def _named(self, seq: int) -> str:
        return f"item {seq} ({command_name(self._items[seq].command)})"


class MissionDownload(MissionExchange):
    """Read the items of one type that are on a vehicle; `items` holds them when `done`.

    An ArduPilot answers each request on its own, so a few are always under way: one after the other, a radio
    that takes 0.2 s each way would take 40 s for 100 items.
    """

    def __init__(
        self,
        target_system: int,
        target_component: int = AUTOPILOT_COMPONENT,
        own_system: int = GROUND_SYSTEM,
        own_component: int = GROUND_COMPONENT,
        mission_type: MissionType = MissionType.MISSION,
    ) -> None:
        super().__init__(target_system, target_component, own_system, own_component, mission_type)
        self.items: list[MissionItem] = []
        self._count: int | None = None
        self._arrived: dict[int, MissionItem] = {}
        self._requested_s: dict[int, float] = {}  # those under way, and when each was asked for last
        self._next = 0  # the first that was never asked for

    @property
    def progress(self) -> tuple[int, int]:
        """Items that have arrived, and all items (0 while that is not known)."""
        return len(self._arrived), self._count or 0

    def start(self, now_s: float) -> list[MavMessage]:
        """Ask how many items there are."""
        return self._ask(now_s)

    def tick(self, now_s: float) -> list[MavMessage]:
        """Let time pass; ask again for what is late."""
        if self.ended or self._count is None:
            return super().tick(now_s)
        late = [seq for seq, asked_s in self._requested_s.items() if now_s >= asked_s + self._interval_s]
        if not late:
            return []
        if self._repeats >= RETRIES and now_s >= self._heard_s + SILENCE_LIMIT_S:
            return self._unanswered()
        self._repeats += 1
        return [self._request(seq, now_s) for seq in late]

    def _question(self) -> list[MavMessage]:
        return [mavlink.MAVLink_mission_request_list_message(*self._target, mission_type=self._type)]

    def _request(self, seq: int, now_s: float) -> MavMessage:
        self._requested_s[seq] = now_s
        return mavlink.MAVLink_mission_request_int_message(*self._target, seq, mission_type=self._type)

    def _unanswered(self) -> list[MavMessage]:
        if self._count is None:
            return self._silent("MISSION_REQUEST_LIST")
        return self._silent(f"a request for item {min(self._requested_s)}")

    def _answered(self, message: MavMessage, now_s: float) -> list[MavMessage]:
        kind = message.get_msgId()
        if self.ended:
            return []
        if kind == mavlink.MAVLINK_MSG_ID_MISSION_COUNT and self._count is None:
            self._count = message.count
            # Twice what this answer took is time enough for another, on a slow link as well.
            self._interval_s = min(max(ITEM_TIMEOUT_S, 2.0 * (now_s - self._asked_s)), DEFAULT_TIMEOUT_S)
            return self._go_on(now_s)
        if kind == mavlink.MAVLINK_MSG_ID_MISSION_ITEM_INT and message.seq in self._requested_s:
            del self._requested_s[message.seq]
            fields = (getattr(message, name) for name in MissionItem._fields)
            self._arrived[message.seq] = MissionItem(*fields)
            return self._go_on(now_s)
        if kind == mavlink.MAVLINK_MSG_ID_MISSION_ACK:
            return self._refused(message.type, now_s)
        return []

    def _go_on(self, now_s: float) -> list[MavMessage]:
        """Ask for more, or end."""
        assert self._count is not None
        self._busy_since_s, self._heard_s, self._repeats = None, now_s, 0
        first = self._next
        self._next = min(self._count, first + REQUESTS_UNDER_WAY - len(self._requested_s))
        if len(self._arrived) < self._count:
            return [self._request(seq, now_s) for seq in range(first, self._next)]
        self.items = [self._arrived[seq] for seq in range(self._count)]
        self.done = True
        accepted = mavlink.MAV_MISSION_ACCEPTED
        return [mavlink.MAVLink_mission_ack_message(*self._target, accepted, mission_type=self._type)]

    def _refused(self, result: int, now_s: float) -> list[MavMessage]:
        """Wait while somebody uploads; an ACK of an earlier upload is no answer to a request."""
        if result in _NOT_NOW:
            return self._wait_for_turn(result, now_s)
        if result == mavlink.MAV_MISSION_UNSUPPORTED:
            return self._fail(
                f"the vehicle cannot be asked for its {self._type.word} ({result_words(result)})"
            )
        return []


class MissionClear(MissionExchange):
    """Remove the items of one type from a vehicle."""

    def start(self, now_s: float) -> list[MavMessage]:
        """Ask for it."""
        return self._ask(now_s)

    def _question(self) -> list[MavMessage]:
        return [mavlink.MAVLink_mission_clear_all_message(*self._target, mission_type=self._type)]

    def _unanswered(self) -> list[MavMessage]:
        return self._silent("MISSION_CLEAR_ALL")

    def _answered(self, message: MavMessage, now_s: float) -> list[MavMessage]:
        if message.get_msgId() != mavlink.MAVLINK_MSG_ID_MISSION_ACK or self.ended:
            return []
        if message.type == mavlink.MAV_MISSION_ACCEPTED:
            return self._finish()
        if message.type in _NOT_NOW:
            return self._wait_for_turn(message.type, now_s)
        return [] if message.type in _NEVER_FATAL else self._fail(result_words(message.type))
