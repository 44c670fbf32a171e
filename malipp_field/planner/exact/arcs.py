"""Outer approximation: the model of `milp` solved and cut until J and its bound meet.

Its bound is proven at any moment: the largest dual bound of a model whose cuts never exceed J. While it runs,
the best plan so far is improved by ruin and recreate (`Improver`). A second exact method beside
`tree`: slower, and a check on it.
"""

from __future__ import annotations

import numpy as np

from malipp_field.field import FloatArray
from malipp_field.planner.exact.milp import TeamModel
from malipp_field.planner.exact.timing import add_timing, horizon_s
from malipp_field.planner.extract import TeamPlan, read_routes, start_point, team_plan
from malipp_field.planner.linear import Listener, Outcome
from malipp_field.planner.problem import Problem
from malipp_field.planner.progress import Result, Search, relative_gap
from malipp_field.planner.search.improver import Improver

_TANGENT_ROUNDS = 30
_IMPROVEMENTS = 28.0
"""Iterations of ruin and recreate for every ask of HiGHS, in a model of a thousand columns.

They grow with the fourth power of its size: small models are soon proven, large ones are not proven at all.
"""
_LEAST_IMPROVEMENTS = 20
_FIRST_ASKS = 20


class InformationStage:
    """The first stage: minimise J."""

    def __init__(self, problem: Problem, search: Search, start: TeamPlan | None) -> None:
        self.problem, self.search = problem, search
        self._improver = Improver(problem, search.seed)
        self.best = start or self._improver.construct()
        self.model = TeamModel(problem, seed=search.seed)
        self.bound = 0.0
        self.rounds = 0
        self._points: list[FloatArray] = []

    def run(self) -> Result:
        """Solve and cut until the gap is closed."""
        if not self._tangents():
            return Result(None, np.inf, proven=True, infeasible=True)
        self._begin()
        most = self.search.work
        while not self.search.effort.over and not self.closed and (most is None or self.rounds < most):
            outcome, news = self._round()
            if outcome.status == "infeasible":
                return Result(None, np.inf, proven=True, infeasible=True)
            if outcome.status == "optimal" and not news:
                break
        return Result(self.best, self.bound, proven=self.closed)

    @property
    def closed(self) -> bool:
        """Whether the gap asked for is reached."""
        if self.best is None:
            return False
        gap = relative_gap(self.best.information, self.bound)
        return self.best.information - self.bound <= 1e-9 or (gap is not None and gap <= self.search.gap)

    def _begin(self) -> None:
        """Improve the plan begun with, and cut where it lies: near the optimum is where cuts are needed."""
        point = self._improve(_FIRST_ASKS)
        if point is not None:
            point[self.model.columns.theta] = 0.0
            self.model.add_cuts(point)

    def _consider(self, point: FloatArray) -> None:
        """Take an integer point as a plan, and keep it for cutting."""
        self._points.append(point)
        team = team_plan(self.problem, read_routes(self.model, point))
        if team is not None and (self.best is None or team.rank < self.best.rank):
            self.best = team
            self._tell("branch and cut")

    def _improve(self, asks: int) -> FloatArray | None:
        """Improve the incumbent while branch and cut rests; return it as a point if it is better."""
        if self.best is None:
            return None
        before = self.best
        iterations = int(_IMPROVEMENTS * asks / 2 * (len(self.model.linear.cost) / 1000) ** 4)
        self.best = self._improver.improve(before, max(iterations, _LEAST_IMPROVEMENTS), self.search.effort)
        self._tell("ruin and recreate")
        return None if self.best is before else start_point(self.model, self.best)

    def _learn(self) -> bool:
        """Cut the points found in a round; return whether the model changed."""
        news = False
        for point in self._points:
            news |= self.model.add_cuts(point) > 0
            if not self.model.timed and team_plan(self.problem, read_routes(self.model, point)) is None:
                add_timing(self.model, horizon_s(self.problem))
                news = True
        self._points.clear()
        return news

    def _tell(self, stage: str) -> None:
        """Report progress."""
        self.search.tell(stage, self.best, self.bound, self.rounds)

    def _tangents(self) -> bool:
        """Cut at optima of the linear relaxation while that pays; return False if it has no solution."""
        for _ in range(_TANGENT_ROUNDS):
            outcome = self.model.linear.solve_relaxed(self.search.effort)
            if outcome.status == "infeasible":
                return False
            if outcome.point is None:
                break
            self.bound = max(self.bound, outcome.bound)
            if not self.model.add_cuts(outcome.point, 1e-4):
                break
        self._tell("relaxation")
        return True

    def _round(self) -> tuple[Outcome, bool]:
        """Run the model as it is; return the outcome and whether the model has changed since."""
        self.rounds += 1
        start = None if self.best is None else start_point(self.model, self.best)
        outcome = self.model.linear.solve(
            self.search.effort, gap=self.search.gap / 2, start=start,
            listener=Listener(on_point=self._consider, on_pause=self._improve),
        )  # fmt: skip
        if outcome.point is not None:
            self._consider(outcome.point)
        most = np.inf if self.best is None else self.best.information
        self.bound = max(self.bound, min(outcome.bound, most))
        self._tell("branch and cut")
        return outcome, self._learn()
