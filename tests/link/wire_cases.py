"""Wires of memory, for links that are tested without a network."""

from __future__ import annotations

import asyncio
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from malipp_field.clock import SimClock
from malipp_field.link import Channel, Links, SigningKey, VehicleLink
from malipp_field.link.wires import Address, Ends
from malipp_field.mission.link_url import LinkUrl, parse_link_url

START_S = 1_700_000_000.0
HEARTBEAT = mavlink.MAVLink_heartbeat_message(10, 3, 0, 4, 3, 3)


class MemoryWire:
    """Keeps what is written, in order, with where it was to go."""

    def __init__(self, ends: Ends) -> None:
        self.ends = ends
        self.ready = True
        self.closed = False
        self.written: list[tuple[bytes, Address | None]] = []

    def write(self, data: bytes, to: Address | None) -> None:
        assert not self.closed
        self.written.append((data, to))

    def close(self) -> None:
        self.closed = True

    def drain(self) -> None:
        self.ready = True
        self.ends.ready()

    @property
    def messages(self) -> list[Any]:
        return [mavlink.MAVLink(None).decode(bytearray(data)) for data, _ in self.written]


class MemoryWires:
    """Opens memory wires, or fails as often as it is told to."""

    def __init__(self, clock: SimClock) -> None:
        self._clock = clock
        self.failures = 0
        self.tries_s: list[float] = []
        self.wires: list[MemoryWire] = []

    async def open(self, url: LinkUrl, ends: Ends) -> MemoryWire:
        self.tries_s.append(self._clock.now_s())
        if self.failures:
            self.failures -= 1
            raise ConnectionRefusedError(111, "Connection refused")
        self.wires.append(MemoryWire(ends))
        return self.wires[-1]

    @property
    def last(self) -> MemoryWire:
        return self.wires[-1]


class Ground:
    """A ground station on memory wires, with vehicles that are made of frames."""

    def __init__(self, url: str = "tcp:radio:5760") -> None:
        self.clock = SimClock(START_S)
        self.opener = MemoryWires(self.clock)
        self.links = Links(self.clock, self.opener.open, seed=1)
        self.url = parse_link_url(url)
        self.heard: list[tuple[int, str]] = []
        self.events: list[str] = []

    async def channel(
        self, system: int, key: SigningKey | None = None, skip: frozenset[int] = frozenset()
    ) -> Channel:
        return await self.links.open(
            VehicleLink(self.url, system, key=key),
            lambda message: self.heard.append((system, message.get_type())),
            lambda severity, text: self.events.append(f"{severity} {system} {text}"),
            skip,
        )

    async def live(self, duration_s: float) -> None:
        end_s = self.clock.now_s() + duration_s
        while self.clock.now_s() < end_s - 1e-6:
            self.clock.advance(0.05)
            for _ in range(4):
                await asyncio.sleep(0)


def said_by(system: int, message: Any = HEARTBEAT, component: int = 1) -> bytes:
    return bytes(message.pack(mavlink.MAVLink(None, srcSystem=system, srcComponent=component)))


def signed_by(secret: bytes, stamp: int, system: int = 7, message: Any = HEARTBEAT) -> bytes:
    packer = mavlink.MAVLink(None, srcSystem=system, srcComponent=1)
    packer.signing.secret_key, packer.signing.sign_outgoing = secret, True
    packer.signing.timestamp = stamp
    return bytes(message.pack(packer))
