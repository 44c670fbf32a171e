"""The lexicographic optimum: J by branch and price or over arcs, then energy, then makespan."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

from malipp_field.planner.exact.arcs import InformationStage
from malipp_field.planner.exact.schedules import MOST_PLACES
from malipp_field.planner.exact.stages import arc_stages
from malipp_field.planner.exact.thrift import last_stages
from malipp_field.planner.exact.tree import WALKS, ColumnStage
from malipp_field.planner.extract import TeamPlan
from malipp_field.planner.problem import Problem
from malipp_field.planner.progress import Result, Search

_LAST_STAGES = 0.15
"""Share of the time limit that is kept for energy and makespan."""


def solve_exact(
    problem: Problem,
    search: Search,
    start: TeamPlan | None = None,
    *,
    over: Literal["schedules", "arcs"] = "schedules",
    walks: int = WALKS,
    arcs: bool = True,
) -> Result:
    """Return the lexicographic optimum of a problem, or the best plan and bound found in time.

    Parameters
    ----------
    start
        A plan to begin with; the result is never worse.
    over
        What is searched over: whole schedules (`tree`) or single arcs (`arcs`; always where a
        robot has more than `MOST_PLACES`).
    walks
        Walks of ruin and recreate that accompany the search over schedules.
    arcs
        Whether energy and makespan are searched over arcs where schedules do not settle them.
    """
    whole = over == "schedules" and all(len(robot.places) <= MOST_PLACES for robot in problem.robots)
    first = search.share(1.0 - _LAST_STAGES)
    if whole:
        result = ColumnStage(problem, first, start, walks).run()
    else:
        result = InformationStage(problem, first, start).run()
    if result.team is None:
        return result
    if whole:
        soonest, proven = last_stages(problem, search, result.team, arcs=arcs)
    else:
        soonest, proven = arc_stages(problem, search, result.team)
    search.tell("makespan", soonest, result.bound, 0)
    return replace(result, team=soonest, proven=result.proven and proven)


def solve_arcs(problem: Problem, search: Search, start: TeamPlan | None = None) -> Result:
    """Return the same over arcs."""
    return solve_exact(problem, search, start, over="arcs")
