"""The lexicographic optimum: J by branch and price or over arcs, then energy, then makespan."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

from malipp_field.planner.arcs import InformationStage
from malipp_field.planner.extract import TeamPlan
from malipp_field.planner.problem import Problem
from malipp_field.planner.progress import Result, Search
from malipp_field.planner.schedules import MOST_PLACES
from malipp_field.planner.stages import arc_stages
from malipp_field.planner.thrift import last_stages
from malipp_field.planner.tree import ColumnStage

_LAST_STAGES = 0.15
"""Share of the time limit that is kept for energy and makespan."""


def solve_exact(
    problem: Problem,
    search: Search,
    start: TeamPlan | None = None,
    *,
    over: Literal["schedules", "arcs"] = "schedules",
) -> Result:
    """Return the lexicographic optimum of a problem, or the best plan and bound found in time.

    Parameters
    ----------
    start
        A plan to begin with; the result is never worse.
    over
        What is searched over: whole schedules (`tree`) or single arcs (`arcs`; always where a
        robot has more than `MOST_PLACES`).
    """
    whole = over == "schedules" and all(len(robot.places) <= MOST_PLACES for robot in problem.robots)
    stage = ColumnStage if whole else InformationStage
    result = stage(problem, search.share(1.0 - _LAST_STAGES), start).run()
    if result.team is None:
        return result
    finish = last_stages if whole else arc_stages
    soonest, proven = finish(problem, search, result.team)
    search.tell("makespan", soonest, result.bound, 0)
    return replace(result, team=soonest, proven=result.proven and proven)


def solve_arcs(problem: Problem, search: Search, start: TeamPlan | None = None) -> Result:
    """Return the same over arcs."""
    return solve_exact(problem, search, start, over="arcs")
