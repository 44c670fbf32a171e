"""An exhaustive solver for the tiniest missions, sharing no code with the planner.

Every schedule of every robot is listed by plain recursion (stops in order, and at each the samples taken,
dropped, picked, fetched from stock and unloaded); schedules of two robots are then matched drop by pick.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from malipp_field.field.kernel import covariance
from malipp_field.mission import Mission, TeamState, initial_state, locate, node_positions, passages

Counts = tuple[tuple[str, int], ...]
_SLACK = 1e-9


@dataclass(frozen=True)
class Schedule:
    """One way for one robot to spend the mission."""

    nodes: tuple[str, ...]
    collects: Counts
    drops: Counts
    picks: Counts
    fetches: Counts
    energy_j: float


@dataclass
class Rover:
    """What the recursion needs of a robot."""

    start: str
    depots: tuple[str, ...]
    mass_kg: float
    budget_j: float
    capacity: int
    limit: dict[str, int]
    on_board: int
    cost: dict[tuple[str, str], float]
    stops: tuple[str, ...]
    sample_mass_kg: float
    stock: dict[str, int]
    handoffs: bool


def optimum(
    mission: Mission, state: TeamState | None = None, *, handoffs: bool = True
) -> tuple[float, float] | None:
    """Return the least J and, for it, the least energy; None where there is no plan. One or two robots."""
    state = state or initial_state(mission)
    handoffs = handoffs and len(mission.team.robots) == 2
    listed = [list(_schedules(_rover(mission, state, i, handoffs))) for i in range(len(mission.team.robots))]
    known: dict[tuple[Counts, ...], float] = {}
    best: tuple[float, float] | None = None
    for team in _teams(listed):
        if not _stock_is_fetched(state, team) or not _in_order(team):
            continue
        key = tuple(schedule.collects for schedule in team)
        if key not in known:
            known[key] = _information(mission, state, key)
        rank = (known[key], sum(schedule.energy_j for schedule in team))
        if best is None or rank[0] < best[0] - _SLACK or (rank[0] < best[0] + _SLACK and rank[1] < best[1]):
            best = rank
    return best


def _teams(listed: list[list[Schedule]]) -> Iterator[tuple[Schedule, ...]]:
    if len(listed) == 1:
        yield from ((schedule,) for schedule in listed[0])
        return
    partners: dict[tuple[Counts, Counts], list[Schedule]] = {}
    for schedule in listed[1]:
        partners.setdefault((schedule.drops, schedule.picks), []).append(schedule)
    for schedule in listed[0]:
        for other in partners.get((schedule.picks, schedule.drops), ()):
            yield schedule, other


def _rover(mission: Mission, state: TeamState, i: int, handoffs: bool) -> Rover:
    robot, now = mission.team.robots[i], state.robots[i]
    roles = {node.id: node.role for node in mission.site.nodes}
    stock = {cache.node: cache.count for cache in state.caches}
    stops = [node for node, role in roles.items() if role in {"candidate", "depot"} or node in stock]
    return Rover(
        start=now.node,
        depots=robot.depots,
        mass_kg=robot.empty_mass_kg,
        budget_j=now.energy_left_j * (1.0 - mission.planner.energy_reserve),
        capacity=robot.payload_capacity,
        limit={
            node: robot.samples_per_node - now.collected.get(node, 0)
            if role == "candidate" and node not in state.barren
            else 0
            for node, role in roles.items()
        },
        on_board=now.on_board,
        cost=_cheapest(mission, robot.id),
        stops=tuple(node for node in stops if node != now.node),
        sample_mass_kg=mission.team.sample_mass_kg,
        stock=stock,
        handoffs=handoffs,
    )


def _cheapest(mission: Mission, robot_id: str) -> dict[tuple[str, str], float]:
    """Floyd and Warshall's all-pairs cheapest ways."""
    nodes = [node.id for node in mission.site.nodes]
    cost = {(u, v): 0.0 if u == v else float("inf") for u in nodes for v in nodes}
    for edge in passages(mission, robot_id):
        cost[edge.tail, edge.head] = min(cost[edge.tail, edge.head], edge.energy_per_kg)
    for k, u, v in itertools.product(nodes, nodes, nodes):
        cost[u, v] = min(cost[u, v], cost[u, k] + cost[k, v])
    return cost


def _schedules(rover: Rover) -> Iterator[Schedule]:
    """Yield the cheapest schedule of every order of stops and every way of handling samples there."""
    found: dict[tuple[object, ...], Schedule] = {}
    for schedule in _extend(rover, (rover.start,), rover.on_board, 0.0, [], [], [], []):
        key = (schedule.nodes[:-1], schedule.collects, schedule.drops, schedule.picks, schedule.fetches)
        if key not in found or schedule.energy_j < found[key].energy_j:
            found[key] = schedule
    yield from found.values()


def _extend(
    rover: Rover,
    nodes: tuple[str, ...],
    load: int,
    energy: float,
    collects: list[tuple[str, int]],
    drops: list[tuple[str, int]],
    picks: list[tuple[str, int]],
    fetches: list[tuple[str, int]],
) -> Iterator[Schedule]:
    """Do something at the last node, then end at a depot or go on."""
    here = nodes[-1]
    for take, give, pick, fetch, leaving in _operations(rover, here, load):
        done = (
            [*collects, *([(here, take)] if take else [])],
            [*drops, *([(here, give)] if give else [])],
            [*picks, *([(here, pick)] if pick else [])],
            [*fetches, *([(here, fetch)] if fetch else [])],
        )
        mass = rover.mass_kg + rover.sample_mass_kg * leaving
        for depot in rover.depots:
            if depot == here and len(nodes) > 1:
                continue
            spent = energy + rover.cost[here, depot] * mass
            if spent <= rover.budget_j * (1 + _SLACK):
                collected, dropped, picked, fetched = (tuple(sorted(part)) for part in done)
                yield Schedule((*nodes, depot), collected, dropped, picked, fetched, spent)
        for node in rover.stops:
            spent = energy + rover.cost[here, node] * mass
            if node not in nodes and spent <= rover.budget_j * (1 + _SLACK):
                yield from _extend(rover, (*nodes, node), leaving, spent, *done)


def _operations(rover: Rover, here: str, load: int) -> Iterator[tuple[int, int, int, int, int]]:
    """Yield (collected, dropped, picked, fetched, on board on departure)."""
    room = rover.capacity
    for take in range(max(0, rover.limit.get(here, 0)) + 1):
        for unload in range(load + take + 1) if here in rover.depots else (0,):
            if load + take - unload > room or unload > room:
                continue
            for give in range(min(load + take - unload, room) + 1) if rover.handoffs else (0,):
                for pick in range(room + 1) if rover.handoffs and not give else (0,):
                    for fetch in range(rover.stock.get(here, 0) + 1):
                        leaving = load + take - unload - give + pick + fetch
                        if leaving <= room:
                            yield take, give, pick, fetch, leaving


def _stock_is_fetched(state: TeamState, team: tuple[Schedule, ...]) -> bool:
    wanted = {cache.node: cache.count for cache in state.caches}
    for schedule in team:
        for node, count in schedule.fetches:
            wanted[node] -= count
    return not any(wanted.values())


def _in_order(team: tuple[Schedule, ...]) -> bool:
    """Tell whether the stops can be put in an order in which every drop comes before its pick."""
    if len(team) == 1:
        return True
    done = [-1, -1]  # last stop finished, by robot
    moved = True
    while moved:
        moved = False
        for r in (0, 1):
            schedule, other = team[r], team[1 - r]
            while done[r] + 1 < len(schedule.nodes):
                node = schedule.nodes[done[r] + 1]
                waits = dict(schedule.picks).get(node, 0) and done[r] + 1 < len(schedule.nodes) - 1
                if waits and other.nodes[:-1].index(node) > done[1 - r]:
                    break
                done[r] += 1
                moved = True
    return all(done[r] == len(team[r].nodes) - 1 for r in (0, 1))


def _information(mission: Mission, state: TeamState, collects: tuple[Counts, ...]) -> float:
    """Return the weighted posterior variance by conditioning on every single sample (eq:generic_llse2)."""
    places = node_positions(mission)
    points, noise = [], []
    for robot, now, taken in zip(mission.team.robots, state.robots, collects, strict=True):
        for node, count in [*now.collected.items(), *taken]:
            points += [places[node]] * count
            noise += [robot.noise_variance] * count
    tests = mission.field.test_points
    weights: NDArray[np.float64] = np.array([point.weight for point in tests])
    prior = mission.field.kernel.variance * float(weights.sum())
    if not points:
        return prior
    t = np.array([locate(point, mission.site.origin) for point in tests])
    gram = covariance(mission.field.kernel, points, points) + np.diag(noise)
    cross = covariance(mission.field.kernel, t, points)
    return prior - float(weights @ np.einsum("tv,vt->t", cross, np.linalg.solve(gram, cross.T)))
