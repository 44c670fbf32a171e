"""Rules of one robot's route: where it may stop, how it gets there, when, and on what energy."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from malipp_field.mission import Passage, drives_alike, passages
from malipp_field.planner.verifier.case import Case, Violation, Visit, above, differs


@dataclass(frozen=True)
class Leg:
    """The way to one stop, as its path says.

    Attributes
    ----------
    energy_per_kg
        alpha of the path, in joules for each kilogram.
    least_energy_per_kg
        alpha of a minimum-energy path between its ends, which is what an arc of the closure is.
    time_s
        Travel time tau.
    """

    visit: Visit
    energy_per_kg: float
    least_energy_per_kg: float
    time_s: float

    def energy_j(self, sample_mass_kg: float) -> float:
        """Return what the leg takes with the samples that are on board (eq:energy_budget)."""
        return self.energy_per_kg * (self.visit.robot.empty_mass_kg + sample_mass_kg * self.visit.load_in)


@dataclass(frozen=True)
class Roads:
    """What a robot can drive, and alpha between any two nodes (rows and columns by ``index``)."""

    passages: dict[tuple[str, str], Passage]
    index: dict[str, int]
    least: NDArray[np.float64]


def roads_of(case: Case) -> dict[str, Roads]:
    """Return the roads of every robot; those that drive alike have them in common."""
    index = {node: i for i, node in enumerate(case.roles)}
    found: dict[str, Roads] = {}
    for group in drives_alike(case.mission):
        steps = {(p.tail, p.head): p for p in passages(case.mission, group[0])}
        found |= dict.fromkeys(group, Roads(steps, index, _least_energies(steps, index)))
    return found


def legs_of(roads: Roads, route: list[Visit]) -> list[Leg | None]:
    """Return the legs of a route, one for each stop after the first; None where no path can be driven."""
    return [_leg_to(visit, roads) for visit in route[1:]]


def _least_energies(roads: dict[tuple[str, str], Passage], index: dict[str, int]) -> NDArray[np.float64]:
    """Return alpha between any two nodes by the recursion of Floyd and Warshall.

    Not the shortest paths the planner uses, so that a fault in either shows.
    """
    least = np.full((len(index), len(index)), np.inf)
    np.fill_diagonal(least, 0.0)
    for (tail, head), passage in roads.items():
        least[index[tail], index[head]] = passage.energy_per_kg
    for k in range(len(least)):
        least = np.minimum(least, least[:, k, None] + least[None, k, :])
    return least


def _leg_to(visit: Visit, roads: Roads) -> Leg | None:
    path, before = visit.stop.path, visit.before
    if before is None or not path or (path[0], path[-1]) != (before.node, visit.stop.node):
        return None
    steps = list(pairwise(path))
    if visit.stop.node not in roads.index or not all(step in roads.passages for step in steps):
        return None
    return Leg(
        visit=visit,
        energy_per_kg=sum(roads.passages[step].energy_per_kg for step in steps),
        least_energy_per_kg=float(roads.least[roads.index[before.node], roads.index[visit.stop.node]]),
        time_s=sum(roads.passages[step].time_s for step in steps),
    )


def route_rules(case: Case, route: list[Visit], legs: list[Leg | None]) -> Iterator[Violation]:
    """Yield what is wrong with the stops, legs, times and energy of one robot."""
    yield from _start(case, route[0])
    yield from _stops(case, route)
    yield from _end(route)
    for visit, leg in zip(route[1:], legs, strict=True):
        if None in {visit.stop.path, visit.stop.arrive_s, visit.stop.leg_energy_j}:
            yield visit.breaks(
                "format:stop", "every stop after the first has path, arrive_s and leg_energy_j"
            )
        elif leg is None and all(end.node in case.roles for end in (visit.stop, visit.before) if end):
            yield visit.breaks(
                "format:path", "its path is no way from the stop before that this robot can drive"
            )
        if leg is not None:
            yield from _leg(case, leg)
    energy_j, begin = route_energy_j(case, legs), route[0].begin
    if energy_j is not None and above(energy_j, begin.energy_left_j):
        yield Violation(
            "eq:energy_budget", begin.id, None,
            f"the route takes {energy_j:.6g} J, there are {begin.energy_left_j:.6g} J",
        )  # fmt: skip


def route_energy_j(case: Case, legs: list[Leg | None]) -> float | None:
    """Return the energy of a route, recomputed; None where a leg cannot be driven."""
    known = [leg.energy_j(case.mission.team.sample_mass_kg) for leg in legs if leg is not None]
    return sum(known) if len(known) == len(legs) else None


def _start(case: Case, first: Visit) -> Iterator[Violation]:
    begin, stop, beta_s = first.begin, first.stop, case.mission.team.service_time_s
    if stop.node != begin.node:
        yield first.breaks("eq:start", f"the route begins here, the robot is at {begin.node}")
    if above(begin.ready_s + beta_s, stop.depart_s):
        yield first.breaks(
            "eq:start_time",
            f"departs at {stop.depart_s:.6g} s, service is not over before {begin.ready_s + beta_s:.6g} s",
        )
    if (stop.path, stop.arrive_s, stop.leg_energy_j) != (None, None, None):
        yield first.breaks("format:stop", "the first stop has no path, arrive_s or leg_energy_j")


def _stops(case: Case, route: list[Visit]) -> Iterator[Violation]:
    """Yield stops outside the routing set, and physical nodes that are visited twice."""
    start = route[0].stop.node
    routing = {node for node, role in case.roles.items() if role in {"candidate", "depot"}}
    routing |= {start} | {cache.node for cache in case.state.caches}
    seen = {start}
    for visit in route[1:]:
        node = visit.stop.node
        if node not in case.roles:
            yield visit.breaks("format:names", "the mission has no such node")
        elif node not in routing:
            yield visit.breaks("subsec:routing", f"nodes of role {case.roles[node]} are for passage only")
        if visit.last:
            continue
        if node == start:
            yield visit.breaks("eq:start", "no leg leads back into the start, but to its terminal copy")
        elif node in seen:
            yield visit.breaks("eq:visit_terminal", "a robot operates at each node at most once")
        seen.add(node)


def _end(route: list[Visit]) -> Iterator[Violation]:
    last = route[-1]
    if last.stop.node not in last.robot.depots:
        yield last.breaks(
            "eq:terminal_select", f"the route ends here, authorised depots are {', '.join(last.robot.depots)}"
        )
    if len(route) > 2 and last.before is not None and last.before.node == last.stop.node:
        yield last.breaks("subsec:routing", "the terminal copy of a depot has no leg from the depot itself")


def _leg(case: Case, leg: Leg) -> Iterator[Violation]:
    visit, stop, before = leg.visit, leg.visit.stop, leg.visit.before
    assert before is not None
    if above(leg.energy_per_kg, leg.least_energy_per_kg):
        yield visit.breaks(
            "subsec:setting",
            f"the path takes {leg.energy_per_kg:.6g} J/kg, the cheapest {leg.least_energy_per_kg:.6g} J/kg",
        )
    energy_j = leg.energy_j(case.mission.team.sample_mass_kg)
    if stop.leg_energy_j is not None and differs(stop.leg_energy_j, energy_j):
        yield visit.breaks(
            "format:leg_energy",
            f"leg_energy_j is {stop.leg_energy_j:.6g}; with {visit.load_in} on board it is {energy_j:.6g}",
        )
    yield from _times(case, leg, before.depart_s)


def _times(case: Case, leg: Leg, left_s: float) -> Iterator[Violation]:
    visit, stop, beta_s = leg.visit, leg.visit.stop, case.mission.team.service_time_s
    there_s = left_s + leg.time_s
    if above(there_s + beta_s, stop.depart_s):
        yield visit.breaks(
            "eq:time_propagation",
            f"departs at {stop.depart_s:.6g} s; travel and service end at {there_s + beta_s:.6g} s",
        )
    elif stop.arrive_s is not None and (
        above(there_s, stop.arrive_s) or above(stop.arrive_s + beta_s, stop.depart_s)
    ):
        yield visit.breaks(
            "format:arrival",
            f"arrive_s is {stop.arrive_s:.6g}; the way ends at {there_s:.6g} s and service begins at "
            f"{stop.depart_s - beta_s:.6g} s",
        )
