"""Which item of the stored mission is carried out, as ArduPilot's `AP_Mission` keeps track of it.

Its ways that matter to safety are kept: the active item is a copy in memory, so of itself a new upload
changes nothing until that item ends or another is made current (in AUTO the autopilot may begin it anew,
see `ChangeDetector`); a stale number beyond the end completes the mission; and a completed mission stays
completed in AUTO until an item is made current *and* the mission resumed. DO commands are done together
with the navigation item that follows them, and only that is ever the current one; of those after the last
navigation item just the first is done.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from enum import Enum, auto

from malipp_field.sim.items import NAVIGATION
from malipp_field.sim.mission_store import MissionStore
from malipp_field.vehicle.items import MissionItem


class RunState(Enum):
    """The states of `AP_Mission`."""

    STOPPED = auto()
    RUNNING = auto()
    COMPLETE = auto()


class MissionRun:
    """The sequence of items.

    Parameters
    ----------
    store
        The stored mission.
    begin
        Called with each navigation item that is to be carried out from now on.
    perform
        Called with each DO command, which is done in passing.
    completed
        Called when no item is left.
    """

    def __init__(
        self,
        store: MissionStore,
        begin: Callable[[MissionItem], None],
        perform: Callable[[MissionItem], None],
        completed: Callable[[], None],
    ) -> None:
        self._store = store
        self._begin = begin
        self._perform = perform
        self._completed = completed
        self.reset()

    @property
    def seq(self) -> int:
        """Number of the active item, 0 while there is none."""
        return 0 if self.active is None else self.active.seq

    def start_or_resume(self, restart: bool) -> None:
        """Go on with the active item as it is stored now, or from the first (on entering AUTO)."""
        stored = None if self.active is None else self._store.item(self.active.seq)
        anew = restart or self.state is RunState.COMPLETE or stored is None
        self._enter(RunState.RUNNING)
        self._advance(1 if anew else self._resume_at)

    def stop(self) -> None:
        """Leave off at the active item (on leaving AUTO)."""
        if self.state is RunState.RUNNING:
            self._enter(RunState.STOPPED)

    def reset(self) -> None:
        """Forget how far the mission has come (on disarming outside AUTO)."""
        self._enter(RunState.STOPPED)
        self._load(None)

    def item_ended(self) -> None:
        """Go on to the next item in store."""
        if self._store.items:
            self._advance(self.seq + 1)

    def set_current(self, seq: int, resume: bool = False) -> bool:
        """Make an item current; return whether there is one.

        A running mission jumps there at once; one that is not running only does so with ``resume``.
        """
        if not 0 <= seq < len(self._store.items) or len(self._store.items) == 1:
            return False
        first = max(1, seq)
        if self.state is RunState.RUNNING:
            return self._advance(first)
        passing, item = self._ahead(first)
        self._load(item)
        self._enter(RunState.STOPPED)
        if item is None:
            return False
        self._resume_at = passing[0].seq if passing else item.seq
        if resume:
            self._enter(RunState.RUNNING)
            self._advance(self._resume_at)
        return True

    def _advance(self, seq: int) -> bool:
        """Begin the first lasting item from ``seq`` on; what lies before it is done in passing."""
        passing, item = self._ahead(seq)
        if item is None:
            for command in passing[:1]:
                self._perform(command)
            self._enter(RunState.COMPLETE)
            self._completed()
            return False
        self._load(item)
        for command in passing:
            self._perform(command)
        self._begin(item)
        return True

    def _ahead(self, seq: int) -> tuple[list[MissionItem], MissionItem | None]:
        """Return the next navigation item from ``seq`` on, and the DO commands before it."""
        ahead = self._store.items[seq:]
        passing = list(itertools.takewhile(lambda item: item.command not in NAVIGATION, ahead))
        return passing, ahead[len(passing)] if len(passing) < len(ahead) else None

    def _load(self, item: MissionItem | None) -> None:
        self.active: MissionItem | None = item
        self._resume_at = 0 if item is None else item.seq
        self._store.current = self.seq

    def _enter(self, state: RunState) -> None:
        self.state = state
        self._store.running = state is RunState.RUNNING
