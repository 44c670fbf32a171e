"""Outer approximation: the model of `malipp_field.planner.milp` solved and cut until J and its bound meet.

The first stage minimises J. Its bound is proven at any moment: the largest dual bound of a model whose cuts
never exceed J. While it runs, the best plan so far is improved by ruin and recreate
(`malipp_field.planner.improve`). Two more stages fix the precision found and minimise the energy,
then the makespan.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from malipp_field.field import FloatArray
from malipp_field.planner.extract import TeamPlan, read_routes, start_point, team_plan
from malipp_field.planner.improve import Improver
from malipp_field.planner.linear import Effort, Listener, Outcome
from malipp_field.planner.milp import TeamModel
from malipp_field.planner.problem import Problem, prune
from malipp_field.planner.timing import add_timing, horizon_s

_TANGENT_ROUNDS = 30
_IMPROVEMENTS = 28.0
"""Iterations of ruin and recreate for every ask of HiGHS, in a model of a thousand columns.

They grow with the fourth power of its size: small models are soon proven, large ones are not proven at all.
"""
_LEAST_IMPROVEMENTS = 20
_FIRST_ASKS = 20
_LAST_STAGES = 0.15
"""Share of the time limit that is kept for energy and makespan."""
_ENERGY_SLACK = 1e-7


@dataclass(frozen=True)
class Progress:
    """How far a search is; gap is (incumbent - bound) / incumbent."""

    elapsed_s: float
    stage: str
    incumbent: float | None
    bound: float | None
    gap: float | None
    rounds: int


@dataclass(frozen=True)
class Search:
    """What every part of a search needs to know about how it is to be run."""

    effort: Effort
    gap: float
    seed: int = 0
    threads: int | None = None
    work: int | None = None
    """Most rounds of the exact engine: unlike seconds, the same on every machine. None: no limit but time."""
    started: float = field(default_factory=time.monotonic)
    on_progress: Callable[[Progress], None] = lambda _: None

    def tell(self, stage: str, best: TeamPlan | None, bound: float | None, rounds: int) -> None:
        """Report progress."""
        incumbent = None if best is None else best.information
        self.on_progress(
            Progress(
                time.monotonic() - self.started,
                stage,
                incumbent,
                bound,
                relative_gap(incumbent, bound),
                rounds,
            )
        )

    def share(self, part: float) -> Search:
        """Return the same search with only a part of the time that is left."""
        left = part * self.effort.left_s
        return replace(self, effort=replace(self.effort, deadline=time.monotonic() + left))


@dataclass(frozen=True)
class Result:
    """How an exact search ended.

    ``proven`` says that every stage ended by proof; ``infeasible`` that there is no plan at all.
    """

    team: TeamPlan | None
    bound: float
    proven: bool
    infeasible: bool = False


def relative_gap(incumbent: float | None, bound: float | None) -> float | None:
    """Return (incumbent - bound) / incumbent, never below zero; None where one of them is missing."""
    if incumbent is None or bound is None or not np.isfinite(bound):
        return None
    return max(0.0, incumbent - bound) / incumbent if incumbent > 0 else 0.0


def solve_exact(problem: Problem, search: Search, start: TeamPlan | None = None) -> Result:
    """Return the lexicographic optimum of a problem, or the best plan and bound found in time.

    Parameters
    ----------
    start
        A plan to begin with; the result is never worse.
    """
    result = InformationStage(problem, search.share(1.0 - _LAST_STAGES), start).run()
    if result.team is None:
        return result
    energy, energy_proven = _least_energy(problem, search.share(0.7), result.team)
    soonest, time_proven = _least_makespan(problem, search, energy)
    search.tell("makespan", soonest, result.bound, 0)
    return replace(result, team=soonest, proven=result.proven and energy_proven and time_proven)


class InformationStage:
    """The first stage: minimise J."""

    def __init__(self, problem: Problem, search: Search, start: TeamPlan | None) -> None:
        self.problem, self.search = problem, search
        self._improver = Improver(problem, search.seed)
        self.best = start or self._improver.construct()
        self.model = TeamModel(problem, seed=search.seed, threads=search.threads)
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


def _least_energy(problem: Problem, search: Search, best: TeamPlan) -> tuple[TeamPlan, bool]:
    """Return a plan of least energy with the same precision, and whether that is proven."""
    model = _fixed_model(problem, search, best)
    model.linear.objective(model.energy_terms())
    while True:
        found, outcome = _run_stage(model, search, best)
        if found.energy_j < best.energy_j:
            best = found
        if outcome.status != "optimal" or model.timed or not _circular(model, outcome):
            return best, outcome.status == "optimal"
        add_timing(model, horizon_s(problem))


def _least_makespan(problem: Problem, search: Search, best: TeamPlan) -> tuple[TeamPlan, bool]:
    """Return the soonest plan with the same precision and no more energy, and whether that is proven."""
    model = _fixed_model(problem, search, best)
    add_timing(model, best.makespan_s + problem.service_time_s)
    slack = _ENERGY_SLACK * max(1.0, best.energy_j)
    scale = max(1.0, best.energy_j)
    model.linear.row(
        [(column, value / scale) for column, value in model.energy_terms()],
        upper=(best.energy_j + slack) / scale,
    )
    model.linear.objective([(model.columns.end, 1.0)])
    found, outcome = _run_stage(model, search, best)
    better = found.makespan_s < best.makespan_s and found.energy_j <= best.energy_j + 2 * slack
    return (found if better else best), outcome.status == "optimal"


def _fixed_model(problem: Problem, search: Search, best: TeamPlan) -> TeamModel:
    """Return the model with the precision of ``best``; nobody samples where it gains nothing."""
    wasted = {
        v
        for v, p, gained in zip(problem.candidates, best.precision, problem.gained, strict=True)
        if p <= gained
    }
    robots = []
    for robot in problem.robots:
        limits = robot.limits.copy()
        limits[list(wasted)] = 0
        robots.append(replace(robot, limits=limits))
    smaller = prune(replace(problem, robots=tuple(robots)))
    return TeamModel(smaller, precision=best.precision, seed=search.seed, threads=search.threads)


def _run_stage(model: TeamModel, search: Search, best: TeamPlan) -> tuple[TeamPlan, Outcome]:
    outcome = model.linear.solve(search.effort, gap=1e-9, start=start_point(model, best))
    if outcome.point is None:
        return best, outcome
    team = team_plan(model.problem, read_routes(model, outcome.point))
    return (best if team is None else team), outcome


def _circular(model: TeamModel, outcome: Outcome) -> bool:
    return outcome.point is not None and team_plan(model.problem, read_routes(model, outcome.point)) is None
