"""The agent between real sockets: simulated rovers on UDP, Zenoh, and a clock far faster than the wall's."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Callable
from contextlib import AsyncExitStack
from itertools import pairwise

import pytest
from agent_cases import MISSION, Yard

from malipp_field.bus import (
    Bus,
    Command,
    Confirmation,
    Hold,
    Load,
    Release,
    Reply,
    Start,
    Telemetry,
    vehicle_key,
)
from malipp_field.clock import SimClock
from malipp_field.link import Agent, Links, SigningKey, VehicleLink
from malipp_field.mission.link_url import parse_link_url
from malipp_field.sim import Fleet

WORK = ("drive a", "collect a 1", "wait a 9", "drive b", "collect b 2", "drive base", "unload base 1",
        "unload base 2")  # fmt: skip


class Listener:
    """What the agent says, and waiting for it."""

    def __init__(self) -> None:
        self.telemetry: list[Telemetry] = []
        self.confirmations: list[Confirmation] = []
        self._news = asyncio.Event()

    def hear(self, key: str, message: Telemetry | Confirmation) -> None:
        if isinstance(message, Telemetry):
            self.telemetry.append(message)
        else:
            self.confirmations.append(message)
        self._news.set()

    async def until(self, condition: Callable[[], bool]) -> None:
        while not condition():
            self._news.clear()
            await self._news.wait()

    def at(self, uid: str) -> bool:
        return self.telemetry[-1].step_uid == uid


async def scene(bus: Bus, heard: Listener, clock: SimClock) -> None:
    async def order(order: Load | Start | Release | Hold) -> Reply:
        key = vehicle_key("yard", "scout", "command")
        return await bus.request(key, Command(time_s=clock.now_s(), order=order), 30.0)

    await heard.until(lambda: bool(heard.telemetry))
    yard = Yard()
    assert (await order(Load(mission=yard.mission(*WORK)))).ok
    assert (await order(Start())).ok
    await heard.until(lambda: heard.at("wait a 9"))
    assert (await order(Hold(reason="a look round"))).ok
    assert (await order(Load(mission=yard.mission(*WORK, version=2), resume=True))).ok
    await heard.until(lambda: heard.at("wait a 9"))
    assert (await order(Release(uid="wait a 9"))).ok
    await heard.until(lambda: heard.telemetry[-1].finished and len(heard.confirmations) == 4)


async def end_to_end(speed: float, secret: bytes | None) -> tuple[Listener, Fleet]:
    clock, heard = SimClock(start_s=1.7e9, speed=speed), Listener()
    hub = f"tcp/127.0.0.1:{free_port()}"
    async with AsyncExitStack() as stack:
        keys = {} if secret is None else {"scout": secret}
        fleet = await stack.enter_async_context(Fleet(MISSION, clock, keys=keys))
        ours = await stack.enter_async_context(Bus(listen=hub))
        theirs = await stack.enter_async_context(Bus(connect=(hub,)))
        await ours.subscribe(vehicle_key("yard", "*", "telemetry"), Telemetry, heard.hear)
        await ours.subscribe(vehicle_key("yard", "*", "confirmation"), Confirmation, heard.hear)
        links = await stack.enter_async_context(Links(clock))
        key = None if secret is None else SigningKey(secret)
        where = VehicleLink(parse_link_url(fleet.links["scout"]), 1, key=key)
        agent = Agent("yard", "scout", where, links, theirs, clock)
        services = [asyncio.ensure_future(agent.run()), asyncio.ensure_future(clock.run())]
        try:
            await scene(ours, heard, clock)
        finally:
            for service in services:
                service.cancel()
            await asyncio.gather(*services, return_exceptions=True)
    return heard, fleet


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@pytest.mark.parametrize("secret", [None, bytes(range(32))])
def test_load_start_replan_release_and_finish_over_udp_and_zenoh(secret: bytes | None) -> None:
    heard, fleet = asyncio.run(asyncio.wait_for(end_to_end(20.0, secret), 60.0))
    assert [(c.number, c.uid) for c in heard.confirmations] == [
        (1, "collect a 1"), (2, "collect b 2"), (3, "unload base 1"), (4, "unload base 2"),
    ]  # fmt: skip
    assert fleet.world.delivered() == {1: "base", 2: "base"}
    telemetry = heard.telemetry
    assert telemetry[-1].mission_version == 2
    assert telemetry[-1].energy_used_j > 0.0
    gaps = [b.time_s - a.time_s for a, b in pairwise(telemetry)]
    assert min(gaps) > 0.15  # 5 Hz of the mission's clock, at most
