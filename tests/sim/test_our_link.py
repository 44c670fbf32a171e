"""Our own link drives the missions to their end, on the clock and the sockets the other clients have."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest
from flight_cases import HARDWARE, KEPT_BY_SCRIPT, Assignment, Done, assert_flown, beside, fly

from malipp_field.bus.messages import (
    Command,
    Confirm,
    Confirmation,
    Load,
    Message,
    Order,
    Release,
    Reply,
    Start,
)
from malipp_field.link import Agent, Links, VehicleLink
from malipp_field.mission.link_url import LinkUrl
from malipp_field.vehicle.steps import Step


class Station:
    """An agent, and in place of the bus whoever gives it orders."""

    def __init__(self, told: Assignment) -> None:
        self._told = told
        self._confirmed: Done = set()
        self._handler: asyncio.Future[Callable[[Any], Awaitable[Reply]]] = asyncio.Future()

    def publish(self, key: str, message: Message) -> None:
        if isinstance(message, Confirmation) and message.ok:
            self._confirmed.add((message.action, message.tag))

    async def serve(self, key: str, kind: type[Message], handler: Callable[[Any], Awaitable[Reply]]) -> None:
        self._handler.set_result(handler)

    async def present(self, key: str) -> None:
        """Nobody looks."""

    def confirmed(self) -> Done:
        return set(self._confirmed)

    async def upload(self) -> None:
        assert (await self._order(Load(mission=self._told.vehicle))).ok

    async def start(self) -> None:
        assert (await self._order(Start())).ok

    async def release(self, gate: Step, item: int) -> bool:
        """It is the agent's to say whether the vehicle is known to be there already."""
        return (await self._order(Release(uid=gate.uid))).ok

    async def judge(self, step: Step, item: int | None) -> bool:
        return (await self._order(Confirm(uid=step.uid))).ok

    async def _order(self, order: Order) -> Reply:
        handler = await self._handler
        return await handler(Command(time_s=self._told.clock.now_s(), order=order))


@asynccontextmanager
async def station(told: Assignment) -> AsyncIterator[Station]:
    client = Station(told)
    where = VehicleLink(LinkUrl("udpout", *told.endpoint), told.system_id)
    async with Links(told.clock) as links:
        agent = Agent(told.mission.name, told.vehicle.robot, where, links, client, told.clock)
        async with beside(agent.run()):
            yield client


@pytest.mark.parametrize("hardware", ["", HARDWARE], ids=["by script", "by hardware and hand"])
def test_our_link_uploads_the_compiled_missions_and_sees_them_through(tmp_path: Path, hardware: str) -> None:
    assert_flown(fly(station, "plan", tmp_path, hardware))


def test_vehicles_that_keep_gates_by_time_pass_them_alone(tmp_path: Path) -> None:
    assert_flown(fly(station, "plan", tmp_path, KEPT_BY_SCRIPT), gates_by_time=3)
