"""MAVSDK, a client none of whose code is ours, uploads to and reads back from a simulated rover.

Over real UDP on loopback, at the pace of the wall clock: MAVSDK keeps its own time. It announces itself as
system 245, component 190.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest
from flight_cases import (
    HARDWARE,
    KEPT_BY_DELAY,
    Assignment,
    Operated,
    assert_flown,
    beside,
    fly,
)
from mavsdk.asyncio import ComponentType, Configuration, Mavsdk, System
from mavsdk.asyncio.plugins.action import ActionAsync
from mavsdk.asyncio.plugins.mission_raw import MissionRawAsync, MissionRawError
from mavsdk.asyncio.plugins.telemetry import TelemetryAsync
from mavsdk.plugins.mission_raw import MissionItem as RawItem
from mavsdk.plugins.mission_raw import MissionRawResult
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from sim_cases import action, numbered, site, waypoint

from malipp_field.clock import WallClock
from malipp_field.link.compare import differences
from malipp_field.sim import Fleet, RoverConfig
from malipp_field.sim.mission_store import Sender
from malipp_field.vehicle.items import MissionItem
from malipp_field.vehicle.layout import lay_out
from malipp_field.vehicle.steps import Action, Step

FOUND_WITHIN_S = 15.0
LIMIT_S = 60.0


def run(scenario: Callable[[Fleet, System, MissionRawAsync], Awaitable[None]]) -> None:
    """Run a scenario with MAVSDK connected to the scout; both are gone afterwards, whatever happens."""

    async def main() -> None:
        async with Fleet(site(), WallClock(), config=RoverConfig(ready_after_s=0.0)) as fleet:
            host, port = fleet.endpoints["scout"]
            ours = Configuration.create_with_component_type(ComponentType.GROUND_STATION)
            async with Mavsdk(ours) as sdk:
                await sdk.add_any_connection(f"udpout://{host}:{port}")
                system = await sdk.first_autopilot(timeout_s=FOUND_WITHIN_S)
                assert system is not None
                raw = MissionRawAsync(system)
                try:
                    await asyncio.wait_for(scenario(fleet, system, raw), LIMIT_S)
                finally:
                    raw.destroy()

    asyncio.run(main())


def mission(fleet: Fleet) -> list[MissionItem]:
    world = fleet.world
    return numbered(world, [
        waypoint(world, "a", hold_s=3.7), action(Action.COLLECT, 1, 32767), action(Action.WAIT, 1, 1),
        waypoint(world, "b"), action(Action.DROP, 2, 1), waypoint(world, "base"), action(Action.UNLOAD, 3, 2),
    ])  # fmt: skip


def raw_items(items: list[MissionItem]) -> list[Any]:
    """Return items as MAVSDK wants them: exactly one of them current."""
    return [RawItem(**(item._asdict() | {"current": int(item.seq == 0)}), mission_type=0) for item in items]


def place_and_params(item: Any) -> list[float]:
    return [item.param1, item.param2, item.param3, item.param4, item.x, item.y, item.z]


def test_mavsdk_takes_the_rover_for_what_it_claims_to_be() -> None:
    async def scenario(fleet: Fleet, system: System, raw: MissionRawAsync) -> None:
        assert await system.get_system_id() == 1
        assert await system.is_connected()
        assert Sender(245, 190) in fleet.rovers["scout"].peers
        assert (await system.autopilot_type()).name == "ARDUPILOT"
        assert (await system.vehicle_type()).name == "ROVER"

    run(scenario)


def test_mavsdk_uploads_and_reads_back_a_mission() -> None:
    async def scenario(fleet: Fleet, system: System, raw: MissionRawAsync) -> None:
        sent = mission(fleet)
        await raw.upload_mission(raw_items(sent))
        back = await raw.download_mission()
        assert [item.seq for item in back] == list(range(len(sent)))
        assert [item.command for item in back] == [item.command for item in sent]
        for got, item in zip(back[1:], sent[1:], strict=True):
            expected = item._replace(param1=float(int(item.param1)))  # a hold is kept in whole seconds
            assert place_and_params(got) == pytest.approx(place_and_params(expected), abs=1e-6)
            assert (got.autocontinue, got.frame) == (1, 3 if item.command == 16 else 0)
        home = fleet.rovers["scout"].autopilot.home_item()
        assert (back[0].x, back[0].y, back[0].z) == (home.x, home.y, home.z)
        assert [item.x for item in fleet.rovers["scout"].autopilot.store.items] == [item.x for item in back]

    run(scenario)


def test_mavsdk_replaces_a_mission_and_sees_the_refusal_that_mixes_two() -> None:
    async def scenario(fleet: Fleet, system: System, raw: MissionRawAsync) -> None:
        await raw.upload_mission(raw_items(mission(fleet)))
        shorter = numbered(fleet.world, [waypoint(fleet.world, node) for node in ("b", "a", "b")])
        await raw.upload_mission(raw_items(shorter))
        assert [item.x for item in await raw.download_mission()] == [item.x for item in shorter]
        bad = numbered(fleet.world, [waypoint(fleet.world, node) for node in ("base", "base", "base")])
        bad[2] = bad[2]._replace(param1=math.nan)
        with pytest.raises(MissionRawError) as refused:
            await raw.upload_mission(raw_items(bad))
        assert refused.value.result is MissionRawResult.INVALID_ARGUMENT
        mixed = [item.y for item in await raw.download_mission()]
        assert mixed == [bad[0].y, bad[1].y, shorter[2].y, shorter[3].y]

    run(scenario)


def test_mavsdk_is_denied_while_another_uploads() -> None:
    async def scenario(fleet: Fleet, system: System, raw: MissionRawAsync) -> None:
        await raw.upload_mission(raw_items(mission(fleet)))
        rover = fleet.rovers["scout"]
        begin = mavlink.MAVLink_mission_count_message(1, 1, 8)
        begin.pack(mavlink.MAVLink(None, srcSystem=255, srcComponent=190))
        rover.receive(begin, fleet.endpoints["carrier"], WallClock().now_s())
        with pytest.raises(MissionRawError) as denied:
            await raw.upload_mission(raw_items(mission(fleet)))
        assert denied.value.result is MissionRawResult.DENIED

    run(scenario)


def test_mavsdk_starts_the_mission_and_follows_it() -> None:
    async def scenario(fleet: Fleet, system: System, raw: MissionRawAsync) -> None:
        world, pilot = fleet.world, fleet.rovers["scout"].autopilot
        await raw.upload_mission(raw_items(numbered(world, [waypoint(world, "base"), waypoint(world, "a")])))
        assert pilot.arm()
        await raw.start_mission()
        assert pilot.mode == mavlink.ROVER_MODE_AUTO
        async for progress in raw.subscribe_mission_progress():
            if progress.current == 2:
                break
        await raw.pause_mission()
        assert pilot.mode == mavlink.ROVER_MODE_HOLD
        assert 0.0 < math.dist(pilot.position, (0.0, 0.0)) < 100.0

    run(scenario)


class Station(Operated):
    """MAVSDK with one vehicle and its exported `.plan`."""

    def __init__(self, told: Assignment, system: System) -> None:
        super().__init__(told.vehicle)
        self._told = told
        self.raw, self.action = MissionRawAsync(system), ActionAsync(system)
        self.telemetry = TelemetryAsync(system)

    async def upload(self) -> None:
        imported = await self.raw.import_qgroundcontrol_mission(str(self._told.file(".plan")))
        await self.raw.upload_mission(imported.mission_items)
        await self.raw.upload_geofence(imported.geofence_items)
        await self.raw.upload_rally_points(imported.rally_items)
        # Reading back is also how MAVSDK learns which items may be made current.
        back = [as_item(item) for item in await self.raw.download_mission()]
        assert differences(lay_out(self._told.vehicle).items, back) == []
        fence, rally = await self.raw.download_geofence(), await self.raw.download_rallypoints()
        assert [as_item(item)[-3:-1] for item in fence] == [
            as_item(item)[-3:-1] for item in imported.geofence_items
        ]
        assert (len(fence), len(rally)) == (3, 1)

    async def start(self) -> None:
        await self.action.arm()
        await self.raw.start_mission()

    async def release(self, gate: Step, item: int) -> bool:
        await self.raw.set_current_mission_item(item)
        return True

    async def listen(self) -> None:
        async for said in self.telemetry.subscribe_status_text():
            self.shows_text(said.text)

    async def follow(self) -> None:
        async for progress in self.raw.subscribe_mission_progress():
            self.shows_item(progress.current)

    def destroy(self) -> None:
        for plugin in (self.raw, self.action, self.telemetry):
            plugin.destroy()


@asynccontextmanager
async def station(told: Assignment) -> AsyncIterator[Station]:
    host, port = told.endpoint
    async with Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION)) as sdk:
        await sdk.add_any_connection(f"udpout://{host}:{port}")
        system = await sdk.first_autopilot(timeout_s=FOUND_WITHIN_S)
        assert system is not None
        client = Station(told, system)
        try:
            async with beside(client.listen()), beside(client.follow()):
                yield client
        finally:
            client.destroy()


def as_item(raw: Any) -> MissionItem:
    return MissionItem(*(getattr(raw, name) for name in MissionItem._fields))


@pytest.mark.parametrize("hardware", ["", HARDWARE], ids=["by script", "by hardware and hand"])
def test_mavsdk_uploads_the_exported_plans_and_sees_them_through(tmp_path: Path, hardware: str) -> None:
    assert_flown(fly(station, "plan", tmp_path, hardware))


def test_vehicles_that_keep_gates_by_time_pass_them_alone(tmp_path: Path) -> None:
    assert_flown(fly(station, "plan", tmp_path, KEPT_BY_DELAY), gates_by_time=3)
