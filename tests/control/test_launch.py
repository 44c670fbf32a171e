"""What must be right before the first missions are sent."""

from __future__ import annotations

import asyncio
from typing import cast

from control_cases import drop_plan, relay_mission

from malipp_field.clock import SimClock
from malipp_field.control.dispatch import Dispatch
from malipp_field.control.launch import load_first
from malipp_field.control.tracks import Track
from malipp_field.mission.vehicles import VehicleSettings
from malipp_field.vehicle.compile import compile_plan
from malipp_field.vehicle.steps import VehicleMission


class Deaf:
    """Keeps what it is given to load."""

    def __init__(self) -> None:
        self.loads: list[dict[str, VehicleMission]] = []

    async def load(self, missions: dict[str, VehicleMission]) -> dict[str, str]:
        self.loads.append(missions)
        return {}


def load(settings: VehicleSettings) -> tuple[list[dict[str, VehicleMission]], dict[str, str]]:
    mission, plan, dispatch = relay_mission(), drop_plan(), Deaf()
    mission = mission.model_copy(update={"vehicles": {"carrier": settings}})
    missions = compile_plan(mission, plan, run=77).missions
    tracks = {robot: Track(mission, plan.robot(robot), found) for robot, found in missions.items()}
    first = load_first(mission, plan, tracks, cast(Dispatch, dispatch), SimClock(1000.0))
    _, refusals = asyncio.run(first)
    return dispatch.loads, refusals


def test_nothing_is_sent_where_the_check_finds_an_error() -> None:
    loads, refusals = load(VehicleSettings(max_items=3))
    assert loads == []
    assert refusals.keys() == {"carrier"}
    assert refusals["carrier"].startswith("not to be uploaded: ")


def test_where_it_finds_none_all_are_sent() -> None:
    for settings in (VehicleSettings(), VehicleSettings(gate="time")):
        (loaded,), refusals = load(settings)
        assert refusals == {}
        assert {mission.run for mission in loaded.values()} == {77}
