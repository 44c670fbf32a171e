"""MAVProxy, an operator's ground station, drives the exported missions to their end."""

from __future__ import annotations

import asyncio
import os
from pathlib import Path

import pytest
from flight_cases import (
    HARDWARE,
    KEPT_BY_DELAY,
    KEPT_BY_SCRIPT,
    START_S,
    Assignment,
    assert_flown,
    corridor,
    fly,
)
from mavproxy_client import mavproxy

from malipp_field.clock import SimClock
from malipp_field.vehicle.compile import compile_plan


@pytest.mark.parametrize("hardware", ["", HARDWARE], ids=["by script", "by hardware and hand"])
def test_mavproxy_uploads_the_exported_missions_and_sees_them_through(tmp_path: Path, hardware: str) -> None:
    assert_flown(fly(mavproxy, "wpl", tmp_path, hardware))


@pytest.mark.parametrize("gates", [KEPT_BY_SCRIPT, KEPT_BY_DELAY], ids=["by script", "by NAV_DELAY"])
def test_vehicles_that_keep_gates_by_time_pass_them_alone(tmp_path: Path, gates: str) -> None:
    assert_flown(fly(mavproxy, "wpl", tmp_path, gates), gates_by_time=3)


def test_nothing_of_mavproxy_is_left_after_a_failure(tmp_path: Path) -> None:
    mission, plan = corridor()
    vehicle = compile_plan(mission, plan).missions["scout"]
    nobody_there = ("127.0.0.1", 9)
    told = Assignment(mission, vehicle, nobody_there, 1, tmp_path, SimClock(START_S))

    async def fail() -> None:
        async with mavproxy(told) as client:
            groups.append(client.group)
            await client.heard("Waiting for heartbeat")
            raise ValueError("something else")

    groups: list[int] = []
    with pytest.raises(ValueError, match="something else"):
        asyncio.run(fail())
    with pytest.raises(ProcessLookupError):  # waited for as well as killed
        os.kill(groups[0], 0)
