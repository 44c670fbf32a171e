"""The vehicle's side of the MAVLink mission protocol, as ArduPilot plays it (`MissionItemProtocol.cpp`).

A state machine without I/O: messages and the time go in, messages come out. Its rough edges are deliberate,
because the ground must survive them: the stored mission is truncated as soon as a count arrives, an item that
is refused leaves the items before it in place of the old ones (a mixed mission), and a duplicate earns an
error while the transfer goes on.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from malipp_field.sim.items import RefusedItemError, item_of, polygons_are_whole, stored
from malipp_field.vehicle.fence import MAX_FENCE_ITEMS
from malipp_field.vehicle.items import MissionItem

MAX_ITEMS = 655
"""With home; `AP_Mission` has room for no more on the boards Rover is run on."""
REPEAT_S = 1.0
GIVE_UP_S = 8.0

Message = Any
"""A message of pymavlink, which has no types."""


@dataclass(frozen=True)
class Sender:
    """Who sent a message, as MAVLink names him."""

    system: int
    component: int


@dataclass
class _Upload:
    uploader: Sender
    count: int
    awaited: int
    heard_s: float
    asked_s: float


class MissionStore:
    """The items of one mission type, and their transfer.

    Parameters
    ----------
    mission_type
        MAV_MISSION_TYPE of the items: mission, fence or rally.
    home
        Returns item 0 of a mission, which always is home whatever is uploaded; `None` for other types.
    max_items
        How many it has room for, home included.

    Attributes
    ----------
    items : list of MissionItem
        What is stored now, home first. Survives a restart of the autopilot.
    current : int
        Sequence number to be marked as current in a download.
    running : bool
        While a mission runs it cannot be cleared.
    """

    def __init__(
        self,
        mission_type: int = mavlink.MAV_MISSION_TYPE_MISSION,
        home: Callable[[], MissionItem] | None = None,
        max_items: int = MAX_ITEMS,
    ) -> None:
        self.mission_type = mission_type
        self.max_items = max_items
        self.items: list[MissionItem] = []
        self.current = 0
        self.running = False
        self._home = home
        self._upload: _Upload | None = None

    @property
    def receiving(self) -> bool:
        """Whether an upload is under way."""
        return self._upload is not None

    def item(self, seq: int) -> MissionItem | None:
        """Return the stored item of that number, or `None` beyond the end; home is always there."""
        if seq == 0 and self._home is not None:
            return self._home()
        return self.items[seq] if 0 <= seq < len(self.items) else None

    def abort(self) -> None:
        """Forget a transfer under way, as a restart does."""
        self._upload = None

    def receive(self, message: Message, sender: Sender, now_s: float) -> list[Message]:
        """Handle one message of the mission protocol and return the answers to its sender."""
        match message.get_type():
            case "MISSION_COUNT":
                answers = self._begin(message.count, sender, now_s)
            case "MISSION_ITEM_INT" | "MISSION_ITEM":
                answers = self._accept(message, sender, now_s)
            case "MISSION_REQUEST_LIST":
                answers = self._denied(sender) if self.receiving else [self._count_for(sender)]
            case "MISSION_REQUEST_INT" | "MISSION_REQUEST":
                answers = self._answer_request(message.seq, sender)
            case "MISSION_CLEAR_ALL":
                answers = self._clear(sender)
            case "MISSION_WRITE_PARTIAL_LIST":
                answers = [self._ack(sender, mavlink.MAV_MISSION_UNSUPPORTED)]
            case _:
                answers = []
        return answers

    def poll(self, now_s: float) -> list[Message]:
        """Return what is due to the uploader: a request once more, or that the upload was given up."""
        upload = self._upload
        if upload is None:
            return []
        if now_s - upload.heard_s > GIVE_UP_S:
            self._upload = None
            return [self._ack(upload.uploader, mavlink.MAV_MISSION_OPERATION_CANCELLED)]
        if now_s - upload.asked_s > REPEAT_S:
            return [self._request(upload, now_s)]
        return []

    def _begin(self, count: int, sender: Sender, now_s: float) -> list[Message]:
        if self._upload is not None and self._upload.uploader != sender:
            return self._denied(sender)
        self._upload = None
        if count > self.max_items:
            return [self._ack(sender, mavlink.MAV_MISSION_NO_SPACE)]
        self._make_room(count)
        if count == 0:
            return [self._ack(sender, self._complete())]
        self._upload = _Upload(sender, count, 0, heard_s=now_s, asked_s=now_s)
        return [self._request(self._upload, now_s)]

    def _accept(self, message: Message, sender: Sender, now_s: float) -> list[Message]:
        upload = self._upload
        if upload is None:  # such as the last item once more: the upload is over
            return [self._ack(sender, mavlink.MAV_MISSION_ERROR)]
        if message.seq != upload.awaited:
            return [self._ack(sender, mavlink.MAV_MISSION_INVALID_SEQUENCE)]
        if sender != upload.uploader:
            return self._denied(sender)
        try:
            self._store(stored(item_of(message), self.mission_type))
        except RefusedItemError as refusal:
            self._upload = None
            return [self._ack(sender, refusal.result)]
        upload.heard_s = now_s
        upload.awaited += 1
        if upload.awaited < upload.count:
            return [self._request(upload, now_s)]
        self._upload = None
        return [self._ack(sender, self._complete())]

    def _make_room(self, count: int, /) -> None:
        """Truncate what is stored, before any item has arrived: an upload is not atomic."""
        del self.items[count:]

    def _complete(self) -> int:
        """Return the result of an upload of which all items have arrived."""
        return int(mavlink.MAV_MISSION_ACCEPTED)

    def _store(self, item: MissionItem) -> None:
        if item.seq < len(self.items):
            self.items[item.seq] = item
            return
        if not self.items and self._home is not None:
            # Home comes first of itself: an upload of one item to an empty mission becomes home and the item.
            self.items.append(self._home())
        self.items.append(item._replace(seq=len(self.items)))

    def _answer_request(self, seq: int, sender: Sender) -> list[Message]:
        if self.receiving:
            return self._denied(sender)
        item = self.item(seq)
        if item is None:
            return [self._count_for(sender), self._ack(sender, mavlink.MAV_MISSION_INVALID_SEQUENCE)]
        fields = item._replace(seq=seq, current=int(seq == self.current))
        return [
            mavlink.MAVLink_mission_item_int_message(
                sender.system, sender.component, *fields, mission_type=self.mission_type
            )
        ]

    def _clear(self, sender: Sender) -> list[Message]:
        if self.receiving or self.running:
            return [self._ack(sender, mavlink.MAV_MISSION_ERROR)]
        self.items.clear()
        return [self._ack(sender, mavlink.MAV_MISSION_ACCEPTED)]

    def _request(self, upload: _Upload, now_s: float) -> Message:
        """Ask for the awaited item with the deprecated MISSION_REQUEST, as ArduPilot does."""
        upload.asked_s = now_s
        to = upload.uploader
        return mavlink.MAVLink_mission_request_message(
            to.system, to.component, upload.awaited, self.mission_type
        )

    def _count_for(self, to: Sender) -> Message:
        return mavlink.MAVLink_mission_count_message(
            to.system, to.component, len(self.items), self.mission_type
        )

    def _denied(self, to: Sender) -> list[Message]:
        return [self._ack(to, mavlink.MAV_MISSION_DENIED)]

    def _ack(self, to: Sender, result: int) -> Message:
        return mavlink.MAVLink_mission_ack_message(to.system, to.component, result, self.mission_type)


class FenceStore(MissionStore):
    """A fence, which ArduPilot takes over only when it is whole and makes sense, unlike the other types."""

    def __init__(self) -> None:
        super().__init__(mavlink.MAV_MISSION_TYPE_FENCE, max_items=MAX_FENCE_ITEMS)
        self._incoming: list[MissionItem] = []

    def _make_room(self, _count: int) -> None:
        self._incoming = []

    def _store(self, item: MissionItem) -> None:
        self._incoming.append(item)

    def _complete(self) -> int:
        if not polygons_are_whole(self._incoming):
            return int(mavlink.MAV_MISSION_ERROR)
        self.items = self._incoming
        return int(mavlink.MAV_MISSION_ACCEPTED)
