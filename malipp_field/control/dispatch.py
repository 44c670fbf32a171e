"""Putting vehicles on missions, and back on the one in force when that fails or they have lost it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from malipp_field.bus import Hold, Load, Order, Release, Start
from malipp_field.clock import Clock
from malipp_field.control.orders import Orders
from malipp_field.control.strays import Say, Strays
from malipp_field.control.tracks import Track
from malipp_field.vehicle.steps import VehicleMission

_AGAIN_S = 15.0  # a vehicle that could not be given its mission back is tried again so long after


class Dispatch:
    """Loads, starts and restores vehicles.

    It remembers who is *astray*: stopped by its own doing, and perhaps without the mission in force. Who has
    lost it otherwise it finds by what their agents say. What a person has stopped is none of its business.

    Parameters
    ----------
    orders
        Reaches the agents.
    tracks
        The team's vehicles, on the missions in force.
    """

    def __init__(self, orders: Orders, clock: Clock, say: Say, tracks: Mapping[str, Track]) -> None:
        self._orders, self._clock, self._say, self._tracks = orders, clock, say, tracks
        self._strays = Strays(tracks, say)
        self._astray: set[str] = set()
        self._touched: set[str] = set()  # who was sent the last proposal
        self._due_s = 0.0

    def restoring(self, present: set[str]) -> bool:
        """Whether a vehicle is about to be put back on its mission, so that no other should be made."""
        return not present.isdisjoint(self._strays.lost - self._strays.left_alone)

    async def load(
        self,
        missions: Mapping[str, VehicleMission],
        diverges_at: Mapping[str, str | None] | None = None,
        *,
        resume: bool = False,
    ) -> dict[str, str]:
        """Put missions on vehicles, which then stand, or with ``resume`` go on; return the refusals.

        Where one of them has been left alone, nothing is sent to any.
        """
        found = diverges_at or {}
        alone = self._strays.left_alone & missions.keys()
        self._touched = set() if alone else set(missions)
        if alone:
            return dict.fromkeys(
                sorted(alone), "its mission was changed by somebody else, and it is left alone"
            )
        return await self._give_all(
            {
                robot: Load(
                    mission=mission,
                    resume=resume,
                    diverges_at=found.get(robot),
                    done=self._tracks[robot].done,
                )
                for robot, mission in missions.items()
            }
        )

    async def start(self, missions: Mapping[str, VehicleMission]) -> dict[str, str]:
        """Let vehicles go that hold these missions, the ones in force; return the refusals."""
        refusals = await self._give_all(
            {robot: Start(version=mission.version) for robot, mission in missions.items()}
        )
        for robot, text in refusals.items():
            self._say("error", f"does not go: {text}", robot)
        for robot in missions.keys() - refusals.keys():
            self._tracks[robot].set_off()
        self._astray -= missions.keys()
        self._set_astray(refusals)
        return refusals

    async def release(self, robot: str, uid: str) -> str | None:
        """Let a vehicle pass the gate of that uid; return why it does not."""
        reply = await self._orders.give(robot, Release(uid=uid))
        return None if reply.ok else reply.text

    async def put_back(self, robots: Iterable[str], present: set[str]) -> None:
        """Give up a proposal that some of ``robots`` have refused.

        Who refused may hold the new mission all the same: its answer was not heard, or it failed on the way.
        None of them moves before it has been given back what all the others go on with.
        """
        self._set_astray(self._touched.intersection(robots))
        self._due_s = self._clock.now_s()
        await self.restore(present)

    async def restore(self, present: set[str]) -> None:
        """Put on the mission in force who is astray, if that is due, or has lost it; call it often."""
        lost = (self._strays.find() & present) - self._astray
        lost -= await self._give_up(lost)
        due = self._astray & present if self._clock.now_s() >= self._due_s else set()
        robots = sorted(lost | {robot for robot in due if not self._strays.with_a_person(robot)})
        if not robots:
            return
        standing = {robot for robot in lost if self._strays.stood(robot)}
        with self._clock.real_time():
            refusals = await self._load_again(robots)
            for robot, text in refusals.items():
                self._say("error", f"is held: its mission could not be put back: {text}", robot)
            self._note_restored(lost - refusals.keys(), standing)
            going = set(robots) - refusals.keys() - standing
            await self.start({robot: self._tracks[robot].mission for robot in sorted(going)})
            self._set_astray(refusals.keys() - standing)

    async def _load_again(self, robots: Iterable[str]) -> dict[str, str]:
        """Give vehicles the mission in force once more, which they may have on board and be carrying out."""
        tracks = {robot: self._tracks[robot] for robot in robots}
        return await self._give_all(
            {
                robot: Load(mission=track.mission, done=track.done, begun=track.begun)
                for robot, track in tracks.items()
            }
        )

    async def _give_up(self, lost: set[str]) -> set[str]:
        vain = self._strays.give_up(lost)
        await self._give_all({robot: Hold(reason="it keeps losing its mission") for robot in vain})
        return vain

    def _note_restored(self, robots: Iterable[str], standing: set[str]) -> None:
        for robot in sorted(robots):
            self._strays.note_restored(robot)
            still = ". It was held before that, and still is: AUTO lets it go on" if robot in standing else ""
            self._say(
                "warning", f"its agent did not know its mission any more: it was put back{still}", robot
            )

    async def _give_all(self, orders: Mapping[str, Order]) -> dict[str, str]:
        refusals = await self._orders.give_all(orders)
        self._strays.note_orders(orders, self._clock.now_s())
        return refusals

    def _set_astray(self, robots: Iterable[str]) -> None:
        self._astray |= set(robots)
        self._due_s = self._clock.now_s() + _AGAIN_S
