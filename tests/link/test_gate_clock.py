"""Gates by the time of day are for vehicles that have the same time of day as we."""

from __future__ import annotations

import pytest
from agent_cases import Yard
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from malipp_field.bus.messages import Load
from malipp_field.vehicle.steps import VehicleMission

WORK = ("drive a", "wait a 1", "pick a 1", "drive base")


def gated(yard: Yard) -> VehicleMission:
    """Return a mission whose gate opens by itself in ten minutes."""
    drive, wait, *rest = yard.mission(*WORK).steps
    wait = wait.model_copy(update={"not_before_s": yard.clock.now_s() + 600.0})
    return yard.mission(*WORK).model_copy(update={"steps": (drive, wait, *rest)})


@pytest.mark.parametrize(
    ("ahead_s", "words"),
    [
        (-3600.0, "its clock is 3600 s behind this computer's"),
        (45.0, "its clock is 45 s ahead of this computer's"),
        (None, "does not know the time of day"),
        (1.0, None),
    ],
)
def test_a_time_gate_is_only_loaded_where_the_clocks_agree(ahead_s: float | None, words: str | None) -> None:
    async def scene(yard: Yard) -> None:
        yard.rover._telemetry._builders[mavlink.MAVLINK_MSG_ID_SYSTEM_TIME] = lambda now_s: (
            mavlink.MAVLink_system_time_message(0 if ahead_s is None else int((now_s + ahead_s) * 1e6), 0)
        )
        await yard.live(3.0)
        reply = await yard.order(Load(mission=gated(yard)))
        assert reply.ok is (words is None)
        assert words is None or words in reply.text
        assert (await yard.order(Load(mission=yard.mission(*WORK)))).ok, "only the coordinator opens this one"

    Yard().run(scene)
