"""The person beside the simulated team: does by hand what vehicles wait for, and says so.

With the same word as `malipp confirm`: nothing but the bus joins the two, as in the field.
"""

from __future__ import annotations

from malipp_field.bus import Bus, Confirm, Telemetry, vehicle_key
from malipp_field.clock import Clock
from malipp_field.control.orders import Orders
from malipp_field.mission import Mission
from malipp_field.sim import Fleet

_LOOK_S = 1.0


class Person:
    """Looks after everything the vehicles wait for a person to do.

    What a vehicle tried itself and failed at is left alone.

    Parameters
    ----------
    mission
        `simulation.person_s` is how long each action takes; where it is null the hands work at once, and the
        word is left to somebody else.
    fleet
        The vehicles and the world that the hands are in.
    """

    def __init__(self, mission: Mission, fleet: Fleet, bus: Bus, clock: Clock) -> None:
        self._mission, self._fleet, self._bus, self._clock = mission, fleet, bus, clock
        self._orders = Orders(mission.name, bus, clock)
        self._telemetry: dict[str, Telemetry] = {}
        self._words: dict[str, Confirm] = {}  # by the uid of what was done

    async def run(self) -> None:
        """Work until cancelled."""
        for robot in self._fleet.rovers:
            key = vehicle_key(self._mission.name, robot, "telemetry")
            await self._bus.subscribe(key, Telemetry, self._see)
        while True:
            for telemetry in list(self._telemetry.values()):
                await self._attend(telemetry)
            await self._clock.sleep(_LOOK_S)

    def _see(self, _: str, telemetry: Telemetry) -> None:
        self._telemetry[telemetry.robot] = telemetry

    async def _attend(self, telemetry: Telemetry) -> None:
        awaited, after_s = telemetry.awaits, self._mission.simulation.person_s
        if awaited is None or awaited.problem or self._clock.now_s() < awaited.since_s + (after_s or 0.0):
            return
        if awaited.uid not in self._words:
            rover = self._fleet.rovers[telemetry.robot].autopilot
            outcome = rover.attended(awaited.action, awaited.tag)
            done = outcome.result == "ok"
            self._words[awaited.uid] = Confirm(
                uid=awaited.uid, ok=done, text="" if done else outcome.result, value=outcome.value
            )
        if after_s is not None:
            await self._orders.give(telemetry.robot, self._words[awaited.uid])
