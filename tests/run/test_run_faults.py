"""What becomes of a run when one of its parts dies."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

from malipp_field.errors import LinkError
from malipp_field.link import Agent
from malipp_field.mission import Mission, read_mission
from malipp_field.mission.vehicles import VehicleSettings
from malipp_field.planner import solve
from malipp_field.record import read_run
from malipp_field.run import fly

MISSION = Path(__file__).parents[2] / "missions" / "corridor.yaml"


def signed(mission: Mission) -> Mission:
    """Give every vehicle a key file; none need exist for a simulated team, which makes keys of its own."""
    settings = VehicleSettings(signing_key="none.key")
    return mission.model_copy(update={"vehicles": {robot.id: settings for robot in mission.team.robots}})


def test_an_agent_that_dies_ends_the_run_with_its_fault_and_a_whole_recording(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    mission = signed(read_mission(MISSION))
    plan = solve(mission, method="seq", threads=1)
    honest = Agent.run

    async def dies(agent: Agent) -> None:
        try:
            await asyncio.wait_for(honest(agent), 1.0)
        except TimeoutError:
            raise LinkError("the radio is on fire") from None

    monkeypatch.setattr(Agent, "run", dies)
    recording = tmp_path / "run.mcap"
    with pytest.raises(LinkError, match="the radio is on fire"):
        asyncio.run(asyncio.wait_for(fly(mission, MISSION.read_text(), plan, recording), 60.0))
    run = read_run(recording)
    assert run.complete
    assert any(run.telemetry.values())
