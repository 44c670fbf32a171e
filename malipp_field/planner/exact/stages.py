"""The stages after the first: with the precision found, least energy, then least makespan (eq:lex_objective).

Both run the arc model (`milp`) with the precision of every candidate fixed. `thrift`
does the same over whole schedules, and comes back to this where there are too many.
"""

from __future__ import annotations

from dataclasses import replace

from malipp_field.field import FloatArray
from malipp_field.planner.exact.milp import TeamModel
from malipp_field.planner.exact.timing import add_timing, horizon_s
from malipp_field.planner.extract import TeamPlan, read_routes, start_point, team_plan
from malipp_field.planner.linear import Outcome
from malipp_field.planner.problem import Problem, prune
from malipp_field.planner.progress import Search

_ENERGY_SLACK = 1e-7
"""Share of a plan's energy, of 1 J at least, by which another may need more and still count as no worse."""
_ENERGY_SHARE = 0.7
"""Part of the time that the energy stage may take."""


def arc_stages(problem: Problem, search: Search, best: TeamPlan) -> tuple[TeamPlan, bool]:
    """Return the soonest plan of least energy with the same precision, and whether it is proven to be."""
    energy, energy_proven = least_energy(problem, search.share(_ENERGY_SHARE), best)
    soonest, time_proven = least_makespan(problem, search, energy)
    return soonest, energy_proven and time_proven


def least_energy(problem: Problem, search: Search, best: TeamPlan) -> tuple[TeamPlan, bool]:
    """Return a plan of least energy with the same precision, and whether that is proven."""
    model = _fixed_model(problem, search, best.precision)
    model.linear.objective(model.energy_terms())
    while True:
        found, outcome = _run_stage(model, search, best)
        if found.energy_j < best.energy_j:
            best = found
        if outcome.status != "optimal" or model.timed or not _circular(model, outcome):
            return best, outcome.status == "optimal"
        add_timing(model, horizon_s(problem))


def least_makespan(problem: Problem, search: Search, best: TeamPlan) -> tuple[TeamPlan, bool]:
    """Return the soonest plan with the same precision and no more energy, and whether that is proven."""
    model = _fixed_model(problem, search, best.precision)
    add_timing(model, best.makespan_s + problem.service_time_s)
    limit_energy(model, best)
    model.linear.objective([(model.columns.end, 1.0)])
    found, outcome = _run_stage(model, search, best)
    return (found if sooner(found, best) else best), outcome.status == "optimal"


def energy_slack_j(best: TeamPlan) -> float:
    """Return by how much more energy than the best plan's is no more."""
    return _ENERGY_SLACK * max(1.0, best.energy_j)


def limit_energy(model: TeamModel, best: TeamPlan) -> None:
    """Allow no more energy than a plan has."""
    scale = max(1.0, best.energy_j)
    model.linear.row(
        [(column, value / scale) for column, value in model.energy_terms()],
        upper=(best.energy_j + energy_slack_j(best)) / scale,
    )


def sooner(found: TeamPlan, best: TeamPlan) -> bool:
    """Tell whether a plan is sooner over without more energy."""
    return found.makespan_s < best.makespan_s and found.energy_j <= best.energy_j + 2 * energy_slack_j(best)


def plan_of_precision(
    problem: Problem, search: Search, precision: FloatArray
) -> tuple[TeamPlan | None, bool]:
    """Return a plan that gains just this precision, shape (V,), or None and whether none is possible."""
    model = _fixed_model(problem, search, precision)
    model.linear.objective(model.energy_terms())
    while True:
        outcome = model.linear.solve(search.effort, gap=1e-2)
        if outcome.point is None:
            return None, outcome.status == "infeasible"
        team = team_plan(model.problem, read_routes(model, outcome.point))
        if team is not None or model.timed:
            return team, False
        add_timing(model, horizon_s(problem))


def _fixed_model(problem: Problem, search: Search, precision: FloatArray) -> TeamModel:
    """Return the model with this precision; nobody samples where it gains nothing."""
    wasted = {
        v for v, p, gained in zip(problem.candidates, precision, problem.gained, strict=True) if p <= gained
    }
    robots = []
    for robot in problem.robots:
        limits = robot.limits.copy()
        limits[list(wasted)] = 0
        robots.append(replace(robot, limits=limits))
    smaller = prune(replace(problem, robots=tuple(robots)))
    return TeamModel(smaller, precision=precision, seed=search.seed)


def _run_stage(model: TeamModel, search: Search, best: TeamPlan) -> tuple[TeamPlan, Outcome]:
    outcome = model.linear.solve(search.effort, gap=1e-9, start=start_point(model, best))
    if outcome.point is None:
        return best, outcome
    team = team_plan(model.problem, read_routes(model, outcome.point))
    return (best if team is None else team), outcome


def _circular(model: TeamModel, outcome: Outcome) -> bool:
    return outcome.point is not None and team_plan(model.problem, read_routes(model, outcome.point)) is None
