"""How a rover gets along a straight leg, and what that costs: the paper's energy model on real ground.

Over each metre it draws energy_per_kg_m * factors * (m^0 + m^s * samples on board) joules and takes
1 / (speed_m_s * factors) seconds. Speed is constant on a stretch of even ground: turning in place, starting
and stopping are left out, and a waypoint is reached exactly, not within a radius.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

Position = tuple[float, float]


@dataclass(frozen=True)
class Rates:
    """What one metre of a straight line costs a robot: speed over it, and joules for each kilogram."""

    speed_m_s: float
    energy_per_kg_m: float


@dataclass(frozen=True)
class Disc:
    """A disc of ground where all rates are multiplied."""

    centre: Position
    radius_m: float
    speed_factor: float
    energy_factor: float


@dataclass(frozen=True)
class Stretch:
    """A part of a leg on even ground."""

    length_m: float
    rates: Rates


@dataclass(frozen=True)
class Progress:
    """What a piece of driving took."""

    time_s: float
    energy_j: float


def stretches(start: Position, end: Position, rates: Rates, discs: Sequence[Disc]) -> list[Stretch]:
    """Return a straight line cut where it enters and leaves discs; factors of overlapping discs multiply."""
    length_m = math.dist(start, end)
    if length_m == 0.0:
        return []
    cuts = {0.0, length_m}
    for disc in discs:
        cuts.update(along for along in _crossings(start, end, disc) if 0.0 < along < length_m)
    ordered = sorted(cuts)
    found = []
    for begin, stop in itertools.pairwise(ordered):
        middle = _point(start, end, (begin + stop) / 2 / length_m)
        over = [disc for disc in discs if math.dist(middle, disc.centre) < disc.radius_m]
        here = Rates(
            rates.speed_m_s * math.prod(disc.speed_factor for disc in over),
            rates.energy_per_kg_m * math.prod(disc.energy_factor for disc in over),
        )
        found.append(Stretch(stop - begin, here))
    return found


class Leg:
    """A straight leg being driven. Advancing is exact for any duration: only stretches are stepped over.

    Parameters
    ----------
    start, end
        Local metres.
    parts
        Its stretches in order, as `stretches` gives them.
    """

    def __init__(self, start: Position, end: Position, parts: Sequence[Stretch]) -> None:
        self.start, self.end = start, end
        self._parts = list(parts)
        self._index = 0
        self._into_m = 0.0  # driven of the current stretch
        self._behind_m = 0.0  # length of the stretches before it

    @property
    def done(self) -> bool:
        """Whether the end is reached."""
        return self._index == len(self._parts)

    @property
    def position(self) -> Position:
        """Where the rover is; exactly `end` when done."""
        if self.done:
            return self.end
        share = (self._behind_m + self._into_m) / math.dist(self.start, self.end)
        return _point(self.start, self.end, share)

    @property
    def speed_m_s(self) -> float:
        """Speed over ground here, zero when done."""
        return 0.0 if self.done else self._parts[self._index].rates.speed_m_s

    @property
    def heading_deg(self) -> float:
        """Direction of travel, clockwise from north, 0 to 360."""
        (x0, y0), (x1, y1) = self.start, self.end
        return math.degrees(math.atan2(x1 - x0, y1 - y0)) % 360.0

    def advance(self, duration_s: float, mass_kg: float, energy_j: float) -> Progress:
        """Drive on until the time, the energy or the leg ends, whichever comes first."""
        time_s = spent_j = 0.0
        while not self.done:
            part = self._parts[self._index]
            remaining_m = part.length_m - self._into_m
            per_metre_j = part.rates.energy_per_kg_m * mass_kg
            by_time_m = (duration_s - time_s) * part.rates.speed_m_s
            by_energy_m = (energy_j - spent_j) / per_metre_j
            driven_m = max(0.0, min(remaining_m, by_time_m, by_energy_m))
            time_s += driven_m / part.rates.speed_m_s
            spent_j += driven_m * per_metre_j
            if driven_m < remaining_m:
                self._into_m += driven_m
                break
            self._behind_m += part.length_m
            self._index, self._into_m = self._index + 1, 0.0
        return Progress(time_s, spent_j)


def distance_to_segment_m(point: Position, start: Position, end: Position) -> tuple[float, float]:
    """Return a point's distance from a segment, and how far along the segment it is nearest (metres)."""
    length_m = math.dist(start, end)
    if length_m == 0.0:
        return math.dist(point, start), 0.0
    dx, dy = (end[0] - start[0]) / length_m, (end[1] - start[1]) / length_m
    along_m = (point[0] - start[0]) * dx + (point[1] - start[1]) * dy
    along_m = min(length_m, max(0.0, along_m))
    return math.dist(point, _point(start, end, along_m / length_m)), along_m


def _crossings(start: Position, end: Position, disc: Disc) -> list[float]:
    """Return how far along the line through start and end the disc's rim is crossed, in metres."""
    length_m = math.dist(start, end)
    dx, dy = (end[0] - start[0]) / length_m, (end[1] - start[1]) / length_m
    cx, cy = disc.centre[0] - start[0], disc.centre[1] - start[1]
    nearest_m = cx * dx + cy * dy
    half_squared = disc.radius_m**2 - (cx * dy - cy * dx) ** 2
    if half_squared <= 0.0:
        return []
    half_m = math.sqrt(half_squared)
    return [nearest_m - half_m, nearest_m + half_m]


def _point(start: Position, end: Position, share: float) -> Position:
    return start[0] + share * (end[0] - start[0]), start[1] + share * (end[1] - start[1])
