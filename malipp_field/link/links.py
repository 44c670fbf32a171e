"""Links to vehicles: one wire for each MAVLink URL, opened once, mended when it breaks, shared by vehicles.

What arrives is routed by system id to the `Channel` of a vehicle, which checks signatures and decodes what
somebody wants. What is sent waits its turn where the wire is slow, and is forgotten where it is broken: an
order that is carried out minutes later is worse than none.
"""

from __future__ import annotations

import asyncio
import logging
import random
from dataclasses import dataclass
from types import TracebackType
from typing import Literal

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from malipp_field.clock import Clock
from malipp_field.errors import LinkError
from malipp_field.link.channels import Channel, OnEvent, OnMessage, VehicleLink
from malipp_field.link.exchange import MavMessage
from malipp_field.link.frames import Frame, FrameReader, StreamReader
from malipp_field.link.outbox import Outbox
from malipp_field.link.signing import Refusal
from malipp_field.link.wires import Address, Ends, OpenWire, Wire, fault_in_words, open_wire
from malipp_field.mission.link_url import LinkUrl

FIRST_RETRY_S = 0.5
LAST_RETRY_S = 30.0
ROUTE_LOST_S = 10.0
"""After so long without a word, a rightly signed but old frame may show where a vehicle is: it learns the
time by hearing us."""

log = logging.getLogger(__name__)


class Backoff:
    """How long to wait before the next try: longer each time, by chance a little less, up to a limit.

    Parameters
    ----------
    seed
        Of the chance, which keeps many from trying at the same moments; None for another each time.
    """

    def __init__(self, seed: int | None = None) -> None:
        self._random = random.Random(seed)  # noqa: S311 - not a secret
        self._limit_s = FIRST_RETRY_S

    def next_s(self) -> float:
        """Return the seconds to wait now."""
        limit_s, self._limit_s = self._limit_s, min(2.0 * self._limit_s, LAST_RETRY_S)
        return limit_s * self._random.uniform(0.5, 1.0)

    def reset(self) -> None:
        """Begin again with short waits."""
        self._limit_s = FIRST_RETRY_S


@dataclass
class _Route:
    """Where a system of a listening link is, and when something new was heard from there."""

    address: Address
    heard_s: float


class Link:
    """One wire and all that share it; made by `Links`.

    Attributes
    ----------
    reader : FrameReader
        Counts what was malformed or unknown.
    strangers : int
        Frames of systems that nobody asked for.
    unsent : int
        Messages not sent because the wire was broken, or nobody knows where their vehicle is.
    outbox : Outbox
        What waits for a slow wire.
    """

    def __init__(self, url: LinkUrl, clock: Clock, wires: OpenWire, seed: int | None) -> None:
        self._url, self._clock, self._open_wire = url, clock, wires
        self._sent = 0
        self._backoff = Backoff(seed)
        self._wire: Wire | None = None
        self._broken = asyncio.Event()
        self._mending: asyncio.Task[None] | None = None
        self._opening = asyncio.Lock()
        self._channels: dict[int, list[Channel]] = {}
        self._routes: dict[int, _Route] = {}
        self._ends = Ends(self._received, self._send_on, self._lost)
        datagrams = url.scheme in ("udpin", "udpout")
        self.reader = FrameReader() if datagrams else StreamReader()
        self.outbox: Outbox[Channel] = Outbox()
        self.strangers = self.unsent = 0

    async def open(self) -> None:
        """Open the wire, unless somebody has; from then on it is opened again whenever it breaks."""
        async with self._opening:
            if self._mending is None:
                try:
                    self._wire = await self._open_wire(self._url, self._ends)
                except OSError as fault:
                    raise LinkError(f"{self._url}: {fault_in_words(fault)}") from None
                self._mending = asyncio.create_task(self._mend(), name=f"link {self._url}")

    def close(self) -> None:
        """Close the wire for good."""
        if self._mending is not None:
            self._mending.cancel()
            self._mending = None
        self._broken.clear()
        self._drop_wire()

    @property
    def channels(self) -> list[Channel]:
        """All that share the wire."""
        return [channel for sharing in self._channels.values() for channel in sharing]

    def attach(self, channel: Channel) -> None:
        """Let a channel hear its system."""
        self._channels.setdefault(channel.where.system_id, []).append(channel)

    def detach(self, channel: Channel) -> None:
        """Let a channel hear no more; the last one closes the link."""
        sharing = self._channels.get(channel.where.system_id, [])
        if channel in sharing:
            sharing.remove(channel)
        if not self.channels:
            self.close()

    # Sending.

    def send(self, channel: Channel, message: MavMessage) -> None:
        """Send a message of a channel, now or as soon as the wire takes it."""
        if self._wire is None:
            self.unsent += 1
        elif self._wire.ready and not self.outbox:
            self._write(channel, message)
        else:
            self.outbox.put(channel, message, self._clock.now_s())
            if self.outbox.full:
                self._lost("it takes nothing any more")

    def _send_on(self) -> None:
        now_s = self._clock.now_s()
        while self._wire is not None and self._wire.ready and (first := self.outbox.take(now_s)):
            self._write(*first)

    def _write(self, channel: Channel, message: MavMessage) -> None:
        route = self._routes.get(channel.where.system_id)
        if self._wire is None or (route is None and self._url.scheme == "udpin"):
            self.unsent += 1
            return
        frame = channel.pack(message, self._sent % 256, self._clock.now_s())
        self._sent += 1
        self._wire.write(frame, None if route is None else route.address)

    # Receiving.

    def _received(self, data: bytes, address: Address | None) -> None:
        self._backoff.reset()
        now_s = self._clock.now_s()
        for frame in self.reader.feed(data):
            channels = self._channels.get(frame.system) or self._overhearing(frame)
            if not channels:
                self.strangers += 1
                continue
            for channel in list(channels):
                refusal = channel.take(frame, now_s)
                if address is not None and channel.vouches(frame):
                    self._learn_route(frame.system, address, refusal, now_s)

    def _overhearing(self, frame: Frame) -> list[Channel]:
        """Return whom a frame concerns that is of no vehicle."""
        if frame.message_id == mavlink.MAVLINK_MSG_ID_RADIO_STATUS:
            return self.channels  # the radio they share speaks as a system of its own
        if frame.message_id == mavlink.MAVLINK_MSG_ID_HEARTBEAT:
            # Another ground station that speaks as we do feeds the vehicles' failsafe as we do.
            return [channel for channel in self.channels if channel.where.own[0] == frame.system]
        return []

    def _learn_route(self, system: int, address: Address, refusal: Refusal | None, now_s: float) -> None:
        """Answer where a system was last heard; where only old words of it are heard, there."""
        route = self._routes.get(system)
        if refusal is None:
            self._routes[system] = _Route(address, now_s)
        elif refusal in ("replayed", "stale") and (route is None or now_s > route.heard_s + ROUTE_LOST_S):
            self._routes[system] = _Route(address, -ROUTE_LOST_S if route is None else route.heard_s)

    # Breaking and mending.

    def _lost(self, why: str) -> None:
        if not self._broken.is_set():
            self._broken.set()
            self._drop_wire()
            self._tell("error", f"link: {self._url} is lost ({why}); trying again")

    def _drop_wire(self) -> None:
        if self._wire is not None:
            self._wire.close()
            self._wire = None
        self.unsent += self.outbox.clear()
        self.reader.break_off()

    async def _mend(self) -> None:
        while True:
            await self._broken.wait()
            self._drop_wire()  # one that broke before it was ours
            await self._clock.sleep(self._backoff.next_s())
            self._broken.clear()
            try:
                self._wire = await self._open_wire(self._url, self._ends)
            except OSError as fault:
                log.info("%s: %s", self._url, fault_in_words(fault))
                self._broken.set()
            else:
                self._tell("info", f"link: {self._url} is back")

    def _tell(self, severity: Literal["info", "error"], text: str) -> None:
        for channel in self.channels:
            channel.on_event(severity, text)


class Links:
    """All links of one ground station; use as an async context manager.

    Parameters
    ----------
    clock
        Waiting and timestamps are of this clock.
    wires
        Opens wires.
    seed
        See `Backoff`.
    """

    def __init__(
        self,
        clock: Clock,
        wires: OpenWire = open_wire,
        seed: int | None = None,
    ) -> None:
        self._clock, self._open_wire, self._seed = clock, wires, seed
        self._links: dict[LinkUrl, Link] = {}

    async def __aenter__(self) -> Links:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, fault: BaseException | None, trace: TracebackType | None
    ) -> None:
        for link in self._links.values():
            link.close()
        self._links.clear()
        await asyncio.sleep(0)  # lets sockets close

    async def open(
        self,
        where: VehicleLink,
        on_message: OnMessage,
        on_event: OnEvent,
        skip: frozenset[int] = frozenset(),
    ) -> Channel:
        """Open a vehicle's channel, and the wire of its link where that is not open yet.

        Parameters
        ----------
        where
            How the vehicle is reached.
        on_message
            Called in the event loop for every message of the vehicle, of the radio of its link, and for
            heartbeats of other ground stations that have our system id.
        on_event
            Called when the link is lost, when it is back, and when frames are refused.
        skip
            Ids of messages that nobody wants.

        Raises
        ------
        LinkError
            When the wire cannot be opened now. One that breaks later is opened again.
        """
        link = self._links.get(where.url)
        if link is None:
            link = self._links[where.url] = Link(where.url, self._clock, self._open_wire, self._seed)
        await link.open()
        channel = Channel(link, where, on_message, on_event, skip)
        link.attach(channel)
        return channel
