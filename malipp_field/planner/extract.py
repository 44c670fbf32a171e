"""From a solver's point to a plan: routes, operations, exact energies and the earliest times."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from graphlib import CycleError, TopologicalSorter
from itertools import pairwise

import numpy as np

from malipp_field.field import FloatArray
from malipp_field.plan import Bound, Objective, Plan, RobotPlan, Stop
from malipp_field.plan.schema import Status
from malipp_field.planner.exact.milp import TeamModel
from malipp_field.planner.problem import Problem, RobotView, within


@dataclass(frozen=True)
class Visit:
    """One stop of a robot: what it does there. Robots and stocks are indices into the problem."""

    node: int
    collect: int = 0
    drop: Mapping[int, int] = field(default_factory=dict)
    pick: Mapping[int, int] = field(default_factory=dict)
    fetch: Mapping[int, int] = field(default_factory=dict)
    unload: int = 0

    @property
    def idle(self) -> bool:
        """Whether nothing is done here."""
        return not (self.collect or self.drop or self.pick or self.fetch or self.unload)

    @property
    def change(self) -> int:
        """Samples on board after the visit less those before it."""
        taken = self.collect + sum(self.pick.values()) + sum(self.fetch.values())
        return taken - sum(self.drop.values()) - self.unload


Route = tuple[Visit, ...]
"""From the start to the terminal; a robot that stays at an authorised depot has one visit."""
Place = tuple[int, int]
"""A stop: robot, and index in its route."""


@dataclass(frozen=True)
class TeamPlan:
    """Routes of the team with everything that follows from them."""

    routes: tuple[Route, ...]
    depart_s: tuple[tuple[float, ...], ...]
    precision: FloatArray
    information: float
    energy_j: float
    makespan_s: float

    @property
    def rank(self) -> tuple[float, float, float]:
        """The lexicographic objective."""
        return (self.information, self.energy_j, self.makespan_s)


def read_routes(model: TeamModel, point: FloatArray) -> tuple[Route, ...]:
    """Return the routes at an integer point of the model, without stops at which nothing is done."""
    return tuple(tidy(_read_route(model, point, r)) for r in range(len(model.problem.robots)))


def _read_route(model: TeamModel, point: FloatArray, r: int) -> Route:
    columns, n = model.columns, len(model.problem.nodes)
    following = {u: v for (u, v), column in columns.x[r].items() if point[column] > 0.5}
    visits, slot = [], model.problem.robots[r].start
    while True:
        visits.append(_read_visit(model, point, r, slot))
        if slot >= n:
            return tuple(visits)
        slot = following[slot]


def _read_visit(model: TeamModel, point: FloatArray, r: int, slot: int) -> Visit:
    columns = model.columns

    def count(column: int | None) -> int:
        return 0 if column is None else round(float(point[column]))

    drop = {o: count(c) for (s, o, v), c in columns.h.items() if (s, v) == (r, slot) and count(c)}
    pick = {s: count(c) for (s, o, v), c in columns.h.items() if (o, v) == (r, slot) and count(c)}
    fetch = {
        s: count(c) for (o, s), c in columns.fetch.items()
        if o == r and model.problem.stocks[s].node == slot and count(c)
    }  # fmt: skip
    return Visit(
        node=slot % len(model.problem.nodes),
        collect=count(columns.a[r].get(slot)),
        drop=drop,
        pick=pick,
        fetch=fetch,
        unload=count(columns.g[r].get(slot)),
    )


def tidy(route: Route) -> Route:
    """Leave out idle stops, and close the route of a robot that stays at its depot in one visit."""
    kept = _without_leg_to_own_copy((route[0], *(v for v in route[1:-1] if not v.idle), route[-1]), route)
    first, last = kept[0], kept[-1]
    if len(kept) == 2 and first.node == last.node and not first.pick and not first.fetch:
        return (replace(first, unload=first.unload + last.unload),)
    return kept


def _without_leg_to_own_copy(kept: Route, route: Route) -> Route:
    """Mend what leaving out idle stops may have made: no leg leads from a depot to its own terminal copy.

    What was only unloaded there is unloaded at the end; else the idle stops in between stay.
    """
    *before, inner, last = kept
    if not before or inner.node != last.node:
        return kept
    if replace(inner, unload=0).idle:
        return (*before, replace(last, unload=last.unload + inner.unload))
    return (*before, *route[route.index(inner) :])


def team_plan(problem: Problem, routes: tuple[Route, ...]) -> TeamPlan | None:
    """Return routes with their exact objective; None where they break a budget or wait in a circle."""
    energy = 0.0
    for robot, route in zip(problem.robots, routes, strict=True):
        spent = sum(leg_energies(problem, robot, route))
        if not within(spent, robot.budget_j):
            return None
        energy += spent
    depart_s = earliest_departures(problem, routes)
    if depart_s is None:
        return None
    precision = problem.gained.copy()
    position = {v: i for i, v in enumerate(problem.candidates)}
    for robot, route in zip(problem.robots, routes, strict=True):
        for visit in route:
            if visit.collect:
                precision[position[visit.node]] += visit.collect * robot.precision
    return TeamPlan(
        routes=routes,
        depart_s=depart_s,
        precision=precision,
        information=problem.information.value(precision),
        energy_j=energy,
        makespan_s=max(times[-1] for times in depart_s),
    )


def payloads(robot: RobotView, route: Route) -> list[int]:
    """Return the samples on board on departure from each stop (eq:conservation)."""
    changes = np.cumsum([visit.change for visit in route])
    return [robot.on_board + int(change) for change in changes]


def leg_energies(problem: Problem, robot: RobotView, route: Route) -> list[float]:
    """Return the energy of each leg, in joules."""
    loads = payloads(robot, route)
    return [
        float(robot.closure.energy_per_kg[a.node, b.node])
        * (robot.empty_mass_kg + problem.sample_mass_kg * load)
        for a, b, load in zip(route, route[1:], loads, strict=False)
    ]


def earliest_departures(problem: Problem, routes: tuple[Route, ...]) -> tuple[tuple[float, ...], ...] | None:
    """Return t_v^r of the schedule in which nobody waits without need; None where drops wait in a circle."""
    later = precedence(problem, routes)
    order = in_order(later)
    if order is None:
        return None
    soonest = {}
    for r, (robot, route) in enumerate(zip(problem.robots, routes, strict=True)):
        for k, visit in enumerate(route):
            fetched = [problem.stocks[s].available_s for s in visit.fetch]
            soonest[r, k] = max([robot.ready_s, *fetched]) + problem.service_time_s
    for stop in order:
        for after, wait_s in later[stop].items():
            soonest[after] = max(soonest[after], soonest[stop] + wait_s)
    return tuple(tuple(soonest[r, k] for k in range(len(route))) for r, route in enumerate(routes))


def in_order(later: Mapping[Place, Mapping[Place, float]]) -> list[Place] | None:
    """Return all stops, each before those that wait for it (`precedence`); None if they wait in a circle."""
    sorter: TopologicalSorter[Place] = TopologicalSorter(dict.fromkeys(later, ()))
    for stop, following in later.items():
        for after in following:
            sorter.add(after, stop)
    try:
        return list(sorter.static_order())
    except CycleError:
        return None


def precedence(problem: Problem, routes: tuple[Route, ...]) -> dict[Place, dict[Place, float]]:
    """Return what follows each stop by a leg (eq:time_propagation) or a drop (eq:deaddrop_sync).

    The values are the least times between the two departures, in seconds.
    """
    beta = problem.service_time_s
    later: dict[Place, dict[Place, float]] = {}
    stop_of = {(r, visit.node): k for r, route in enumerate(routes) for k, visit in _operating(route)}
    for r, (robot, route) in enumerate(zip(problem.robots, routes, strict=True)):
        for k in range(len(route)):
            later.setdefault((r, k), {})
        for k, visit in enumerate(route):
            if k:
                leg_s = float(robot.closure.time_s[route[k - 1].node, visit.node])
                later[r, k - 1][r, k] = leg_s + beta
            for o in visit.drop:
                after = o, stop_of[o, visit.node]
                later.setdefault(after, {})
                later[r, k][after] = beta + problem.clearance_s
    return later


def _operating(route: Route) -> list[tuple[int, Visit]]:
    """Return the stops at physical nodes: all but the terminal."""
    return list(enumerate(route))[: max(1, len(route) - 1)]


def start_point(model: TeamModel, team: TeamPlan) -> FloatArray | None:
    """Return the point of the model that stands for a plan; None where it uses what the model left out."""
    columns = model.columns
    point = np.zeros(len(model.linear.cost))
    try:
        for r, route in enumerate(team.routes):
            _set_route(model, point, r, route, team.depart_s[r])
            for slot, visit in zip(_slots(model.problem, route), route, strict=False):
                _set_operations(model, point, r, slot, visit)
    except KeyError:
        return None
    n = len(model.problem.nodes)
    point[columns.end] = max(point[column] for t in columns.t for v, column in t.items() if v >= n)
    model.set_information(point)
    return point


def _slots(problem: Problem, route: Route) -> list[int]:
    """Return the model's slots of a route; one that stays still goes to the terminal copy."""
    n = len(problem.nodes)
    inner = route[:-1] if len(route) > 1 else route
    return [*(visit.node for visit in inner), n + route[-1].node]


def _set_route(
    model: TeamModel, point: FloatArray, r: int, route: Route, depart_s: tuple[float, ...]
) -> None:
    problem, columns, robot = model.problem, model.columns, model.problem.robots[r]
    for column in columns.t[r].values():
        point[column] = robot.ready_s + problem.service_time_s
    slots = _slots(problem, route)
    visits = route if len(route) > 1 else (*route, Visit(route[0].node))
    departs = depart_s if len(route) > 1 else (*depart_s, depart_s[-1] + problem.service_time_s)
    for slot, time_s in zip(slots, departs, strict=True):
        point[columns.y[r][slot]] = 1.0
        point[columns.t[r][slot]] = time_s
    spent = np.cumsum(leg_energies(problem, robot, visits)) / max(robot.budget_j, 1e-9)
    for arc, share, load in zip(pairwise(slots), spent, payloads(robot, visits), strict=False):
        point[columns.x[r][arc]] = 1.0
        point[columns.load[r][arc]] = load
        point[columns.spent[r][arc]] = min(float(share), 1.0)


def _set_operations(model: TeamModel, point: FloatArray, r: int, slot: int, visit: Visit) -> None:
    columns = model.columns
    if visit.collect:
        point[columns.a[r][slot]] = visit.collect
    if visit.unload:
        point[columns.g[r][slot]] = visit.unload
    for o, count in visit.drop.items():
        point[columns.h[r, o, slot]] = count
        point[columns.delta[r, o, slot]] = 1.0
        point[columns.gives[r][slot]] = 1.0
    for s, count in visit.fetch.items():
        point[columns.fetch[r, s]] = count
        point[columns.fetches[r, s]] = 1.0


def routes_of(problem: Problem, plan: Plan) -> tuple[Route, ...]:
    """Return the routes of a plan; raises `KeyError` for names that the mission does not have."""
    index = {node: i for i, node in enumerate(problem.nodes)}
    team = {robot.id: r for r, robot in enumerate(problem.robots)}
    return tuple(
        tuple(_visit_of(problem, plan, robot.id, stop, index, team) for stop in plan.robot(robot.id).route)
        for robot in problem.robots
    )


def _visit_of(
    problem: Problem, plan: Plan, robot_id: str, stop: Stop, index: dict[str, int], team: dict[str, int]
) -> Visit:
    """Return a stop as a visit; what it picks beyond the drops made for it comes from stock."""
    pick: dict[int, int] = {}
    fetch: dict[int, int] = {}
    for sender, count in stop.pick.items():
        dropped = 0
        if sender != robot_id:
            stops = [s for s in plan.robot(sender).route if s.node == stop.node]
            dropped = sum(s.drop.get(robot_id, 0) for s in stops)
        if dropped:
            pick[team[sender]] = min(dropped, count)
        rest = count - dropped
        for s, stock in enumerate(problem.stocks):
            if rest > 0 and problem.nodes[stock.node] == stop.node and stock.sender == sender:
                fetch[s] = min(rest, stock.count)
                rest -= fetch[s]
    return Visit(
        node=index[stop.node],
        collect=stop.collect,
        drop={team[receiver]: count for receiver, count in stop.drop.items()},
        pick=pick,
        fetch=fetch,
        unload=stop.unload,
    )


@dataclass(frozen=True)
class Verdict:
    """How a search ended: what the plan file says beside the routes."""

    method: str
    status: Status
    bound: float | None
    gap: float | None
    solve_time_s: float
    seed: int
    version: int


def plan_file(name: str, problem: Problem, team: TeamPlan, verdict: Verdict) -> Plan:
    """Return the plan of mission ``name`` in the terms of the plan format."""
    return Plan(
        mission=name,
        version=verdict.version,
        method=verdict.method,
        status=verdict.status,
        objective=Objective(information=team.information, energy_j=team.energy_j, makespan_s=team.makespan_s),
        bound=Bound(information=verdict.bound),
        gap=verdict.gap,
        solve_time_s=verdict.solve_time_s,
        seed=verdict.seed,
        robots=tuple(
            RobotPlan(id=robot.id, route=_stops(problem, robot, route, times))
            for robot, route, times in zip(problem.robots, team.routes, team.depart_s, strict=True)
        ),
    )


def _stops(problem: Problem, robot: RobotView, route: Route, depart_s: tuple[float, ...]) -> tuple[Stop, ...]:
    loads = payloads(robot, route)
    energies = leg_energies(problem, robot, route)
    stops = []
    for k, visit in enumerate(route):
        done = _operations(problem, visit)
        leg: dict[str, object] = {}
        if k:
            before = route[k - 1].node
            leg = {
                "path": robot.closure.paths[before, visit.node],
                "arrive_s": depart_s[k - 1] + float(robot.closure.time_s[before, visit.node]),
                "leg_energy_j": energies[k - 1],
            }
        stops.append(
            Stop.model_validate(
                {
                    "node": problem.nodes[visit.node],
                    "depart_s": depart_s[k],
                    "payload": loads[k],
                    **done,
                    **leg,
                }
            )
        )
    return tuple(stops)


def _operations(problem: Problem, visit: Visit) -> dict[str, object]:
    """Return the operations of a visit by name; stock counts as picked from the robot that left it."""
    ids = [robot.id for robot in problem.robots]
    pick = {ids[o]: count for o, count in visit.pick.items()}
    for s, count in visit.fetch.items():
        sender = problem.stocks[s].sender
        pick[sender] = pick.get(sender, 0) + count
    return {
        "collect": visit.collect,
        "drop": {ids[o]: count for o, count in visit.drop.items()},
        "pick": pick,
        "unload": visit.unload,
    }
