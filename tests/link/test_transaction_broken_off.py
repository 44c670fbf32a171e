"""A transaction over a team broken off at any message, once or twice, and what is then said of it.

The messages between one vehicle and the ground are counted in an undisturbed transaction first, those that go
out and those that come in; then there is one transaction for each of them, or for every second where the
vehicle drives, broken off as it crosses.
"""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from transaction_cases import FENCE, MISSION, NEW, RALLY, TEAM, Field

from malipp_field.vehicle.fence import fence_items, rally_items

REPORT = "MISSION_CURRENT"
"""Comes all the time, whatever is being sent."""
WATCHED = "scout"
ROBOTS = (WATCHED, "carrier")


class BrokenOff:
    """A transaction in which something happens as message ``at`` of one vehicle crosses.

    That vehicle stands in the middle of its mission, or it drives, and is to get fence and rally points, too.
    """

    def __init__(self, field: Field, *, driving: bool, at: Sequence[int] = ()) -> None:
        assert TEAM.site.origin is not None
        self._field, self._driving, self._at = field, driving, at
        wanted = {MISSION: NEW}
        if driving:
            wanted[FENCE] = fence_items(TEAM, TEAM.site.origin)
            wanted[RALLY] = rally_items(TEAM, TEAM.site.origin, WATCHED)
        self.transaction = field.transaction(hold=driving, wanted=wanted)
        self.pilot = field.radios[WATCHED].rover.autopilot
        self.crossed = 0

    async def carry_out(self) -> bool:
        """Return whether it was broken off."""
        if self._driving:
            assert self.pilot.arm()
            assert self.pilot.set_mode(mavlink.ROVER_MODE_AUTO)
        else:
            self.pilot.run.set_current(4)
        await self._field.live(1.0)
        self._field.radios[WATCHED].on_cross = self._cross
        self._task = asyncio.create_task(self.transaction.run())
        await self._field.finish(self._task)
        return self._task.cancelled()

    def _cross(self, message: Any) -> None:
        kind = message.get_type()
        if kind.startswith(("MISSION_", "COMMAND_")) and kind != REPORT:
            if self.crossed in self._at:
                self._task.cancel()
            self.crossed += 1

    def check(self) -> None:
        """What is said is so, and a vehicle that drives has what it had, whole."""
        for member in self.transaction.members:
            radio = self._field.radios[member.robot]
            if member.state != "unknown":
                assert radio.aboard() == {"had": "old", "wanted": "new"}[member.state], member.words
        if self.pilot.armed and self.pilot.mode == mavlink.ROVER_MODE_AUTO:
            assert self.transaction.members[0].state == "had"


def break_off(*at: int, driving: bool = False) -> BrokenOff:
    """Return a transaction that has been broken off at some messages."""

    async def scene(field: Field) -> BrokenOff:
        case = BrokenOff(field, driving=driving, at=at)
        assert await case.carry_out() is bool(at), f"broken off at {at}"
        case.check()
        return case

    print("broken off at messages", *at)
    return Field(robots=ROBOTS).run(scene)


@pytest.mark.parametrize("driving", [False, True], ids=["standing", "driving"])
def test_broken_off_it_gives_back_what_all_had(driving: bool) -> None:
    count = break_off(driving=driving).crossed
    assert count > 40
    for at in range(0, count, 2 if driving else 1):
        case = break_off(at, driving=driving)
        assert {member.state for member in case.transaction.members} == {"had"}
        assert driving or case.pilot.run.seq == 4
        assert not driving or at == 0 or case.pilot.mode == mavlink.ROVER_MODE_HOLD


def test_broken_off_twice_it_says_of_whom_nothing_is_known() -> None:
    """The second time at each message with which it gives back what there was."""
    first = break_off().crossed - 2
    count = break_off(first).crossed
    assert count > first + 20
    states = [
        {member.state for member in break_off(first, at).transaction.members}
        for at in range(first + 1, count)
    ]
    assert {"unknown"} in states
    assert "had" in states[-1], "what has been given back is known"
