"""Which steps are done, and which is being carried out; no I/O.

"Reached" proves nothing: a payload step is done when the payload script or a person has confirmed it, a drive
or a wait when MISSION_CURRENT has moved past it, seen twice, while the mission on board was verified. For an
action of hardware that cannot speak that has to do as well.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable

from malipp_field.mission.vehicles import ByServo
from malipp_field.vehicle.layout import Layout, confirmed_by, lay_out, means_of
from malipp_field.vehicle.payload_protocol import PayloadReport
from malipp_field.vehicle.steps import Action, Step, VehicleMission

_PASSED_BY = (Action.DRIVE, Action.WAIT)


class Progress:
    """Progress of one vehicle, over all the missions of one run that it has been given.

    Attributes
    ----------
    mission : VehicleMission or None
        The verified mission on board.
    done : set of str
        Uids of steps done, under this mission or an earlier one of this run, or gone on without.
    failed : dict of str to str
        What is wrong with steps that the vehicle tried, by uid: it holds there, but for an output refused.
    """

    def __init__(self) -> None:
        self.mission: VehicleMission | None = None
        self.done: set[str] = set()
        self.failed: dict[str, str] = {}
        self._known: deque[VehicleMission] = deque()  # newest first
        self._followed: VehicleMission | None = None
        self._layout: Layout | None = None  # of the mission followed
        self._index = 0
        self._item = 0

    @property
    def known(self) -> bool:
        """Whether there has been a verified mission at all."""
        return bool(self._known)

    @property
    def under_way(self) -> bool:
        """Whether a mission has been begun, and its index counts."""
        return self._followed is not None

    @property
    def in_force(self) -> bool:
        """Whether the mission on board is verified and is the one that was begun."""
        return self.mission is not None and self.mission is self._followed

    @property
    def current(self) -> Step | None:
        """The step being carried out; None before the start, and when no step is left.

        While the mission is replaced this stays what it was: the vehicle holds.
        """
        steps = () if self._followed is None else self._followed.steps
        return steps[self._index] if self._index < len(steps) else None

    @property
    def finished(self) -> bool:
        """Whether all steps of the verified mission are done."""
        return self.mission is not None and self.first_undone(self.mission) is None

    def first_undone(self, mission: VehicleMission) -> int | None:
        """Return the index of the first step that is not done."""
        return next((i for i, step in enumerate(mission.steps) if step.uid not in self.done), None)

    def adopt(self, mission: VehicleMission) -> None:
        """Note that this mission is on board, read back and found right.

        In another run nothing is done yet, whatever the names of its steps.
        """
        if self._known and self._known[0].run != mission.run:
            self.done.clear()
            self.failed.clear()
            self._known.clear()
            self.unfollow()
        # One of its own, even if it is the last one again: until it is followed the item that the vehicle
        # reports may be left from what was on board in between.
        self.mission = mission.model_copy()
        self._known.appendleft(mission)

    def learn(self, done: Iterable[str]) -> None:
        """Take over what others know to be done, by uid."""
        self.done.update(done)

    def forget(self) -> None:
        """Note that what is on board is not known any more."""
        self.mission = None

    def resumption(self, mission: VehicleMission) -> int | None:
        """Return the item at which a mission is to be begun or gone on with; None when all is done.

        A step of several items goes on where it was left off: a servo that has been set is not set again.
        """
        index = self.first_undone(mission)
        if index is None:
            return None
        layout, current = lay_out(mission), self.current
        first = layout.first_item(index)
        if current is None or self._layout is None or current.uid != mission.steps[index].uid:
            return first
        left = self._layout.last_item(self._index) - self._item
        return max(first, layout.last_item(index) - left)

    def follow(self, item: int | None) -> None:
        """Count MISSION_CURRENT from now on: the vehicle is at that item of the mission on board.

        None: it has come to the end of it.
        """
        assert self.mission is not None
        self._followed, self._layout = self.mission, lay_out(self.mission)
        self._index, self._item = self._position(self.mission, self._layout, item)

    @staticmethod
    def _position(mission: VehicleMission, layout: Layout, item: int | None) -> tuple[int, int]:
        """Return index of the step, and item, of a vehicle at ``item``; None: at the end."""
        return (len(mission.steps), 0) if item is None else (layout.steps[item], item)

    def unfollow(self) -> None:
        """Note that the mission was not begun after all."""
        self._followed, self._layout, self._index, self._item = None, None, 0, 0

    def report(self, seq: int, complete: bool) -> list[Step]:
        """Take in MISSION_CURRENT; at item 0 the vehicle is at no step.

        It takes two reports in a row for anything to be done: a single one may have been under way for long.
        A payload step without its confirmation stops the count: what is said to lie behind it is either a
        stale index or a vehicle that passes over its work.

        Returns
        -------
        list of Step
            Payload steps not noted as done that are confirmed by the vehicle's having gone past them.
        """
        mission, layout = self.mission, self._layout
        if mission is None or layout is None or not self.in_force:
            return []
        if not (complete or 0 < seq < len(layout.steps)):
            return []
        before, passed = self._index, []
        self._index, self._item = self._position(mission, layout, None if complete else seq)
        for step in mission.steps[: min(before, self._index)]:
            if step.action in _PASSED_BY:
                self.done.add(step.uid)
            elif step.uid in self.done:
                continue
            elif confirmed_by(mission, step) == "progress" and step.uid not in self.failed:
                passed.append(step)
            else:
                break
        return passed

    def unconfirmed(self) -> list[Step]:
        """Return the payload steps that the vehicle has left behind without a confirmation so far."""
        steps = () if self._followed is None else self._followed.steps[: self._index]
        return [step for step in steps if step.action not in _PASSED_BY and step.uid not in self.done]

    def settle(self, step: Step) -> None:
        """Note that nothing is left to do about a payload step."""
        self.done.add(step.uid)
        self.failed.pop(step.uid, None)

    def refuse(self, channel: int) -> None:
        """Note that the vehicle did not set a servo: the step that it was to do that for has failed.

        The word may be here before the report that the vehicle has come to that step.
        """
        if not self.in_force or self.mission is None:
            return
        for step in self.mission.steps[self._index :]:
            means = means_of(self.mission, step)
            if isinstance(means, ByServo) and means.channel == channel and step.uid not in self.done:
                self.failed.setdefault(step.uid, f"servo channel {channel} is in use")
                return

    def awaited(self) -> Step | None:
        """Return the step that waits for a person's word, or that the vehicle has not left although it came.

        It is one the vehicle holds at or was taken past without a word, or one that it failed at.
        """
        mission, layout = self.mission, self._layout
        if mission is None or layout is None or not self.in_force:
            return None
        for index, step in enumerate(mission.steps[: self._index + 1]):
            here, witness = index == self._index, confirmed_by(mission, step)
            if step.uid in self.failed and (here or witness == "progress"):
                return step
            if witness != "person" or (here and self._item < layout.last_item(index)):
                continue
            if step.uid not in self.done or (here and index + 1 < len(mission.steps)):
                return step
        return None

    def precedes(self, report: PayloadReport) -> bool:
        """Whether a confirmation is of another run than the missions here, and so of an earlier one.

        One that tells none is of a mission without a number, such as one uploaded with nobody to hear it.
        """
        return bool(self._known) and report.run != self._known[0].run

    def step_of(self, report: PayloadReport) -> Step | None:
        """Return the step a confirmation belongs to, or None when no mission so far has such a step."""
        if self.precedes(report):
            return None
        matching = [
            step
            for mission in self._known
            for step in mission.steps
            if step.action is report.action and report.tag in step.tags
        ]
        return next((s for s in matching if s.uid not in self.done), matching[0] if matching else None)

    def objection(self, new: VehicleMission, diverges_at: str | None) -> str | None:
        """Return why ``new`` must not replace the mission under way, or None when it may (see `Load`)."""
        step = self.current
        if step is None or step.uid in self.done or new.index_of(step.uid) is not None:
            return None
        if step.action is Action.WAIT and step.uid == diverges_at:
            return None
        return f"the vehicle is at step {step.uid} already, which the new mission does not have"
