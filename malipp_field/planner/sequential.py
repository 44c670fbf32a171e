"""Seq-LIPP: one robot after the other, each planned exactly against what those before it have secured.

Initialization section of the paper: at each step every robot still free is planned against the current
posterior, and the one that lowers the team's J most is committed. Robots may unload on the way; they never
hand over. Samples left lying when the plan begins are first shared out, as cheaply as the team can fetch
them without handing over.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from malipp_field.planner.exact import solve_exact
from malipp_field.planner.extract import Route, TeamPlan, read_routes, team_plan
from malipp_field.planner.milp import TeamModel
from malipp_field.planner.problem import Problem, prune
from malipp_field.planner.progress import Result, Search


def solve_sequential(problem: Problem, search: Search) -> TeamPlan | None:
    """Return the Seq-LIPP plan, or None where the robots cannot manage one by one (or time runs out)."""
    shares = share_stock(problem, search)
    if shares is None:
        return None
    routes: dict[int, Route] = {}
    precision = problem.gained
    while len(routes) < len(problem.robots):
        free = [r for r in range(len(problem.robots)) if r not in routes]
        plans = {}
        for k, r in enumerate(free):
            steps_left = sum(range(1, len(free) + 1)) - k
            alone = _alone(problem, r, shares[r], precision)
            plans[r] = _solve_alone(alone, search.share(1.0 / steps_left))
            if plans[r] is None:
                return None
        best = min(free, key=lambda r: _rank(plans[r]))
        chosen = plans[best]
        assert chosen is not None
        routes[best], precision = chosen.routes[0], chosen.precision
        search.tell("sequential", chosen, None, len(routes))
    return team_plan(problem, tuple(routes[r] for r in range(len(problem.robots))))


def share_stock(problem: Problem, search: Search) -> list[tuple[int, ...]] | None:
    """Return how many samples of each stock each robot is to fetch; None where they cannot without drops.

    A small model of its own: nobody samples, the team fetches everything for the least energy.
    """
    none = [(0,) * len(problem.stocks) for _ in problem.robots]
    if not problem.stocks:
        return none
    robots = tuple(replace(robot, limits=np.zeros_like(robot.limits)) for robot in problem.robots)
    errands = prune(replace(problem, robots=robots, handoffs=False))
    model = TeamModel(errands, precision=problem.gained, seed=search.seed, threads=search.threads)
    model.linear.objective(model.energy_terms())
    outcome = model.linear.solve(search.effort, gap=1e-3)
    if outcome.point is None:
        return None
    fetched = [
        {s: sum(visit.fetch.get(s, 0) for visit in route) for s in range(len(problem.stocks))}
        for route in read_routes(model, outcome.point)
    ]
    return [tuple(counts[s] for s in range(len(problem.stocks))) for counts in fetched]


def _alone(
    problem: Problem,
    r: int,
    fetches: tuple[int, ...],
    precision: np.ndarray[tuple[int], np.dtype[np.float64]],
) -> Problem:
    """Return the problem of robot ``r`` on its own, with its share of the stock."""
    stocks = tuple(replace(stock, count=count) for stock, count in zip(problem.stocks, fetches, strict=True))
    return prune(
        replace(problem, robots=(problem.robots[r],), stocks=stocks, gained=precision, handoffs=False)
    )


def _solve_alone(problem: Problem, search: Search) -> TeamPlan | None:
    quiet = replace(search, on_progress=lambda _: None)
    result: Result = solve_exact(problem, quiet)
    return result.team


def _rank(plan: TeamPlan | None) -> tuple[float, float, float]:
    assert plan is not None
    return plan.rank
