"""Putting vehicles on missions, and back on the one in force when that fails."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Literal, Protocol

from malipp_field.bus import Load, Release, Start
from malipp_field.clock import Clock
from malipp_field.control.orders import Orders
from malipp_field.vehicle.steps import VehicleMission

_AGAIN_S = 15.0  # a vehicle that could not be given its mission back is tried again so long after

Severity = Literal["info", "warning", "error"]


class Say(Protocol):
    """Tells the team something."""

    def __call__(self, severity: Severity, text: str, robot: str | None = None) -> None:
        """Say ``text``, about ``robot`` if given."""
        ...


class Dispatch:
    """Loads, starts and restores vehicles.

    It remembers who is *astray*: stopped by its own doing, and perhaps without the mission in force. What a
    person has stopped is none of its business.
    """

    def __init__(self, orders: Orders, clock: Clock, say: Say) -> None:
        self._orders, self._clock, self._say = orders, clock, say
        self._astray: set[str] = set()
        self._due_s = 0.0

    async def load(
        self,
        missions: Mapping[str, VehicleMission],
        diverges_at: Mapping[str, str | None] | None = None,
        *,
        resume: bool = False,
    ) -> dict[str, str]:
        """Put missions on vehicles, which then stand, or with ``resume`` go on; return the refusals."""
        found = diverges_at or {}
        return await self._orders.give_all(
            {
                robot: Load(mission=mission, resume=resume, diverges_at=found.get(robot))
                for robot, mission in missions.items()
            }
        )

    async def start(self, missions: Mapping[str, VehicleMission]) -> dict[str, str]:
        """Let vehicles go that hold these missions, the ones in force; return the refusals."""
        refusals = await self._orders.give_all(
            {robot: Start(version=mission.version) for robot, mission in missions.items()}
        )
        for robot, text in refusals.items():
            self._say("error", f"does not go: {text}", robot)
        self._astray -= missions.keys()
        self._set_astray(refusals)
        return refusals

    async def release(self, robot: str, uid: str) -> str | None:
        """Let a vehicle pass the gate of that uid; return why it does not."""
        reply = await self._orders.give(robot, Release(uid=uid))
        return None if reply.ok else reply.text

    async def put_back(
        self, robots: Iterable[str], in_force: Mapping[str, VehicleMission], present: set[str]
    ) -> None:
        """Give up a proposal that some of ``robots`` have refused.

        Who refused may hold the new mission all the same: its answer was not heard, or it failed on the way.
        None of them moves before it has been given back what all the others go on with.
        """
        self._set_astray(robots)
        self._due_s = self._clock.now_s()
        await self.restore(in_force, present)

    async def restore(self, in_force: Mapping[str, VehicleMission], present: set[str]) -> None:
        """Give those astray the mission in force and let them go on, if that is due; call it often."""
        robots = sorted(self._astray & present)
        if not robots or self._clock.now_s() < self._due_s:
            return
        with self._clock.real_time():
            refusals = await self.load({robot: in_force[robot] for robot in robots})
            for robot, text in refusals.items():
                self._say("error", f"is held: its mission could not be put back: {text}", robot)
            await self.start({r: in_force[r] for r in robots if r not in refusals})
            self._set_astray(refusals)

    def _set_astray(self, robots: Iterable[str]) -> None:
        self._astray |= set(robots)
        self._due_s = self._clock.now_s() + _AGAIN_S
