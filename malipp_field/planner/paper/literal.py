"""The paper's MIQP, solved as it stands: the slow reference that faster methods are held against.

`LiteralModel` is the model, equation by equation. The lexicographic objective (eq:lex_objective) is three
solves: J; then, with the selected precision levels fixed, E^tot; then, with no more energy than that, T^end.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from malipp_field.planner.extract import TeamPlan, team_plan
from malipp_field.planner.paper.literal_model import ENERGY, INFORMATION, MAKESPAN, LiteralModel
from malipp_field.planner.paper.literal_plan import assign, read_routes
from malipp_field.planner.paper.literal_solver import Ending, Run, choose_solver, minimise
from malipp_field.planner.problem import Problem
from malipp_field.planner.progress import Progress, Result, Search, relative_gap

__all__ = ["LiteralModel", "solve_literal"]

_ENERGY_SLACK = 1e-7
"""Share by which the last stage may exceed the least energy: room for rounding."""
_LAST_STAGES = 0.15
"""Share of the time that is kept for energy and makespan."""
_LAST_GAP = 1e-9
_NAMES = {INFORMATION: "information", ENERGY: "energy", MAKESPAN: "makespan"}
"""What the stages are called in progress reports."""
_AGREEMENT = 1e-5
"""Share (of the prior variance, the energy, the time) to which model and plan have to agree."""


def solve_literal(problem: Problem, search: Search, start: TeamPlan | None = None) -> Result:
    """Return the lexicographic optimum by the paper's MIQP, or the best plan and bound found in time.

    Parameters
    ----------
    start
        A plan to begin with; the result is never worse.

    Raises
    ------
    PlanError
        Where no solver for mixed-integer quadratic programs is installed.
    RuntimeError
        Where a solution of the model and the plan it stands for disagree: an error of ours.
    """
    choose_solver()
    if _nowhere_to_go(problem):
        return Result(None, np.inf, proven=True, infeasible=True)
    model = LiteralModel(problem)
    first = _Stage(model, INFORMATION, search.share(1.0 - _LAST_STAGES), gap=search.gap, scale=model.scale)
    best, ending = first.run(start, [], left_out=())
    if ending.status == "infeasible":
        if start is not None:
            raise RuntimeError("the literal model has no solution, and yet there is a plan")
        return Result(None, np.inf, proven=True, infeasible=True)
    bound = max(0.0, ending.bound)
    if best is None:
        return Result(None, bound, proven=False)
    bound = min(bound, best.information)
    if best is start and not assign(model, best):  # it has stops or legs that the problem has left out
        return Result(best, bound, proven=False)
    best, last_proven = _last_stages(model, search, best, bound)
    search.tell(_NAMES[MAKESPAN], best, bound, 0)
    return Result(best, bound, proven=ending.status == "optimal" and last_proven)


def _last_stages(model: LiteralModel, search: Search, best: TeamPlan, bound: float) -> tuple[TeamPlan, bool]:
    """Minimise the energy, then the makespan, at the precision of ``best``; tell whether both are proven."""
    if not assign(model, best):
        raise RuntimeError("the plan found has no place in the literal model")
    levels = [model.z.variable == np.round(model.z.variable.value)]
    without_estimator = ("eq:A_activation",)  # J is settled with z
    stage = _Stage(model, ENERGY, search.share(0.7), gap=_LAST_GAP, bound=bound)
    cheapest, energy = stage.run(best, levels, without_estimator)
    assert cheapest is not None
    limit = cheapest.energy_j * (1.0 + _ENERGY_SLACK)
    stage = _Stage(model, MAKESPAN, search, gap=_LAST_GAP, bound=bound)
    soonest, makespan = stage.run(cheapest, [*levels, model.objectives[ENERGY] <= limit], without_estimator)
    assert soonest is not None
    return soonest, energy.status == makespan.status == "optimal"


def _nowhere_to_go(problem: Problem) -> bool:
    """Tell whether a robot has no way to a depot, or a stock nobody who may fetch it.

    The rows in question would be sums over nothing, which solver interfaces leave out.
    """
    stuck = any(
        not any(u == robot.start for u, _ in problem.arcs(r)) for r, robot in enumerate(problem.robots)
    )
    abandoned = any(
        not any(stock.node in robot.places and robot.capacity for robot in problem.robots)
        for stock in problem.stocks
    )
    return stuck or abandoned or not all(robot.depots for robot in problem.robots)


@dataclass(frozen=True)
class _Stage:
    """One of the three solves; J is known and bounded by ``bound`` in the later two."""

    model: LiteralModel
    goal: str
    search: Search
    gap: float
    scale: float = 1.0
    bound: float | None = None

    def run(
        self, start: TeamPlan | None, extra: list[Any], left_out: tuple[str, ...]
    ) -> tuple[TeamPlan | None, Ending]:
        """Return the better of ``start`` and the plan found, and how the solve ended, in the goal's unit."""
        model, search = self.model, self.search
        blocks = [block for label, block in model.constraints.items() if label not in left_out]
        offered = list(model.variables.values()) if start is not None and assign(model, start) else []
        run = Run(search.effort, self.gap, search.seed, search.threads, partial(self._tell, start))
        constraints = [constraint for block in blocks for constraint in block] + extra
        ending = minimise(model.objectives[self.goal] / self.scale, constraints, run, offered)
        ending = replace(ending, bound=self.scale * ending.bound)
        if not ending.found:
            return start, ending
        found = self._plan(ending)
        return (found if start is None or self._value(found) < self._value(start) else start), ending

    def _plan(self, ending: Ending) -> TeamPlan:
        """Return the plan that the variables stand for, after a look whether model and plan agree."""
        stated = float(self.model.objectives[self.goal].value)
        team = team_plan(self.model.problem, read_routes(self.model))
        if team is None:
            raise RuntimeError("a solution of the literal model breaks a budget or waits in a circle")
        value = self._value(team)
        rounding = _AGREEMENT * (self.scale if self.goal == INFORMATION else max(1.0, stated))
        if not stated - self._excess(ending, stated) - rounding <= value <= stated + rounding:
            raise RuntimeError(f"{self.goal}: {stated:.9g} in the literal model is {value:.9g} in its plan")
        return team

    def _excess(self, ending: Ending, stated: float) -> float:
        """Return by how much the model may state more than the plan it stands for."""
        if ending.status != "optimal":
            return np.inf  # idle stops, waiting, an estimator short of the best
        # a robot that stays at its depot has two service windows in the model, and one in a plan
        staying_s = self.model.problem.service_time_s if self.goal == MAKESPAN else 0.0
        return self.gap * stated + staying_s

    def _value(self, team: TeamPlan) -> float:
        return dict(zip((INFORMATION, ENERGY, MAKESPAN), team.rank, strict=True))[self.goal]

    def _tell(self, start: TeamPlan | None, incumbent: float | None, bound: float | None, nodes: int) -> None:
        if self.goal == INFORMATION:
            known = [] if start is None else [start.information]
            known += [] if incumbent is None else [self.scale * incumbent]
            least, proven = min(known, default=None), None if bound is None else max(0.0, self.scale * bound)
        else:
            assert start is not None
            least, proven = start.information, self.bound
        elapsed_s = time.monotonic() - self.search.started
        gap = relative_gap(least, proven)
        self.search.on_progress(Progress(elapsed_s, _NAMES[self.goal], least, proven, gap, nodes))
