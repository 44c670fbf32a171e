"""Whether a robot's energy lasts: leg by leg with what is then on board, and home from every stop.

Energy is the mission's model (`eq:energy_budget`): joules for each kilogram moved over each edge driven.
"""

from __future__ import annotations

import heapq
import math
from collections import defaultdict
from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import NamedTuple

from malipp_field.mission import Mission, Passage, Robot, node_positions
from malipp_field.plan import RobotPlan, Stop
from malipp_field.vehicle.finding import Finding, Spot

_ROUNDING = 1e-6
"""Share of an energy by which it may exceed another: sums in plan files are rounded."""
_STRAIGHT = 0.05
"""Share by which the length of an edge may differ from the straight way that is driven."""


class Roads:
    """What one robot may drive, and the cheapest way to its depots from anywhere.

    Parameters
    ----------
    passages
        Every directed edge it may drive (`malipp_field.mission.passages`).
    """

    def __init__(self, mission: Mission, robot: Robot, passages: Sequence[Passage]) -> None:
        self.passages = {(passage.tail, passage.head): passage for passage in passages}
        self.places = node_positions(mission)
        self.robot = robot
        self._sample_mass_kg = mission.team.sample_mass_kg
        self._home = _least_to(robot.depots, passages)

    def missing(self, stop: Stop) -> tuple[str, str] | None:
        """Return the first edge of the leg to a stop that this robot may not drive; `None` for none."""
        return next((edge for edge in _edges(stop) if edge not in self.passages), None)

    def leg_j(self, stop: Stop, payload: int) -> float:
        """Return the energy of the leg to a stop with so many samples on board."""
        return self._mass_kg(payload) * sum(self.passages[edge].energy_per_kg for edge in _edges(stop))

    def home_j(self, node: str, payload: int) -> float:
        """Return the least energy to an authorised depot; infinite where no way leads to one."""
        return self._mass_kg(payload) * self._home.get(node, math.inf)

    def _mass_kg(self, payload: int) -> float:
        return self.robot.empty_mass_kg + self._sample_mass_kg * payload


class _Standing(NamedTuple):
    """A robot that is ready to leave a stop.

    ``left_j``, ``home_j`` and ``rest_j`` are its energy, what the shortest way home takes with what is on
    board, and what the rest of its plan takes.
    """

    number: int
    stop: Stop
    left_j: float
    home_j: float
    rest_j: float

    @property
    def spot_words(self) -> str:
        return f"stop {self.number} at {self.stop.node}"


def energy_findings(
    route: RobotPlan, roads: Roads, begin_j: float, reserve_share: float
) -> Iterator[Finding]:
    """Yield legs that cannot be driven, and stops from which a depot can not, or only just, be reached.

    Parameters
    ----------
    route
        The robot's plan.
    begin_j
        Its energy when the plan begins.
    reserve_share
        Share of that which should be left on coming home.
    """
    spot = Spot(route.id)
    faults = [
        (index, stop, edge)
        for index, stop in enumerate(route.route)
        if (edge := roads.missing(stop)) is not None
    ]
    for index, stop, (tail, head) in faults:
        yield Spot(route.id, None, f"stop {index} at {stop.node}").error(
            "no-way", f"{route.id} may not drive from {tail} to {head}", "plan again: malipp plan"
        )
    if faults:
        return
    standings = _standings(route, roads, begin_j)
    yield from _way_home(spot, standings)
    yield from _reserve(spot, standings, reserve_share * begin_j, reserve_share)


def length_findings(route: RobotPlan, roads: Roads) -> Iterator[Finding]:
    """Yield edges whose length is not that of the straight way which the vehicle will drive."""
    driven = dict.fromkeys(frozenset(edge) for stop in route.route for edge in _edges(stop))
    for edge in driven:
        tail, head = sorted(edge)
        passage = roads.passages.get((tail, head)) or roads.passages.get((head, tail))
        straight_m = math.dist(roads.places[tail], roads.places[head])
        if passage is not None and abs(passage.length_m - straight_m) > _STRAIGHT * straight_m + 1.0:
            yield Spot(route.id, None, f"{tail} to {head}").warning(
                "not-straight",
                f"the mission counts {passage.length_m:.0f} m, the straight way driven is {straight_m:.0f} m",
                "draw the bends by via nodes, or correct length_m",
            )


def _least_to(depots: Sequence[str], passages: Sequence[Passage]) -> dict[str, float]:
    """Return the least energy for each kilogram from every node to one of the depots (Dijkstra)."""
    into: dict[str, list[Passage]] = defaultdict(list)
    for passage in passages:
        into[passage.head].append(passage)
    found: dict[str, float] = {}
    ahead = [(0.0, depot) for depot in depots]
    while ahead:
        energy, node = heapq.heappop(ahead)
        if node not in found:
            found[node] = energy
            for passage in into[node]:
                heapq.heappush(ahead, (energy + passage.energy_per_kg, passage.tail))
    return found


def _standings(route: RobotPlan, roads: Roads, begin_j: float) -> list[_Standing]:
    loads = [stop.payload for stop in route.route]
    legs_j = [roads.leg_j(stop, before) for stop, before in zip(route.route[1:], loads[:-1], strict=True)]
    left_j, rest_j, found = begin_j, sum(legs_j), []
    for index, (stop, leg_j) in enumerate(zip(route.route, (0.0, *legs_j), strict=True)):
        left_j, rest_j = left_j - leg_j, rest_j - leg_j
        found.append(_Standing(index, stop, left_j, roads.home_j(stop.node, stop.payload), rest_j))
    return found


def _way_home(spot: Spot, standings: Sequence[_Standing]) -> Iterator[Finding]:
    """Yield the first stop from which no depot can be reached, or only by following the plan to its end."""
    for at in standings:
        least_j = min(at.home_j, at.rest_j)
        if _above(least_j, at.left_j):
            yield Spot(spot.robot, None, at.spot_words).error(
                "way-home",
                f"with {at.stop.payload} on board the way to a depot takes {_joules(least_j)}, there are "
                f"{_joules(at.left_j)}",
                "plan again with the energy there is (energy_budget_j), or allow a nearer depot",
            )
            return
    for at in standings:
        if _above(at.home_j, at.left_j):
            yield Spot(spot.robot, None, at.spot_words).warning(
                "turning-home",
                f"cannot be called home from here: with {at.stop.payload} on board the shortest way takes "
                f"{_joules(at.home_j)}, {_joules(at.left_j)} are left; the rest of its plan takes less",
                "plan again with a larger planner.energy_reserve, or let it go on from there",
            )
            return


def _reserve(spot: Spot, standings: Sequence[_Standing], reserve_j: float, share: float) -> Iterator[Finding]:
    """Yield the stop with the least left after the way home, where that is less than the reserve."""
    scarce = [at for at in standings if at.home_j <= at.left_j and _above(reserve_j, at.left_j - at.home_j)]
    if not scarce:
        return
    worst = min(scarce, key=lambda at: at.left_j - at.home_j)
    more = f", below it at {len(scarce)} stops" if len(scarce) > 1 else ""
    yield Spot(spot.robot, None, worst.spot_words).warning(
        "reserve",
        f"a depot is reached from here with {_joules(worst.left_j - worst.home_j)} left, the reserve "
        f"({100 * share:g} %) is {_joules(reserve_j)}{more}",
        f"plan again with planner.energy_reserve of {share:g} or more",
    )


def _edges(stop: Stop) -> Iterator[tuple[str, str]]:
    """Yield the edges of the leg to a stop; that from a depot to its own terminal copy has none."""
    return ((tail, head) for tail, head in pairwise(stop.path or ()) if tail != head)


def _above(value: float, limit: float) -> bool:
    return value > limit + _ROUNDING * max(1.0, abs(limit))


def _joules(energy_j: float) -> str:
    return f"{energy_j / 1000:.2f} kJ" if abs(energy_j) >= 1000 else f"{energy_j:.0f} J"
