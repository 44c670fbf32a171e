"""All rovers of a mission on UDP sockets: the thin shell around `Rover`."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from types import TracebackType
from typing import Any, cast

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from malipp_field.clock import Clock
from malipp_field.errors import LinkError
from malipp_field.mission import Mission
from malipp_field.sim.autopilot import RoverConfig
from malipp_field.sim.rover import Rover
from malipp_field.sim.signing import RadioSigning, ticks
from malipp_field.sim.world import World

Address = tuple[str, int]

TICK_S = 0.05
"""Simulated seconds between two looks at the world; motion is exact whatever it is."""
PEER_TIMEOUT_S = 10.0
"""Wall seconds after which a silent peer hears no more."""


class Fleet:
    """The simulated team, while the context lasts.

    Parameters
    ----------
    mission
        Robots get the MAVLink addresses that it gives them.
    clock
        The vehicles' time.
    host
        Address to listen on.
    first_port
        The first robot's UDP port, the others follow on; 0 takes any free ones.
    config
        See `RoverConfig`.
    keys
        MAVLink 2 signing keys, 32 bytes each, by robot; the others sign nothing.

    Attributes
    ----------
    endpoints : dict of str to (host, port)
        Where each robot listens, by robot id.
    rovers : dict of str to Rover
        By robot id.
    world : World
        The truth.

    Raises
    ------
    OSError
        On entering, when a port is taken.
    """

    def __init__(
        self,
        mission: Mission,
        clock: Clock,
        host: str = "127.0.0.1",
        first_port: int = 0,
        config: RoverConfig | None = None,
        keys: Mapping[str, bytes] | None = None,
    ) -> None:
        self._mission, self._keys = mission, keys or {}
        self._clock, self._host, self._first_port = clock, host, first_port
        self.world = World(mission)
        self.endpoints: dict[str, Address] = {}
        self.rovers = {
            robot.id: Rover(
                robot.id, self.world, mission.vehicle(robot.id).system_id or 0, clock.now_s(), config
            )
            for robot in mission.team.robots
        }
        self._transports: list[asyncio.DatagramTransport] = []
        self._tasks: list[asyncio.Task[None]] = []

    @property
    def links(self) -> dict[str, str]:
        """The MAVLink URL that reaches each robot, by robot id."""
        return {robot: f"udpout:{host}:{port}" for robot, (host, port) in self.endpoints.items()}

    async def __aenter__(self) -> Fleet:
        try:
            for offset, (robot_id, rover) in enumerate(self.rovers.items()):
                await self._open(robot_id, rover, self._first_port + offset if self._first_port else 0)
        except BaseException:
            await self._close()
            raise
        return self

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        fault: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        await self._close()

    async def _open(self, robot_id: str, rover: Rover, port: int) -> None:
        loop = asyncio.get_running_loop()
        component_id = self._mission.vehicle(robot_id).component_id
        try:
            transport, radio = await loop.create_datagram_endpoint(
                lambda: _Radio(rover, self._clock, component_id, self._keys.get(robot_id)),
                local_addr=(self._host, port),
            )
        except OSError as fault:
            raise LinkError(
                f"{robot_id}: UDP port {port} on {self._host} cannot be used: {fault.strerror}; "
                "choose another"
            ) from None
        self._transports.append(transport)
        self.endpoints[robot_id] = transport.get_extra_info("sockname")[:2]
        self._tasks.append(asyncio.create_task(self._live(radio), name=f"rover {robot_id}"))

    async def _live(self, radio: _Radio) -> None:
        while True:
            radio.step()
            await self._clock.sleep(TICK_S)

    async def _close(self) -> None:
        for task in self._tasks:
            task.cancel()
        outcomes = await asyncio.gather(*self._tasks, return_exceptions=True)
        for transport in self._transports:
            transport.close()
        self._tasks, self._transports = [], []
        await asyncio.sleep(0)  # lets the transports close their sockets
        for outcome in outcomes:
            if isinstance(outcome, Exception):
                raise outcome


class _Radio(asyncio.DatagramProtocol):
    """Bytes to messages and back, for one rover."""

    def __init__(self, rover: Rover, clock: Clock, component_id: int, secret: bytes | None) -> None:
        self._rover, self._clock = rover, clock
        self._signing = RadioSigning(secret, ticks(clock.now_s()))
        self._heard_s: dict[Address, float] = {}
        self._packer = mavlink.MAVLink(None, srcSystem=rover.system_id, srcComponent=component_id)
        self._transport: asyncio.DatagramTransport | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast(asyncio.DatagramTransport, transport)

    def datagram_received(self, data: bytes, addr: Address) -> None:
        messages = [message for message in parse(data) if self._signing.accepts(message)]
        if messages:
            self._heard_s[addr] = asyncio.get_running_loop().time()
        for message in messages:
            if message.get_msgId() == mavlink.MAVLINK_MSG_ID_SETUP_SIGNING:
                self._set_up_signing(message)
            else:
                self._rover.receive(message, addr, self._clock.now_s())
        self._send()

    def _set_up_signing(self, message: Any) -> None:
        """Take on another key, which ArduPilot does only while it is disarmed, and without an answer."""
        if message.target_system == self._rover.system_id and not self._rover.autopilot.armed:
            self._signing.set_up(message)

    def error_received(self, exc: Exception) -> None:
        """Nobody listens at a peer's address any more: it will be forgotten in time."""

    def step(self) -> None:
        self._rover.step(self._clock.now_s())
        self._send()

    def _send(self) -> None:
        outbox, self._rover.outbox = self._rover.outbox, []
        if self._transport is None or self._transport.is_closing():
            return
        now_s = asyncio.get_running_loop().time()
        self._heard_s = {
            p: heard_s for p, heard_s in self._heard_s.items() if now_s - heard_s <= PEER_TIMEOUT_S
        }
        for peer, message in outbox:
            to = list(self._heard_s) if peer is None else [cast(Address, peer)]
            if to:
                self._signing.prepare(self._packer)
                packet = message.pack(self._packer)
                self._packer.seq = (self._packer.seq + 1) % 256
                for address in to:
                    self._transport.sendto(packet, address)


def parse(datagram: bytes) -> list[Any]:
    """Return the MAVLink messages in a datagram; what is malformed in it is passed over.

    Each datagram gets a parser of its own, so one that ends in the middle of a message spoils no other.
    """
    parser = mavlink.MAVLink(None)
    parser.robust_parsing = True
    found = parser.parse_buffer(datagram) or []
    return [m for m in found if m.get_type() != "BAD_DATA" and not m.get_type().startswith("UNKNOWN_")]
