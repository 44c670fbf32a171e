"""A mission uploaded and read back by two clients, ours and MAVSDK, and how long each takes."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

from mavsdk.asyncio import ComponentType, Configuration, Mavsdk
from mavsdk.asyncio.plugins.mission_raw import MissionRawAsync, MissionRawError
from mavsdk.plugins.mission_raw import MissionItem as RawItem

from malipp_field.clock import WallClock
from malipp_field.errors import LinkError
from malipp_field.link import Channel, Links, VehicleLink
from malipp_field.link.compare import differences
from malipp_field.link.contact import Contact
from malipp_field.link.mission_protocol import MissionUpload
from malipp_field.mission.link_url import parse_link_url
from malipp_field.vehicle.items import (
    MAV_CMD_NAV_SCRIPT_TIME,
    MAV_CMD_NAV_WAYPOINT,
    MissionItem,
    item_at,
    item_without_place,
)

HOST = "127.0.0.1"
FOUND_WITHIN_S = 60.0
GIVES_UP_S = 900.0
"""Neither client has been seen to need as long."""


@dataclass(frozen=True)
class Transfer:
    """One upload and read-back; seconds are of the wall, up to the failure where there is one."""

    client: str
    link: str
    upload_s: float
    read_back_s: float
    processor_s: float
    failure: str = ""

    @property
    def total_s(self) -> float:
        """Seconds from the first message to the last item read back."""
        return self.upload_s + self.read_back_s


def mission_of(count: int) -> list[MissionItem]:
    """Return a mission of so many items with home: waypoints and payload actions by turns."""
    items = [item_at(0, MAV_CMD_NAV_WAYPOINT, 1.0, 1.0)]
    for seq in range(1, count):
        place = item_at(seq, MAV_CMD_NAV_WAYPOINT, 1.0 + seq * 1e-5, 1.0)
        action = item_without_place(seq, MAV_CMD_NAV_SCRIPT_TIME, 2.0, 0.0, float(seq), 1.0, x=seq)
        items.append(place if seq % 2 else action)
    return items


async def by_us(port: int, system_id: int, items: Sequence[MissionItem], link: str) -> Transfer:
    """Upload and read back as `malipp upload` does."""
    clock = WallClock()
    where = VehicleLink(parse_link_url(f"udpout:{HOST}:{port}"), system_id)
    back: list[MissionItem] = []
    async with Links(clock) as links:

        def channel(heard: Callable[[Any], None]) -> Awaitable[Channel]:
            return links.open(where, heard, lambda _severity, _text: None)

        async with Contact((system_id, where.component_id), channel, clock) as contact:
            driver, vehicle = contact.driver, contact.driver.vehicle
            assert await driver.until(lambda: vehicle.link_ok(clock.now_s()), FOUND_WITHIN_S)

            async def transfer(stages: _Stages) -> None:
                await driver.run(MissionUpload(items, *vehicle.address))
                stages.next()
                back.extend(await driver.download())

            result = await _timed("malipp-field", link, transfer, LinkError)
    assert result.failure or differences(items, back) == []
    return result


async def by_mavsdk(port: int, _system_id: int, items: Sequence[MissionItem], link: str) -> Transfer:
    """Upload and read back with MAVSDK."""
    raw_items = [
        RawItem(**(item._asdict() | {"current": int(item.seq == 0)}), mission_type=0) for item in items
    ]
    async with Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION)) as sdk:
        await sdk.add_any_connection(f"udpout://{HOST}:{port}")
        system = await sdk.first_autopilot(timeout_s=FOUND_WITHIN_S)
        assert system is not None
        raw = MissionRawAsync(system)
        try:

            async def transfer(stages: _Stages) -> None:
                await raw.upload_mission(raw_items)
                stages.next()
                assert len(await raw.download_mission()) == len(items)

            return await _timed("MAVSDK", link, transfer, MissionRawError)
        finally:
            raw.destroy()


class _Stages:
    """Wall seconds of upload and read-back."""

    def __init__(self) -> None:
        self.began_s = [time.perf_counter()]

    def next(self) -> None:
        self.began_s.append(time.perf_counter())


async def _timed(
    client: str, link: str, transfer: Callable[[_Stages], Awaitable[None]], fault: type[Exception]
) -> Transfer:
    stages, processor_s, failure = _Stages(), time.process_time(), ""
    try:
        async with asyncio.timeout(GIVES_UP_S):
            await transfer(stages)
    except (fault, TimeoutError) as gave_up:
        stage = "upload" if len(stages.began_s) == 1 else "read-back"
        reason = str(gave_up) or type(gave_up).__name__
        failure = f"{stage}: {reason.partition(';')[0]}"  # MAVSDK goes on with all its arguments
    stages.next()
    upload_s, read_back_s = (*(after - before for before, after in pairwise(stages.began_s)), 0.0)[:2]
    return Transfer(client, link, upload_s, read_back_s, time.process_time() - processor_s, failure)
