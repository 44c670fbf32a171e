"""How a Rover in AUTO notices that its mission was changed under it (`AP_Mission_ChangeDetector`)."""

from __future__ import annotations

from itertools import islice

from malipp_field.sim.items import NAVIGATION
from malipp_field.sim.mission_store import MissionStore
from malipp_field.vehicle.items import MissionItem

_AHEAD = 3
"""How many navigation items are compared, the current one included."""


class ChangeDetector:
    """Remembers the next navigation items as stored when last looked at.

    An upload is not waited for: what is stored in the middle of it counts.

    Parameters
    ----------
    store
        The stored mission.
    """

    def __init__(self, store: MissionStore) -> None:
        self._store = store
        self._seen: tuple[int, list[MissionItem]] | None = None

    def forget(self) -> None:
        """Take what is found next as it is (on entering AUTO)."""
        self._seen = None

    def look(self, seq: int) -> bool:
        """Return whether the items from the current one on have changed while it stayed current."""
        ahead = (item for item in self._store.items[seq:] if item.command in NAVIGATION)
        before, self._seen = self._seen, (seq, list(islice(ahead, _AHEAD)))
        return before is not None and before[0] == seq and before[1] != self._seen[1]
