"""Seq-LIPP: one robot after the other, each planned against what those before it have secured.

Initialization section of the paper: at each step every robot still free is planned against the current
posterior, and the one that lowers the team's J most is committed. Robots may unload on the way; they never
hand over. Samples left lying when the plan begins are first shared out, as cheaply as the team can fetch
them without handing over.

Each robot's problem is cut down to the nodes in its reach. Its plan is exact where all it could do can be
listed (`alone`) in a part of the time, with so many schedules for the whole team. Where that is too much,
some thousand iterations of ruin and recreate (`focus`, along its route) stand in for a proof: on large sites
the baseline is a good one, not the exact one, and its progress says so.
A plan is kept from step to step while nothing was secured that its robot could tell anything about, up to a
covariance of 1e-5. What a robot gains can hardly grow by what others secure, so robots whose plans are not
proven, and all of them once time gets short, are planned anew only while one of them seems to gain most. When
time is up, robots not yet committed follow the plans they have.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np

from malipp_field.field import Information
from malipp_field.planner.exact.lexicographic import solve_exact
from malipp_field.planner.exact.milp import TeamModel
from malipp_field.planner.exact.schedules import MOST_PLACES
from malipp_field.planner.exact.stages import least_makespan
from malipp_field.planner.extract import Route, TeamPlan, read_routes, team_plan
from malipp_field.planner.linear import Effort
from malipp_field.planner.paper.alone import Options, options_of, plan_alone
from malipp_field.planner.problem import IntArray, Problem, RobotView, prune
from malipp_field.planner.progress import Search
from malipp_field.planner.search.focus import Focus
from malipp_field.planner.search.focus_slice import given, sliced

_ROUNDS = 6
"""Coolings, each up to twice as long as the one before, where schedules cannot be listed."""
_PLANS = 4
"""How often each robot is planned, about: it is given its part of the time left for so many."""
_LISTING_SHARE = 0.5
"""Part of the time for listing what robots can do; those not listed by then are searched."""
_MOST_CODES = 50_000_000
"""Operation codes of all that is listed, two bytes each and about as much again for working out J."""
_EAGER_SHARE = 0.6
"""Part of the time in which all listed robots are planned anew at every step; later, who promises most."""
_MOST_NODES = 500
"""Nodes of a robot's problem, and what it must visit: of a large site those nearest to it and its depots."""
_STRANGERS = 1e-5
"""Covariance, as a share of the largest variance, up to which two candidates count as unrelated."""


@dataclass
class _Robot:
    """One robot on its own.

    Attributes
    ----------
    alone : Problem
        The whole problem with this robot only, and its share of the stock.
    nodes : array
        Those in its reach, as the whole problem numbers them.
    positions : array
        The candidates among them, as positions in V.
    gain
        By how much its plan lowers J, when it was made.
    """

    alone: Problem
    nodes: IntArray
    positions: IntArray
    options: Options | None
    plan: TeamPlan | None = None
    gain: float = 0.0
    stale: bool = True

    @property
    def promise(self) -> tuple[float, tuple[float, float, float]]:
        """Return what robots are ranked by, the least first: how much their plans lower J, then the rest."""
        return (-math.inf, (0.0, 0.0, 0.0)) if self.plan is None else (-self.gain, self.plan.rank)

    def informed(self, known: Information) -> Problem:
        """Return its problem over its nodes, J given all that is ``known``.

        Made anew each time: kept for all robots, closures and covariances of large sites take gigabytes.
        """
        own = np.ix_(self.positions, self.positions)
        information = Information(known.k_vv[own], known.k_tv[:, self.positions], known.k_tt, known.weights)
        return sliced(self.alone, [0], self.nodes, information)

    def route(self, plan: TeamPlan) -> Route:
        """Return the route of a plan in the whole problem's nodes."""
        return tuple(replace(visit, node=int(self.nodes[visit.node])) for visit in plan.routes[0])


def solve_sequential(problem: Problem, search: Search) -> TeamPlan | None:
    """Return the Seq-LIPP plan, or None where the robots cannot manage one by one (or time runs out)."""
    shares = share_stock(problem, search)
    if shares is None:
        return None
    robots = _robots(problem, shares, search.share(_LISTING_SHARE).effort)
    eager = search.share(_EAGER_SHARE).effort
    listed = all(robot.options is not None for robot in robots)
    stage = "sequential" if listed else "sequential, some robots searched"
    routes: dict[int, Route] = {}
    everywhere, precision = np.arange(len(problem.candidates)), problem.gained.copy()
    known = given(problem.information, precision, everywhere)
    strangers = _STRANGERS * np.diag(problem.information.k_vv).max(initial=0.0)
    while len(routes) < len(robots):
        free = [r for r in range(len(robots)) if r not in routes]
        best = _first(robots, free, known, search, eager)
        if best is None:
            return None
        chosen, plan = robots[best], robots[best].plan
        assert plan is not None
        if chosen.options is not None and not search.effort.over:
            plan, _ = least_makespan(chosen.informed(known), search.share(0.5 / len(free)), plan)
        routes[best] = chosen.route(plan)
        secured = np.zeros_like(precision)
        secured[chosen.positions] = plan.precision
        _wake([robots[r] for r in free], known, np.flatnonzero(secured), strangers)
        known = given(known, secured, everywhere)
        precision += secured
        told = replace(plan, information=problem.information.value(precision))
        search.tell(stage, told, None, len(routes))
    return team_plan(problem, tuple(routes[r] for r in range(len(robots))))


def _first(
    robots: list[_Robot], free: list[int], known: Information, search: Search, eager: Effort
) -> int | None:
    """Return which robot is committed next, its plan up to date; None where one has no way at all."""
    share = 1.0 / (_PLANS * len(free))
    for r in free:
        robot = robots[r]
        planned = robot.plan is not None
        if planned and not (robot.stale and robot.options is not None and not eager.over):
            continue
        if not _plan(robot, known, search.share(share)):
            return None
    while True:
        best = min(free, key=lambda r: robots[r].promise)
        if not robots[best].stale or search.effort.over:
            return best
        if not _plan(robots[best], known, search.share(share)):
            return None


def _robots(problem: Problem, shares: list[tuple[int, ...]], effort: Effort) -> list[_Robot]:
    """Return every robot on its own, what it can do listed as far as time and memory allow.

    What robots that could stand in for each other can do is listed once.
    """
    position = {v: i for i, v in enumerate(problem.candidates)}
    nothing = Information(np.zeros((0, 0)), np.zeros((0, 0)), np.zeros(0), np.zeros(0))
    listed: dict[tuple[object, ...], Options | None] = {}
    room = _MOST_CODES
    found: list[_Robot] = []
    for r, share in enumerate(shares):
        alone = _alone(problem, r, share)
        view = alone.robots[0]
        nodes = _nodes(alone)
        positions = np.array([position[v] for v in nodes.tolist() if v in position], dtype=np.int64)
        kind = _kind(view, share)
        if kind not in listed:
            few = len(view.places) <= MOST_PLACES and room > 0 and not effort.over
            options = listed[kind] = options_of(sliced(alone, [0], nodes, nothing)) if few else None
            room -= 0 if options is None else options.codes.size
        found.append(_Robot(alone, nodes, positions, listed[kind]))
    return found


def _nodes(alone: Problem) -> IntArray:
    """Return the nodes that a robot may need; of very many those that take it the least way to a depot."""
    view = alone.robots[0]
    must = {view.start, *view.depots, *(stock.node for stock in alone.stocks if stock.count)}
    places = np.array([v for v in view.stops if v not in must], dtype=np.int64)
    if len(places) > _MOST_NODES:
        cost = view.closure.energy_per_kg
        way = cost[view.start, places] + cost[:, list(view.depots)].min(axis=1)[places]
        places = places[np.argsort(way, kind="stable")[:_MOST_NODES]]
    return np.array(sorted({*must, *places.tolist()}), dtype=np.int64)


def _kind(view: RobotView, share: tuple[int, ...]) -> tuple[object, ...]:
    """Return all that what a robot can do hangs on."""
    ways = id(view.closure), view.start, view.stops, view.depots, view.limits.tobytes(), share
    return *ways, view.empty_mass_kg, view.budget_j, view.capacity, view.on_board, view.precision


def _alone(problem: Problem, r: int, fetches: tuple[int, ...]) -> Problem:
    """Return the problem of robot ``r`` on its own, with its share of the stock."""
    stocks = tuple(replace(stock, count=count) for stock, count in zip(problem.stocks, fetches, strict=True))
    return prune(replace(problem, robots=(problem.robots[r],), stocks=stocks, handoffs=False))


def _plan(robot: _Robot, known: Information, search: Search) -> bool:
    """Plan a robot against what is known; return whether it has a way at all."""
    own = robot.informed(known)
    if robot.options is not None:
        robot.plan = plan_alone(own, robot.options)
    else:
        robot.plan = _searched(own, robot.plan, search)
    robot.stale = False
    if robot.plan is None:
        return False
    robot.gain = own.information.prior - robot.plan.information
    return True


def _searched(problem: Problem, known: TeamPlan | None, search: Search) -> TeamPlan | None:
    """Return the plan that ruin and recreate finds for the only robot, begun with ``known``."""
    focus = Focus(problem, search.seed, 1)
    best = focus.construct() if known is None else team_plan(problem, known.routes)
    if best is not None:
        for better in islice(focus.rounds(best, search.effort), _ROUNDS):
            best = better
        return best
    if len(problem.robots[0].places) > MOST_PLACES:
        return None
    return solve_exact(problem, replace(search, on_progress=lambda _: None)).team


def _wake(robots: list[_Robot], known: Information, secured: IntArray, strangers: float) -> None:
    """Mark the robots that could tell something about what is about to be ``secured`` at candidates."""
    related = np.abs(known.k_vv[:, secured]).max(axis=1, initial=0.0)
    for robot in robots:
        robot.stale = robot.stale or bool((related[robot.positions] > strangers).any())


def share_stock(problem: Problem, search: Search) -> list[tuple[int, ...]] | None:
    """Return how many samples of each stock each robot is to fetch; None where they cannot without drops.

    A small model of its own: nobody samples, the team fetches everything for the least energy.
    """
    none = [(0,) * len(problem.stocks) for _ in problem.robots]
    if not problem.stocks:
        return none
    robots = tuple(replace(robot, limits=np.zeros_like(robot.limits)) for robot in problem.robots)
    errands = prune(replace(problem, robots=robots, handoffs=False))
    model = TeamModel(errands, precision=problem.gained, seed=search.seed)
    model.linear.objective(model.energy_terms())
    outcome = model.linear.solve(search.effort, gap=1e-3)
    if outcome.point is None:
        return None
    fetched = [
        {s: sum(visit.fetch.get(s, 0) for visit in route) for s in range(len(problem.stocks))}
        for route in read_routes(model, outcome.point)
    ]
    return [tuple(counts[s] for s in range(len(problem.stocks))) for counts in fetched]
