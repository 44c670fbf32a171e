"""Seq-LIPP: one robot after the other, each planned exactly against what those before it have secured.

Initialization section of the paper: at each step every robot still free is planned against the current
posterior, and the one that lowers the team's J most is committed. Robots may unload on the way; they never
hand over. Samples left lying when the plan begins are first shared out, as cheaply as the team can fetch
them without handing over.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from malipp_field.planner.alone import Options, options_of, plan_alone
from malipp_field.planner.exact import solve_exact
from malipp_field.planner.extract import Route, TeamPlan, read_routes, team_plan
from malipp_field.planner.milp import TeamModel
from malipp_field.planner.problem import Problem, prune
from malipp_field.planner.progress import Search
from malipp_field.planner.schedules import robots_of
from malipp_field.planner.stages import least_makespan


def solve_sequential(problem: Problem, search: Search) -> TeamPlan | None:
    """Return the Seq-LIPP plan, or None where the robots cannot manage one by one (or time runs out)."""
    shares = share_stock(problem, search)
    if shares is None:
        return None
    options = _options(problem, shares)
    routes: dict[int, Route] = {}
    precision = problem.gained
    while len(routes) < len(problem.robots):
        free = [r for r in range(len(problem.robots)) if r not in routes]
        plans: dict[int, TeamPlan] = {}
        for k, r in enumerate(free):
            steps_left = sum(range(1, len(free) + 1)) - k
            alone = _alone(problem, r, shares[r], precision)
            plan = _solve_alone(alone, options[r], search.share(1.0 / steps_left))
            if plan is None or search.effort.over:
                return None
            plans[r] = plan
        best = min(free, key=lambda r: plans[r].rank)
        alone = _alone(problem, best, shares[best], precision)
        chosen, _ = least_makespan(alone, search, plans[best])
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


def _options(problem: Problem, shares: list[tuple[int, ...]]) -> list[Options | None]:
    """List what each robot could do; those that could stand in for each other are listed once."""
    robots = robots_of(replace(problem, handoffs=False))
    found: list[Options | None] = []
    for r, robot in enumerate(robots):
        twin = next((o for o in robot.twins if o < r and shares[o] == shares[r]), None)
        known = None if twin is None else found[twin]
        found.append(known or options_of(_alone(problem, r, shares[r], problem.gained)))
    return found


def _solve_alone(problem: Problem, options: Options | None, search: Search) -> TeamPlan | None:
    if options is not None:
        return plan_alone(problem, options)
    quiet = replace(search, on_progress=lambda _: None)
    return solve_exact(problem, quiet).team
