"""New missions on all vehicles of a team, or on none.

What is on each vehicle is read first. Then all are given theirs at the same time, each is read back and
compared. Should one of them fail, or the whole be broken off, all that were touched are given back what
they had, read back as well. At every moment it is known of every vehicle what is on board: what it had, what
it was to get, or that nobody knows.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal, TypeAlias

from malipp_field.errors import LinkError
from malipp_field.link.compare import differences
from malipp_field.link.driver import Driver
from malipp_field.link.mission_protocol import MissionType
from malipp_field.link.outputs import check_outputs, needs
from malipp_field.link.standing import displacement
from malipp_field.link.time_of_day import compare_clocks
from malipp_field.vehicle.items import MAV_CMD_NAV_SCRIPT_TIME, MissionItem

OnProgress: TypeAlias = Callable[[str, str], None]
"""Told of a robot what is being done with it, in words."""

_LAST_LASTING_COMMAND = 95  # MAV_CMD_NAV_LAST: what comes after it is done in passing, and never current
_NEW = "has its new mission, read back and compared"
_OLD = "has what it had"


@dataclass
class Member:
    """One vehicle of the transaction.

    Attributes
    ----------
    robot
        Whose vehicle it is.
    driver
        Its link, at work.
    wanted
        What it is to have: its mission, and its fence and rally points where these are to be replaced, too.
    keeps_time
        Whether its mission has gates by time, for which its clock must agree with ours.
    state
        What is on board now: what it ``had``, what is ``wanted``, or ``unknown``.
    fault
        What went wrong with it, in words; empty while nothing has.
    warnings
        What a person should know of it all the same, in words.
    """

    robot: str
    driver: Driver
    wanted: Mapping[MissionType, Sequence[MissionItem]]
    keeps_time: bool = False
    state: Literal["had", "wanted", "unknown"] = "had"
    fault: str = ""
    warnings: list[str] = field(default_factory=list)
    _had: dict[MissionType, list[MissionItem]] = field(default_factory=dict)
    _touched: set[MissionType] = field(default_factory=set)
    _index: int = 0

    @property
    def words(self) -> str:
        """What is on board, and what went wrong, in one line."""
        known = {"wanted": _NEW, "had": _OLD}.get(self.state, self._unknown)
        return f"{known} ({self.fault})" if self.fault else known

    @property
    def _unknown(self) -> str:
        mode = self.driver.vehicle.mode
        doing = f"it may be driving, in {mode}" if self._may_drive else "it stands"
        return f"what is on board is not known; as far as is known {doing}; do not start it"

    async def meet(self) -> None:
        """See that the vehicle is there, and set up for its mission; note where it stands elsewhere."""
        await self.driver.hear()
        if self.keeps_time:
            await compare_clocks(self.driver)
        items = self.wanted[MissionType.MISSION]
        untold = await check_outputs(self.driver, needs(items))
        away = await displacement(self.driver, items[0])
        self.warnings += [warning for warning in (untold, away) if warning is not None]

    async def stand(self, *, hold: bool) -> None:
        """See that the vehicle is there and does not drive; with ``hold`` make it stop."""
        await self.driver.hear()
        if self._may_drive:
            if not hold:
                raise LinkError(
                    f"it is in {self.driver.vehicle.mode}, where it may drive; have it hold first"
                )
            await self.driver.enter("HOLD")

    @property
    def _may_drive(self) -> bool:
        vehicle = self.driver.vehicle
        return vehicle.mode == "AUTO" or (vehicle.armed and vehicle.mode != "HOLD")

    async def snapshot(self, on_progress: OnProgress) -> None:
        """Read what is on board."""
        for kind in self.wanted:
            there = await self.driver.download(kind, self._teller(kind, on_progress))
            self._had[kind] = [item._replace(current=0) for item in there]
        await self.driver.hear_index()
        self._index = self.driver.vehicle.current_seq or 0

    async def give(self, on_progress: OnProgress) -> None:
        """Put on board what is wanted; the mission last, and then from its beginning."""
        for kind in sorted(self.wanted, reverse=True):
            await self._put(kind, self.wanted[kind], on_progress)
        if self._touched and self._may_drive:
            raise LinkError(f"somebody set it to {self.driver.vehicle.mode} meanwhile")
        self.state = "wanted"

    async def rewind(self) -> None:
        """Make the first item current: a vehicle that had got further would go on in the middle."""
        items = self.wanted[MissionType.MISSION]
        if self._index > 1 and len(items) > 1:  # one that stays has nothing that could be current
            self.state = "unknown"  # the mission is the new one, but where it would begin is not
            self._touched.add(MissionType.MISSION)
            await self.driver.point_at(1, _first_lasting(items))
            self.state = "wanted"

    async def restore(self, on_progress: OnProgress) -> None:
        """Give back what it had, where that was touched."""
        if not self._touched:
            return
        await self.stand(hold=True)
        for kind in sorted(self._touched, reverse=True):
            self.state = "unknown"
            await self.driver.put(self._had[kind], kind, self._teller(kind, on_progress))
        await self.driver.hear_index()
        if self._index > 0 and self.driver.vehicle.current_seq != self._index:
            await self.driver.point_at(self._index)
        self._touched.clear()
        self.state = "had"

    async def _put(self, kind: MissionType, items: Sequence[MissionItem], on_progress: OnProgress) -> None:
        if differences(items, self._had[kind], home=kind is MissionType.MISSION):
            self._touched.add(kind)
            self.state = "unknown"
            await self.driver.put(items, kind, self._teller(kind, on_progress))

    def _teller(self, kind: MissionType, on_progress: OnProgress) -> Callable[[str, int, int], None]:
        return lambda what, done, total: on_progress(
            self.robot, f"{kind.word} {what} {done}/{total}" if total else f"{kind.word}: none"
        )


class Transaction:
    """All or nothing, for some vehicles.

    Parameters
    ----------
    members
        The vehicles; what became of each is in their ``state`` and ``fault`` at any time.
    hold
        Stop those that drive; without it they are a reason not to begin.
    on_progress
        See `OnProgress`.
    """

    def __init__(
        self,
        members: Sequence[Member],
        *,
        hold: bool = False,
        on_progress: OnProgress = lambda *_: None,
    ) -> None:
        self.members = list(members)
        self._hold = hold
        self._on_progress = on_progress

    async def run(self) -> bool:
        """Carry it out; return whether every vehicle now has what it was to get.

        Cancelled, it gives back what was touched before it ends; cancelled once more it ends at once, and
        ``state`` says of whom nothing is known.
        """
        if not (await self._each(Member.meet) and await self._each(self._prepare)):
            return False
        try:
            if await self._each(lambda member: member.give(self._on_progress)) and await self._each(
                Member.rewind
            ):
                return True
        except BaseException:
            await self._give_back()
            raise
        await self._give_back()
        return False

    async def _prepare(self, member: Member) -> None:
        await member.stand(hold=self._hold)
        await member.snapshot(self._on_progress)

    async def _give_back(self) -> None:
        await self._each(lambda member: member.restore(self._on_progress))

    async def _each(self, act: Callable[[Member], Awaitable[None]]) -> bool:
        """Do something with all members at once, to the end with each; return whether all went well."""

        async def one(member: Member) -> bool:
            try:
                await act(member)
            except LinkError as fault:
                member.fault = f"{member.fault}; {fault}" if member.fault else str(fault)
                return False
            return True

        async with asyncio.TaskGroup() as group:
            tasks = [group.create_task(one(member)) for member in self.members]
        return all(task.result() for task in tasks)


def _first_lasting(items: Sequence[MissionItem]) -> int:
    """Return the number of the first item after home that can be the current one."""
    return next(
        (
            item.seq
            for item in items[1:]
            if item.command <= _LAST_LASTING_COMMAND or item.command == MAV_CMD_NAV_SCRIPT_TIME
        ),
        1,
    )
