"""The driver does not add waiting of its own to what the vehicle and the link take."""

from __future__ import annotations

import asyncio
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from malipp_field.clock import SimClock
from malipp_field.link.driver import Driver
from malipp_field.link.vehicle import Vehicle
from malipp_field.sim.mission_store import MissionStore, Sender
from malipp_field.vehicle.items import MissionItem, item_at

START_S = 1_700_000_000.0
GROUND = Sender(255, 190)
ITEMS = [item_at(seq, 16, 50.0 + seq * 1e-4, 8.0) for seq in range(20)]


def home() -> MissionItem:
    return ITEMS[0]


def test_a_mission_is_put_and_read_back_at_the_pace_of_the_vehicle() -> None:
    """No time passes on this clock: whoever waited for a tick would wait for ever."""

    async def main() -> None:
        loop, clock, store = asyncio.get_running_loop(), SimClock(START_S), MissionStore(home=home)
        packer, parser = mavlink.MAVLink(None, srcSystem=1, srcComponent=1), mavlink.MAVLink(None)

        def send(message: Any) -> None:
            for answer in store.receive(message, GROUND, clock.now_s()):
                arrived = parser.parse_buffer(answer.pack(packer))[0]
                loop.call_soon(driver.receive, arrived, clock.now_s())

        driver = Driver(Vehicle(1), send, clock)
        told: list[tuple[str, int, int]] = []
        async with asyncio.timeout(30.0):
            await driver.put(ITEMS, on_progress=lambda *words: told.append(words))
        assert [item.x for item in store.items] == [item.x for item in ITEMS]
        assert told == [("upload", 20, 20), ("read back", 20, 20)]

    asyncio.run(main())
