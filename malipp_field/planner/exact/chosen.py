"""The arc model with the schedule of every robot given: in which order, and who hands over to whom."""

from __future__ import annotations

from dataclasses import replace

from malipp_field.planner.exact.choices import Choice
from malipp_field.planner.exact.economy import Economy
from malipp_field.planner.exact.milp import TeamModel
from malipp_field.planner.exact.schedules import Codes, Robot
from malipp_field.planner.exact.stages import limit_energy, sooner
from malipp_field.planner.exact.timing import add_timing, horizon_s
from malipp_field.planner.extract import TeamPlan, read_routes, team_plan
from malipp_field.planner.progress import Search


def cheapest_order(economy: Economy, search: Search, choice: Choice) -> tuple[TeamPlan | None, bool]:
    """Return the plan of least energy that follows a choice to the letter, if any, and if that is proven."""
    model = _pinned(economy, search, choice)
    add_timing(model, horizon_s(economy.problem))
    model.linear.objective(model.energy_terms())
    outcome = model.linear.solve(search.effort, gap=1e-9)
    team = None if outcome.point is None else team_plan(economy.problem, read_routes(model, outcome.point))
    return team, outcome.status != "stopped"


def soonest_order(economy: Economy, search: Search, choice: Choice, best: TeamPlan) -> tuple[TeamPlan, bool]:
    """Return the soonest plan of a choice with no more energy than ``best``, or that; and whether proven."""
    model = _pinned(economy, search, choice)
    add_timing(model, best.makespan_s + economy.problem.service_time_s)
    limit_energy(model, best)
    model.linear.objective([(model.columns.end, 1.0)])
    outcome = model.linear.solve(search.effort, gap=1e-9)
    team = None if outcome.point is None else team_plan(economy.problem, read_routes(model, outcome.point))
    better = team is not None and sooner(team, best)
    return (team if team is not None and better else best), outcome.status != "stopped"


def _pinned(economy: Economy, search: Search, choice: Choice) -> TeamModel:
    """Return the arc model over the stops of these schedules, with their samples and exchanges."""
    problem = economy.problem
    views = tuple(
        replace(view, stops=_stops(robot, choice[r]))
        for r, (view, robot) in enumerate(zip(problem.robots, economy.robots, strict=True))
    )
    model = TeamModel(replace(problem, robots=views), precision=economy.precision, seed=search.seed)
    for r, robot in enumerate(economy.robots):
        for w, v in enumerate(robot.places):
            if v in model.columns.y[r]:
                _pin(model, r, v, int(choice[r][w]) + robot.capacity, robot)
    return model


def _stops(robot: Robot, codes: Codes) -> tuple[int, ...]:
    """Return where a robot may have to stop: where it does something, at depots, and on the way back to one.

    Only who has picked something up at a depot at the end has to come back to it over another place.
    """
    exchange = robot.exchange_of[codes + robot.capacity]
    returns = bool((exchange[1:][robot.actor.depot[1:]] > 0).any())
    return tuple(v for w, v in enumerate(robot.places) if w and (codes[w] or robot.actor.depot[w] or returns))


def _pin(model: TeamModel, r: int, v: int, code: int, robot: Robot) -> None:
    """Fix what a robot does at a node: the columns before the first solve, the net exchange by a row."""
    columns, linear = model.columns, model.linear
    taken, exchange = int(robot.taken_of[code]), int(robot.exchange_of[code])
    if taken or exchange:
        linear.lower[columns.y[r][v]] = 1.0
    if v in columns.a[r]:
        linear.lower[columns.a[r][v]] = linear.upper[columns.a[r][v]] = float(taken)
    picked, dropped = model.transfers(r, v)
    if picked or dropped:
        given = [(column, -part) for column, part in dropped]
        linear.row([*picked, *given], float(exchange), float(exchange))
