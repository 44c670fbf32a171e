"""Vehicles whose agents do not know their mission any more, and whether to put them back on it.

An agent that was started again in mid-mission knows nothing; one that saw somebody else change the mission on
board has held the vehicle. Whoever wants to take a vehicle over sets it to a mode other than AUTO and HOLD,
or disarms it, and it is left alone.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Literal, Protocol

from malipp_field.control.tracks import Track

_LOST_S = 5.0  # for so long an agent must say that it knows no mission
_RESTORATIONS = 3  # of a vehicle that gets no further between them

Severity = Literal["info", "warning", "error"]


class Say(Protocol):
    """Tells the team something."""

    def __call__(self, severity: Severity, text: str, robot: str | None = None) -> None:
        """Say ``text``, about ``robot`` if given."""
        ...


class Strays:
    """Finds them, and says once what becomes of each.

    Parameters
    ----------
    tracks
        The team's vehicles, on the missions in force.
    say
        Tells the team.
    """

    def __init__(self, tracks: Mapping[str, Track], say: Say) -> None:
        self._tracks, self._say = tracks, say
        self._since_s: dict[str, float] = {}  # what agents said before does not count
        self._restored: dict[str, tuple[int, int]] = {}  # at which step last, and how often there
        self._left_to_a_person: set[str] = set()
        self._given_up: set[str] = set()

    def note_orders(self, robots: Iterable[str], now_s: float) -> None:
        """Note that vehicles have just answered: what their agents said before that is out of date."""
        self._since_s |= dict.fromkeys(robots, now_s)

    @property
    def lost(self) -> set[str]:
        """Vehicles under way whose agents do not know their mission, whatever is to be done about it."""
        return {
            robot
            for robot, track in self._tracks.items()
            if track.lost_s is not None and track.has_driven and not track.finished
        }

    @property
    def left_alone(self) -> set[str]:
        """Those of them that are not put back."""
        return {robot for robot in self.lost if robot in self._given_up or self._is_taken(robot)}

    def find(self) -> set[str]:
        """Return who has lost the mission in force, for long enough, and is to be put back on it."""
        lost, found = self.lost, set()
        self._given_up &= lost
        for robot in sorted(lost - self._given_up):
            now = self._tracks[robot].telemetry
            if now is not None and self.with_a_person(robot):
                self._since_s[robot] = now.time_s  # once it is given back, a moment to step aside
            elif self._is_certain(robot):
                found.add(robot)
        return found

    def _is_certain(self, robot: str) -> bool:
        now, lost_s = self._tracks[robot].telemetry, self._tracks[robot].lost_s
        if now is None or lost_s is None or not now.link_ok:
            return False
        return now.time_s > max(lost_s, self._since_s.get(robot, lost_s)) + _LOST_S

    def with_a_person(self, robot: str) -> bool:
        """Tell whether somebody has taken a vehicle over; say so when that is new."""
        self._left_to_a_person = {each for each in self._left_to_a_person if self._is_taken(each)}
        if not self._is_taken(robot):
            return False
        now = self._tracks[robot].telemetry
        if now is not None and robot not in self._left_to_a_person:
            how = f"in {now.mode}" if now.armed else "disarmed"
            self._say(
                "warning",
                f"is {how} without its mission, and left to a person; armed and in HOLD it gets it back "
                "and goes on",
                robot,
            )
            self._left_to_a_person.add(robot)
        return True

    def _is_taken(self, robot: str) -> bool:
        now = self._tracks[robot].telemetry
        if now is None or not now.link_ok:  # a new agent speaks before it has heard its vehicle's mode
            return False
        return now.mode not in ("AUTO", "HOLD") if now.armed else self._tracks[robot].has_driven

    def stood(self, robot: str) -> bool:
        """Tell whether a vehicle stands in HOLD, and did when its agent still knew its mission."""
        track = self._tracks[robot]
        return all(report is not None and report.mode == "HOLD" for report in (track.known, track.telemetry))

    def note_restored(self, robot: str) -> None:
        """Note that a vehicle has its mission again."""
        at = self._tracks[robot].current
        before, times = self._restored.get(robot, (at, 0))
        self._restored[robot] = (at, times + 1 if at == before else 1)

    def give_up(self, robots: Iterable[str]) -> set[str]:
        """Return, and say, whose mission was put back so often that it is in vain."""
        at = {robot: self._tracks[robot].current for robot in robots}
        vain = {robot for robot in at if self._restored.get(robot) == (at[robot], _RESTORATIONS)}
        for robot in vain:
            self._say(
                "error",
                f"its mission was put back {_RESTORATIONS} times at this step, and is lost again: somebody "
                "else changes it, or its agent fails. It is held, and left so",
                robot,
            )
        self._given_up |= vain
        return vain
