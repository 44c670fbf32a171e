"""What a vehicle is busy with while one mission item lasts."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol


class Activity(Protocol):
    """Something that takes time."""

    def advance(self, duration_s: float) -> float | None:
        """Go on for that long; return the time left over when it ended before, `None` while it lasts."""
        ...


class Pause:
    """Stand still; for ever unless a duration is given."""

    def __init__(self, duration_s: float | None = None) -> None:
        self._left_s = float("inf") if duration_s is None else duration_s

    def advance(self, duration_s: float) -> float | None:
        """See `Activity`."""
        self._left_s -= duration_s
        return -self._left_s if self._left_s <= 0.0 else None


class Do:
    """Something done in no time; the activity ends unless it returns False."""

    def __init__(self, what: Callable[[], bool | None]) -> None:
        self._what = what

    def advance(self, duration_s: float) -> float | None:
        """See `Activity`."""
        return None if self._what() is False else duration_s


class InTurn:
    """One activity after the other."""

    def __init__(self, *parts: Activity) -> None:
        self._parts: Sequence[Activity] = parts

    def advance(self, duration_s: float) -> float | None:
        """See `Activity`."""
        left_s: float | None = duration_s
        while self._parts and left_s is not None:
            left_s = self._parts[0].advance(left_s)
            if left_s is not None:
                self._parts = self._parts[1:]
        return left_s
