"""What a command that only looks at vehicles does to them: nothing."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

from link_cases import framed, from_ground
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from transaction_cases import TEAM

from malipp_field.clock import SimClock
from malipp_field.link.contact import Contact
from malipp_field.sim import Rover, World

STEP_S = 0.1


class OneVehicle:
    """A rover that answers only where it has heard from, as over UDP."""

    def __init__(self, *, only_looks: bool) -> None:
        self.clock = SimClock(1e9)
        self.rover = Rover("scout", World(TEAM), 1, self.clock.now_s())
        self.rover.parameters.receive(
            mavlink.MAVLink_param_set_message(1, 1, b"FS_GCS_ENABLE", 1.0, mavlink.MAV_PARAM_TYPE_INT8)
        )
        self.contact = Contact((1, 1), self._open, self.clock, only_looks=only_looks)
        self._up: list[Any] = []
        self._heard_from = False

    async def _open(self, on_message: Callable[[Any], None]) -> OneVehicle:
        self._on_message = on_message
        return self

    def send(self, message: Any) -> None:
        self._up.append(from_ground(message))

    def close(self) -> None:
        self._heard_from = False

    async def live(self, duration_s: float) -> None:
        for _ in range(round(duration_s / STEP_S)):
            self.clock.advance(STEP_S)
            up, self._up = self._up, []
            for message in up:
                self._heard_from = True
                self.rover.receive(message, "ground", self.clock.now_s())
            self.rover.step(self.clock.now_s())
            outbox, self.rover.outbox = self.rover.outbox, []
            for _, message in outbox if self._heard_from else []:
                self._on_message(framed(message, 1))
            for _ in range(8):
                await asyncio.sleep(0)


def failsafe_after_a_look(*, only_looks: bool) -> bool:
    """Hear a vehicle in AUTO for some seconds, leave, and see what its failsafe makes of that."""
    field = OneVehicle(only_looks=only_looks)

    async def scene() -> None:
        async with field.contact:
            await field.live(8.0)
            assert field.contact.driver.vehicle.link_ok(field.clock.now_s())
            assert field.contact.driver.vehicle.current_seq is not None
        field.rover.autopilot.set_mode(mavlink.ROVER_MODE_AUTO)
        await field.live(20.0)

    asyncio.run(scene())
    return bool(field.rover.autopilot.mode == mavlink.ROVER_MODE_HOLD)


def test_a_vehicle_that_was_only_looked_at_does_not_miss_anybody() -> None:
    assert not failsafe_after_a_look(only_looks=True)
    assert failsafe_after_a_look(only_looks=False), "else this test shows nothing"
