"""Seq-LIPP: one robot after the other, each planned against what those before it have secured.

Initialization section of the paper: at each step every robot still free is planned against the current
posterior, and the one that lowers the team's J most is committed. Robots may unload on the way; they never
hand over. Samples left lying when the plan begins are first shared out, as cheaply as the team can fetch
them without handing over.

Each robot's problem is cut down to the nodes in its reach. Its plan is exact where all it could do can be
listed (`malipp_field.planner.alone`). Where that is too much, some thousand iterations of ruin and recreate
(`malipp_field.planner.focus`, along its route) stand in for a proof: on large sites the baseline is a good
one, not the exact one. A plan is kept from step to step while nothing was secured that its robot could tell
anything about, up to a covariance of 1e-5. What a robot gains can hardly grow by what others secure, so
robots whose plans are not proven are planned anew only while one of them seems to gain most. When time is up,
robots not yet committed follow the plans they have.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np

from malipp_field.field import FloatArray, Information
from malipp_field.planner.alone import Options, options_of, plan_alone
from malipp_field.planner.closure import Closure
from malipp_field.planner.exact import solve_exact
from malipp_field.planner.extract import Route, TeamPlan, read_routes, team_plan
from malipp_field.planner.focus import Focus
from malipp_field.planner.focus_slice import given, sliced
from malipp_field.planner.milp import TeamModel
from malipp_field.planner.problem import IntArray, Problem, prune
from malipp_field.planner.progress import Search
from malipp_field.planner.schedules import MOST_PLACES, robots_of
from malipp_field.planner.stages import least_makespan

_ROUNDS = 6
"""Coolings, each up to twice as long as the one before, where schedules cannot be listed."""
_PLANS = 4
"""How often each robot is planned, about: it is given its part of the time left for so many."""
_STRANGERS = 1e-5
"""Covariance, as a share of the largest variance, up to which two candidates count as unrelated."""


@dataclass
class _Robot:
    """One robot on its own.

    Attributes
    ----------
    problem : Problem
        Over the nodes in its reach, with its share of the stock, but without J.
    nodes : array
        These nodes, as the whole problem numbers them.
    positions : array
        The candidates among them, as positions in V.
    gain
        By how much its plan lowers J, when it was made.
    """

    problem: Problem
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

    def informed(self, information: Information, precision: FloatArray) -> Problem:
        """Return its problem with J given the precision secured; kept for all robots at once it is large."""
        own = given(information, precision, self.positions)
        return replace(self.problem, information=own, gained=np.zeros(len(self.positions)))

    def route(self, plan: TeamPlan) -> Route:
        """Return the route of a plan in the whole problem's nodes."""
        return tuple(replace(visit, node=int(self.nodes[visit.node])) for visit in plan.routes[0])


def solve_sequential(problem: Problem, search: Search) -> TeamPlan | None:
    """Return the Seq-LIPP plan, or None where the robots cannot manage one by one (or time runs out)."""
    shares = share_stock(problem, search)
    if shares is None:
        return None
    robots = _robots(problem, shares)
    routes: dict[int, Route] = {}
    precision = problem.gained.copy()
    while len(routes) < len(robots):
        free = [r for r in range(len(robots)) if r not in routes]
        best = _first(problem, robots, free, precision, search)
        if best is None:
            return None
        chosen, plan = robots[best], robots[best].plan
        assert plan is not None
        if chosen.options is not None and not search.effort.over:
            own = chosen.informed(problem.information, precision)
            plan, _ = least_makespan(own, search.share(0.5 / len(free)), plan)
        routes[best] = chosen.route(plan)
        secured = np.zeros_like(precision)
        secured[chosen.positions] = plan.precision
        _wake(problem, [robots[r] for r in free], precision, np.flatnonzero(secured))
        precision += secured
        told = replace(plan, information=problem.information.value(precision))
        search.tell("sequential", told, None, len(routes))
    return team_plan(problem, tuple(routes[r] for r in range(len(robots))))


def _first(
    problem: Problem, robots: list[_Robot], free: list[int], precision: FloatArray, search: Search
) -> int | None:
    """Return which robot is committed next, its plan up to date; None where one has no way at all."""
    share = 1.0 / (_PLANS * len(free))
    while True:
        best = min(free, key=lambda r: robots[r].promise)
        over = search.effort.over
        stale = [r for r in free if robots[r].stale and not (over and robots[r].plan is not None)]
        first = [r for r in stale if robots[r].options is not None or robots[r].plan is None]
        if best not in stale and not first:
            return best
        for r in first or [best]:
            if not _plan(problem, robots[r], precision, search.share(share)):
                return None


def _robots(problem: Problem, shares: list[tuple[int, ...]]) -> list[_Robot]:
    """Return every robot on its own; those that could stand in for each other are listed once."""
    position = {v: i for i, v in enumerate(problem.candidates)}
    twins = [robot.twins for robot in robots_of(replace(problem, handoffs=False))]
    nothing = Information(np.zeros((0, 0)), np.zeros((0, 0)), np.zeros(0), np.zeros(0))
    closures: dict[tuple[int, bytes], Closure] = {}
    found: list[_Robot] = []
    for r, share in enumerate(shares):
        alone = _alone(problem, r, share)
        nodes = np.array(sorted({*alone.robots[0].places, *alone.robots[0].depots}), dtype=np.int64)
        positions = np.array([position[v] for v in nodes.tolist() if v in position], dtype=np.int64)
        part = sliced(alone, [0], nodes, nothing)
        ways = closures.setdefault((id(problem.robots[r].closure), nodes.tobytes()), part.robots[0].closure)
        part = replace(part, robots=(replace(part.robots[0], closure=ways),))
        twin = next((o for o in twins[r] if o < r and shares[o] == share), None)
        options = options_of(part) if twin is None else found[twin].options
        found.append(_Robot(part, nodes, positions, options))
    return found


def _alone(problem: Problem, r: int, fetches: tuple[int, ...]) -> Problem:
    """Return the problem of robot ``r`` on its own, with its share of the stock."""
    stocks = tuple(replace(stock, count=count) for stock, count in zip(problem.stocks, fetches, strict=True))
    return prune(replace(problem, robots=(problem.robots[r],), stocks=stocks, handoffs=False))


def _plan(problem: Problem, robot: _Robot, precision: FloatArray, search: Search) -> bool:
    """Plan a robot against the precision secured; return whether it has a way at all."""
    own = robot.informed(problem.information, precision)
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


def _wake(problem: Problem, robots: list[_Robot], precision: FloatArray, secured: IntArray) -> None:
    """Mark the robots that could tell something about what has just been ``secured`` at candidates."""
    known, k_vv = np.flatnonzero(precision > 0.0), problem.information.k_vv
    root = np.sqrt(precision[known])
    b = np.eye(known.size) + root[:, None] * k_vv[np.ix_(known, known)] * root
    seen = np.linalg.solve(b, root[:, None] * k_vv[np.ix_(known, secured)])
    related = np.abs(k_vv[:, secured] - (k_vv[:, known] * root) @ seen).max(axis=1, initial=0.0)
    limit = _STRANGERS * np.diag(k_vv).max(initial=0.0)
    for robot in robots:
        robot.stale = robot.stale or bool((related[robot.positions] > limit).any())


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
