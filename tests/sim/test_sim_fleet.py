"""The fleet on real UDP sockets, on loopback and free ports."""

from __future__ import annotations

import asyncio
import contextlib
import random
import socket
from collections.abc import AsyncIterator, Awaitable, Callable
from typing import Any, cast

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from sim_cases import START_S, action, item_int, numbered, site, waypoint

from malipp_field.clock import SimClock
from malipp_field.errors import LinkError, MalippError
from malipp_field.sim import Fleet, World
from malipp_field.sim.fleet import parse
from malipp_field.vehicle.steps import Action

LIMIT_S = 30.0


class Client(asyncio.DatagramProtocol):
    """A ground station on one socket, talking to one rover."""

    def __init__(self) -> None:
        self.heard: list[Any] = []
        self.mav = mavlink.MAVLink(None, srcSystem=255, srcComponent=190)
        self.arrived = asyncio.Event()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self.transport = cast(asyncio.DatagramTransport, transport)

    def datagram_received(self, data: bytes, addr: tuple[str, int]) -> None:
        self.heard += mavlink.MAVLink(None).parse_buffer(data)
        self.arrived.set()

    def send(self, message: Any) -> None:
        self.transport.sendto(message.pack(self.mav))

    async def until(self, condition: Callable[[Any], bool]) -> Any:
        """Return the first message from now on that meets the condition."""
        self.heard.clear()
        return await self.earlier_or_until(condition)

    async def earlier_or_until(self, condition: Callable[[Any], bool]) -> Any:
        while not (found := [m for m in self.heard if condition(m)]):
            self.arrived.clear()
            await asyncio.wait_for(self.arrived.wait(), LIMIT_S)
        return found[0]

    async def upload(self, items: list[Any], system: int) -> int:
        self.heard.clear()
        self.send(mavlink.MAVLink_mission_count_message(system, 1, len(items)))
        for item in items:
            await self.earlier_or_until(asks_for(item.seq))
            self.send(item_int(item, system=system))
        return int((await self.earlier_or_until(is_a("MISSION_ACK"))).type)


def asks_for(seq: int) -> Callable[[Any], bool]:
    return lambda message: bool(message.get_type() == "MISSION_REQUEST" and message.seq == seq)


def is_a(kind: str) -> Callable[[Any], bool]:
    return lambda message: bool(message.get_type() == kind)


@contextlib.asynccontextmanager
async def client_of(endpoint: tuple[str, int]) -> AsyncIterator[Client]:
    loop = asyncio.get_running_loop()
    transport, client = await loop.create_datagram_endpoint(Client, remote_addr=endpoint)
    try:
        yield client
    finally:
        transport.close()
        await asyncio.sleep(0)


def run(scenario: Callable[[Fleet, SimClock], Awaitable[None]], speed: float = 20.0) -> None:
    async def main() -> None:
        clock = SimClock(START_S, speed=speed)
        async with Fleet(site(), clock) as fleet:
            ticking = asyncio.create_task(clock.run())
            try:
                await asyncio.wait_for(scenario(fleet, clock), LIMIT_S)
            finally:
                ticking.cancel()

    asyncio.run(main())


def test_each_rover_has_its_own_port_and_system_id() -> None:
    async def scenario(fleet: Fleet, clock: SimClock) -> None:
        assert list(fleet.endpoints) == ["scout", "carrier"]
        for system, endpoint in enumerate(fleet.endpoints.values(), start=1):
            async with client_of(endpoint) as client:
                client.send(mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))
                heartbeat = await client.until(is_a("HEARTBEAT"))
                assert (heartbeat.get_srcSystem(), heartbeat.get_srcComponent()) == (system, 1)

    run(scenario)


def test_a_rover_says_nothing_to_nobody_and_everything_to_all_it_has_heard() -> None:
    async def scenario(fleet: Fleet, clock: SimClock) -> None:
        endpoint = fleet.endpoints["scout"]
        async with client_of(endpoint) as one, client_of(endpoint) as two, client_of(endpoint) as silent:
            for client in (one, two):
                client.send(mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))
            for client in (one, two):
                await client.until(is_a("HEARTBEAT"))
            assert not silent.heard

    run(scenario)


def test_malformed_bytes_do_not_stop_a_rover() -> None:
    async def scenario(fleet: Fleet, clock: SimClock) -> None:
        rng = random.Random(1)
        async with client_of(fleet.endpoints["scout"]) as client:
            good = mavlink.MAVLink_mission_count_message(1, 1, 3).pack(client.mav)
            for _ in range(200):
                client.transport.sendto(rng.randbytes(rng.randrange(1, 300)))
                broken = bytearray(good)
                broken[rng.randrange(len(broken))] ^= 1 << rng.randrange(8)
                client.transport.sendto(broken)
                client.transport.sendto(good[: rng.randrange(1, len(good))])
                await asyncio.sleep(0)  # let the rover read: a full socket buffer would drop what follows
            client.send(mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))
            await client.until(is_a("HEARTBEAT"))
            await client.until(is_a("HEARTBEAT"))

    run(scenario)


def test_half_a_message_spoils_none_after_it() -> None:
    mav = mavlink.MAVLink(None, srcSystem=255, srcComponent=190)
    whole = mavlink.MAVLink_mission_count_message(1, 1, 3).pack(mav)
    assert parse(whole[:9]) == []
    assert [m.count for m in parse(whole)] == [3]
    assert [m.count for m in parse(b"rubbish" + whole + whole)] == [3, 3]


def test_a_mission_is_driven_over_the_wire() -> None:
    async def scenario(fleet: Fleet, clock: SimClock) -> None:
        world: World = fleet.world
        items = numbered(world, [waypoint(world, "a"), action(Action.COLLECT, 1, 7), waypoint(world, "base")])
        async with client_of(fleet.endpoints["carrier"]) as client:
            assert await client.upload(items, system=2) == mavlink.MAV_MISSION_ACCEPTED
            await client.until(lambda m: m.get_type() == "EKF_STATUS_REPORT" and bool(m.flags & 16))
            for command, params in ((400, (1.0, 0.0)), (176, (1.0, 10.0))):
                client.send(
                    mavlink.MAVLink_command_long_message(2, 1, command, 0, *params, 0.0, 0.0, 0.0, 0.0, 0.0)
                )
                ack = await client.until(is_a("COMMAND_ACK"))
                assert (ack.command, ack.result) == (command, mavlink.MAV_RESULT_ACCEPTED)
            said = await client.until(lambda m: m.get_type() == "STATUSTEXT" and m.text.startswith("MLP"))
            assert said.text.startswith("MLP 1 collect 7 ok v=")
            assert world.on_board("carrier") == [7]

    run(scenario, speed=200.0)


def test_a_taken_port_is_an_error_that_leaves_nothing_open() -> None:
    async def main() -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
            taken.bind(("127.0.0.1", 0))
            fleet = Fleet(site(), SimClock(START_S), first_port=taken.getsockname()[1])
            with pytest.raises(LinkError, match="in use; choose another"):
                await fleet.__aenter__()
            assert fleet.endpoints == {}

    asyncio.run(main())


def test_parameters_of_the_simulated_autopilots_are_those_of_the_mission_file() -> None:
    given = "simulation: {parameters: {%s: 1}}\n"
    rovers = Fleet(site(given % "FS_GCS_ENABLE"), SimClock(START_S)).rovers
    assert {rover.parameters["FS_GCS_ENABLE"] for rover in rovers.values()} == {1.0}
    with pytest.raises(
        MalippError, match=r"simulation\.parameters: a simulated rover has no 'FS_GCS'; it has "
    ):
        Fleet(site(given % "FS_GCS"), SimClock(START_S))
