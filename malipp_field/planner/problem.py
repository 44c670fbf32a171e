"""What the solvers read: a mission and the state of its team as arrays, without what cannot happen."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from malipp_field.field import FloatArray, Information, candidate_ids, information_model
from malipp_field.mission import (
    Mission,
    Robot,
    RobotState,
    TeamState,
    drives_alike,
    initial_state,
    passages,
)
from malipp_field.planner.closure import Closure, closure

IntArray = NDArray[np.int64]
Arc = tuple[int, int]
"""Tail node and head; a head of ``len(nodes) + d`` is the terminal copy of depot d."""


@dataclass(frozen=True)
class RobotView:
    """One robot as the solvers see it; nodes are indices into `Problem.nodes`.

    Attributes
    ----------
    stops : tuple of int
        Physical nodes where it may operate after its start (the start is not among them).
    depots : tuple of int
        D_r as far as they can be reached.
    budget_j, ready_s, on_board
        What is left of B_r, when and with how many samples on board the free part begins.
    limits : array, shape (N,)
        Samples it may still take at each node.
    precision
        1 / sigma_r^2.
    """

    id: str
    start: int
    stops: tuple[int, ...]
    depots: tuple[int, ...]
    closure: Closure
    empty_mass_kg: float
    budget_j: float
    capacity: int
    limits: IntArray
    precision: float
    on_board: int
    ready_s: float

    @property
    def places(self) -> tuple[int, ...]:
        """Every physical node where it may operate, the start first."""
        return (self.start, *self.stops)


@dataclass(frozen=True)
class Stock:
    """Samples lying at a node; ``sender`` is the id of the robot that dropped them."""

    node: int
    sender: str
    count: int
    available_s: float


@dataclass(frozen=True)
class Problem:
    """A mission from a given state on.

    Attributes
    ----------
    nodes : tuple of str
        All nodes of the site; every index into nodes refers to this order.
    candidates : tuple of int
        V, in the order of ``information``.
    gained : array, shape (V,)
        Precision the team has gained already.
    closed : frozenset of int
        Nodes at which nobody may hand over to anybody; what lies there already may be fetched.
    """

    nodes: tuple[str, ...]
    candidates: tuple[int, ...]
    robots: tuple[RobotView, ...]
    stocks: tuple[Stock, ...]
    information: Information
    gained: FloatArray
    sample_mass_kg: float
    service_time_s: float
    clearance_s: float
    handoffs: bool
    closed: frozenset[int] = frozenset()

    def shared(self, sender: int, receiver: int) -> list[int]:
        """Return the nodes, in order, at which one robot can leave something for another."""
        one, other = self.robots[sender], self.robots[receiver]
        if not self.handoffs or not one.capacity or not other.capacity:
            return []
        places = (set(one.places) & set(other.places)) - self.closed
        if not one.on_board and not one.limits[one.start]:
            places.discard(one.start)
        return sorted(places)

    def arcs(self, r: int) -> list[Arc]:
        """Return the arcs robot ``r`` can use on some way from its start to a depot within its budget."""
        robot, n = self.robots[r], len(self.nodes)
        to_start, to_depot = _reach(robot)
        cost = robot.closure.energy_per_kg
        found = []
        for u in robot.places:
            heads = [(v, v) for v in robot.stops if v != u] + [(n + d, d) for d in robot.depots]
            for head, v in heads:
                if v == u and u != robot.start:
                    continue  # the copy of a depot has the incoming arcs of the depot: none from itself
                rest = to_depot[v] if head < n else 0.0
                if within(robot.empty_mass_kg * (to_start[u] + cost[u, v] + rest), robot.budget_j):
                    found.append((u, head))
        return found


def in_units(problem: Problem) -> tuple[Problem, float]:
    """Return the same problem with variances and J of the order of one, and the unit of J.

    Solvers work with absolute tolerances; a field may be measured in any unit.
    """
    information = problem.information
    unit = information.prior or 1.0
    variance = float(np.diag(information.k_vv).max(initial=0.0)) or 1.0
    scaled = Information(
        information.k_vv / variance,
        information.k_tv / variance,
        information.k_tt / variance,
        information.weights * (variance / unit),
    )
    robots = tuple(replace(robot, precision=robot.precision * variance) for robot in problem.robots)
    return replace(problem, information=scaled, robots=robots, gained=problem.gained * variance), unit


def within(energy_j: float, budget_j: float) -> bool:
    """Tell whether an energy keeps to a budget, rounding errors of exact arithmetic forgiven."""
    return bool(energy_j <= budget_j * (1.0 + 1e-9) + 1e-12)


def build_problem(
    mission: Mission,
    state: TeamState | None = None,
    *,
    handoffs: bool = True,
    closed: Collection[str] = (),
) -> Problem:
    """Return the solvers' view of ``mission`` from ``state`` on, with unreachable stops removed.

    Nobody may hand over at the nodes ``closed``.
    """
    state = state or initial_state(mission)
    nodes = tuple(node.id for node in mission.site.nodes)
    index = {node: i for i, node in enumerate(nodes)}
    stocks = tuple(Stock(index[c.node], c.sender, c.count, c.available_s) for c in state.caches)
    candidates = candidate_ids(mission)
    closures = _closures(mission, state, index, stocks)
    fertile = [node for node in candidates if node not in state.barren]
    taken = [(state.robot(robot.id).collected, robot.noise_variance) for robot in mission.team.robots]
    problem = Problem(
        nodes=nodes,
        candidates=tuple(index[node] for node in candidates),
        robots=tuple(
            _view(mission, robot, state.robot(robot.id), index, stocks, closures[robot.id], fertile)
            for robot in mission.team.robots
        ),
        stocks=stocks,
        information=information_model(mission),
        gained=np.array(
            [sum(collected.get(node, 0) / variance for collected, variance in taken) for node in candidates]
        ),
        sample_mass_kg=mission.team.sample_mass_kg,
        service_time_s=mission.team.service_time_s,
        clearance_s=mission.team.clearance_s,
        handoffs=handoffs and len(mission.team.robots) > 1,
        closed=frozenset(index[node] for node in closed),
    )
    return prune(problem)


def prune(problem: Problem) -> Problem:
    """Return the problem without stops at which a robot has nothing to do.

    Closures are metric, so a stop without a collection, an unloading, a pick or a drop only costs energy.
    """
    stocked = {stock.node for stock in problem.stocks if stock.count}
    visitors = Counter(v for robot in problem.robots if robot.capacity > 0 for v in robot.places)
    robots = []
    for robot in problem.robots:
        hands_over = problem.handoffs and robot.capacity > 0
        useful = tuple(
            v for v in robot.stops
            if robot.limits[v] > 0 or v in robot.depots or v in stocked
            or (hands_over and visitors[v] > 1 and v not in problem.closed)
        )  # fmt: skip
        robots.append(replace(robot, stops=useful))
    return replace(problem, robots=tuple(robots))


def _closures(
    mission: Mission, state: TeamState, index: dict[str, int], stocks: tuple[Stock, ...]
) -> dict[str, Closure]:
    """Return the closure of every robot; robots that drive alike have it in common."""
    routing = _routing(mission, index, stocks)
    found: dict[str, Closure] = {}
    for group in drives_alike(mission):
        terminals = sorted(routing | {index[state.robot(robot_id).node] for robot_id in group})
        shared = closure(passages(mission, group[0]), list(index), terminals)
        found |= dict.fromkeys(group, shared)
    return found


def _routing(mission: Mission, index: dict[str, int], stocks: tuple[Stock, ...]) -> set[int]:
    """Return the nodes at which robots may operate, wherever they start."""
    roles = {"candidate", "depot"}
    return {index[node.id] for node in mission.site.nodes if node.role in roles} | {s.node for s in stocks}


def _view(
    mission: Mission,
    robot: Robot,
    state: RobotState,
    index: dict[str, int],
    stocks: tuple[Stock, ...],
    ways: Closure,
    fertile: Sequence[str],
) -> RobotView:
    start = index[state.node]
    routing = _routing(mission, index, stocks)
    limits = np.zeros(len(index), dtype=np.int64)
    for node in fertile:
        limits[index[node]] = max(0, robot.samples_per_node - state.collected.get(node, 0))
    if robot.payload_capacity == 0:
        limits[:] = 0
    view = RobotView(
        id=robot.id,
        start=start,
        stops=tuple(sorted(routing - {start})),
        depots=tuple(index[depot] for depot in robot.depots),
        closure=ways,
        empty_mass_kg=robot.empty_mass_kg,
        budget_j=state.energy_left_j * (1.0 - mission.planner.energy_reserve),
        capacity=robot.payload_capacity,
        limits=limits,
        precision=1.0 / robot.noise_variance,
        on_board=state.on_board,
        ready_s=state.ready_s,
    )
    return _reachable(view)


def _reachable(robot: RobotView) -> RobotView:
    """Return the robot without stops that lie on no way from start to depot within its budget."""
    to_start, to_depot = _reach(robot)
    mass = robot.empty_mass_kg
    stops = tuple(v for v in robot.stops if within(mass * (to_start[v] + to_depot[v]), robot.budget_j))
    depots = tuple(d for d in robot.depots if within(mass * to_start[d], robot.budget_j))
    return replace(robot, stops=stops, depots=depots)


def _reach(robot: RobotView) -> tuple[FloatArray, FloatArray]:
    """Return alpha from the start to every node, and from every node to the nearest depot."""
    cost = robot.closure.energy_per_kg
    nearest = cost[:, list(robot.depots)].min(axis=1) if robot.depots else np.full(len(cost), np.inf)
    return cost[robot.start], nearest
