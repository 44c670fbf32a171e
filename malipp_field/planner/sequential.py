"""Seq-LIPP: one robot after the other, each planned against what those before it have secured.

Initialization section of the paper: at each step every robot still free is planned against the current
posterior, and the one that lowers the team's J most is committed. Robots may unload on the way; they never
hand over. Samples left lying when the plan begins are first shared out, as cheaply as the team can fetch
them without handing over.

Each robot's problem is cut down to the nodes in its reach. Its plan is exact where all it could do can be
listed (`malipp_field.planner.alone`). Where that is too much, some thousand iterations of ruin and recreate
stand in for a proof: on large sites the baseline is a good one, not the exact one. A plan is kept from step
to step while nothing was secured that its robot could tell anything about, up to a covariance of 1e-5. When
time is up, robots not yet committed follow the plans they have.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from malipp_field.field import FloatArray
from malipp_field.planner.alone import Options, options_of, plan_alone
from malipp_field.planner.exact import solve_exact
from malipp_field.planner.extract import Route, TeamPlan, read_routes, team_plan
from malipp_field.planner.focus_slice import given, sliced
from malipp_field.planner.improve import Improver
from malipp_field.planner.milp import TeamModel
from malipp_field.planner.problem import IntArray, Problem, prune
from malipp_field.planner.progress import Search
from malipp_field.planner.schedules import MOST_PLACES, robots_of
from malipp_field.planner.stages import least_makespan

_ITERATIONS = 2_000
"""Of ruin and recreate, where schedules cannot be listed; half as many where there is a plan already."""
_STRANGERS = 1e-5
"""Covariance, as a share of the largest variance, up to which two candidates count as unrelated."""


@dataclass
class _Robot:
    """One robot on its own.

    Attributes
    ----------
    problem : Problem
        Over the nodes in its reach, with its share of the stock; J as last given.
    nodes : array
        These nodes, as the whole problem numbers them.
    positions : array
        The candidates among them, as positions in V.
    """

    problem: Problem
    nodes: IntArray
    positions: IntArray
    options: Options | None
    plan: TeamPlan | None = None
    stale: bool = True

    @property
    def gain(self) -> float:
        """By how much its plan lowers J."""
        assert self.plan is not None
        return self.problem.information.prior - self.plan.information

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
        stale = [r for r in free if robots[r].stale]
        for k, r in enumerate(stale):
            if search.effort.over and robots[r].plan is not None:
                break
            steps_left = sum(range(1, len(free) + 1)) - k
            if not _plan(problem, robots[r], precision, search.share(1.0 / steps_left)):
                return None
        plans = {r: plan for r in free if (plan := robots[r].plan) is not None}
        best = min(plans, key=lambda r: (-robots[r].gain, plans[r].rank))
        chosen, plan = robots[best], plans[best]
        if chosen.options is not None and not search.effort.over:
            plan, _ = least_makespan(chosen.problem, search.share(0.5 / len(free)), plan)
        routes[best] = chosen.route(plan)
        secured = np.zeros_like(precision)
        secured[chosen.positions] = plan.precision
        _wake(problem, [robots[r] for r in free], precision, np.flatnonzero(secured))
        precision += secured
        told = replace(plan, information=problem.information.value(precision))
        search.tell("sequential", told, None, len(routes))
    return team_plan(problem, tuple(routes[r] for r in range(len(robots))))


def _robots(problem: Problem, shares: list[tuple[int, ...]]) -> list[_Robot]:
    """Return every robot on its own; those that could stand in for each other are listed once."""
    position = {v: i for i, v in enumerate(problem.candidates)}
    twins = [robot.twins for robot in robots_of(replace(problem, handoffs=False))]
    found: list[_Robot] = []
    for r, share in enumerate(shares):
        alone = _alone(problem, r, share)
        nodes = np.array(sorted({*alone.robots[0].places, *alone.robots[0].depots}), dtype=np.int64)
        positions = np.array([position[v] for v in nodes.tolist() if v in position], dtype=np.int64)
        part = sliced(alone, [0], nodes, given(problem.information, problem.gained, positions))
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
    robot.problem = replace(robot.problem, information=given(problem.information, precision, robot.positions))
    if robot.options is not None:
        robot.plan = plan_alone(robot.problem, robot.options)
    else:
        robot.plan = _searched(robot, search)
    robot.stale = False
    return robot.plan is not None


def _searched(robot: _Robot, search: Search) -> TeamPlan | None:
    """Return the plan that ruin and recreate finds, from the last one where there is one."""
    improver, iterations = Improver(robot.problem, search.seed), _ITERATIONS
    start = None if robot.plan is None else team_plan(robot.problem, robot.plan.routes)
    if start is None:
        start = improver.construct()
    else:
        iterations //= 2
    if start is not None:
        return improver.cool(start, iterations, search.effort)
    if len(robot.problem.robots[0].places) > MOST_PLACES:
        return None
    return solve_exact(robot.problem, replace(search, on_progress=lambda _: None)).team


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
