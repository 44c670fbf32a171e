"""Plans for large teams: ruin and recreate for a few neighbouring robots at a time, all others as they are.

The compiled search gets slow, and its arrays large, with the number of robots and nodes. But a robot drives
not far, and samples tell nothing about test points far away. So a round picks a group of neighbours for every
core, cuts their problem out (`focus_slice`), searches it, and puts the result back if the whole team's plan,
worked out exactly, keeps its rules and is better. Samples that robots outside handle as well stay as they
are.
"""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np

from malipp_field.field import FloatArray, Information
from malipp_field.planner.draft import Draft, draft_of, handlers
from malipp_field.planner.extract import TeamPlan, team_plan
from malipp_field.planner.linear import Effort
from malipp_field.planner.problem import Problem
from malipp_field.planner.search.focus_slice import Slice, cut, sliced
from malipp_field.planner.search.improver import Improver
from malipp_field.planner.search.kernel import CYCLE, DONE, IMPROVED, LONGER, Kernel
from malipp_field.planner.search.state import LEAST_HOPS, load, mandatory_samples, unloaded

_LEAST_TEAM, _MOST_TEAM = 3, 5
"""Robots of a group."""
_FIRST_ITERATIONS, _MOST_ITERATIONS = 400, 12_800
"""Iterations of the first cooling of a group, and of the longest."""
_CHUNK = 50
"""Iterations between two looks at the clock."""
_PARTNER = 0.3
"""What the distance to a robot counts that handles the same samples."""
_MEMORY = 0.7
"""What the past counts where the success of a robot's groups is averaged."""
_STALE = 0.2
"""What success counts at least, so that no robot is forgotten."""
_WHOLE = 3e7
"""Entries of all robots' cost tables up to which a first plan is looked for in the whole problem."""


class Focus:
    """Search for plans of one large problem, reproducible for a seed and a number of cores and rounds."""

    def __init__(self, problem: Problem, seed: int, cores: int) -> None:
        self.problem = problem
        self._noise = np.random.default_rng(seed)
        self._cores = max(1, min(cores, len(problem.robots) // _LEAST_TEAM))
        self._last = np.full(len(problem.robots), -1.0)
        self._success = np.ones(len(problem.robots))

    def construct(self) -> TeamPlan | None:
        """Return a plan in which all robots, and what must come home, do; None where none is found."""
        problem = self.problem
        if any(not robot.depots for robot in problem.robots):
            return None
        if not mandatory_samples(problem):
            bare = Draft(problem, [[robot.start, robot.start] for robot in problem.robots], [])
            bare.tidy()
            return team_plan(problem, bare.visits())
        errands = {stock.node for stock in problem.stocks}
        for robot in problem.robots:
            errands |= {robot.start, *robot.depots}
        found = _errands(problem, sorted(errands))
        if found is None and len(problem.robots) * len(problem.nodes) ** 2 <= _WHOLE:
            found = _errands(problem, list(range(len(problem.nodes))))
        return found

    def rounds(self, start: TeamPlan, effort: Effort) -> Iterator[TeamPlan]:
        """Yield the best plan after every round, for as long as the effort lasts."""
        best, draft = start, draft_of(self.problem, start)
        turn, handled, length = 0, 0, _FIRST_ITERATIONS
        with ThreadPoolExecutor(self._cores) as pool:
            while not effort.over:
                groups = self._groups(draft, turn)
                slices = [cut(draft, group, self._noise) for group in groups]
                seeds = self._noise.integers(2**63, size=len(slices)).tolist()
                tasks = [
                    (part, draft, seed, length, effort) for part, seed in zip(slices, seeds, strict=True)
                ]
                for part, found in zip(slices, pool.map(lambda task: _searched(*task), tasks), strict=True):
                    trial = None if found is None else part.merged(draft, found)
                    team = None if trial is None else team_plan(self.problem, trial.visits())
                    better = trial is not None and team is not None and team.rank < best.rank
                    if trial is not None and team is not None and better:
                        best, draft = team, trial
                    self._remember(part, turn, success=better)
                    handled += len(part.robots)
                yield best
                turn += 1
                if handled >= 2 * len(self.problem.robots):
                    handled, length = 0, min(2 * length, _MOST_ITERATIONS)

    def _remember(self, part: Slice, turn: int, *, success: bool) -> None:
        self._last[part.robots] = turn
        self._success[part.robots] *= _MEMORY
        self._success[part.robots] += (1.0 - _MEMORY) * success

    def _groups(self, draft: Draft, turn: int) -> list[list[int]]:
        """Return a group for each core, with no robot in two."""
        free = np.ones(len(self.problem.robots), dtype=np.bool_)
        size = min(int(self._noise.integers(_LEAST_TEAM, _MOST_TEAM + 1)), len(free) // self._cores)
        away, groups = _distances(draft), []
        for _ in range(self._cores):
            waited = (turn - self._last) * (_STALE + self._success) * self._noise.uniform(0.5, 1.5, len(free))
            first = int(np.argmax(np.where(free, waited, -1.0)))
            distance = away[first] * self._noise.uniform(0.7, 1.3, len(free))
            distance[first] = -1.0
            left = np.flatnonzero(free)  # some of them may be out of reach: infinitely far, but not taken
            group = left[np.argsort(distance[left], kind="stable")[: max(1, size)]]
            free[group] = False
            groups.append(sorted(group.tolist()))
        return groups


def _distances(draft: Draft) -> FloatArray:
    """Return how far, in J/kg, a robot's stops are from those of another; shape (R, R)."""
    problem = draft.problem
    depots = {d for robot in problem.robots for d in robot.depots}
    stops = [
        [v for v in route if v not in depots] or [robot.start]
        for route, robot in zip(draft.routes, problem.robots, strict=True)
    ]
    near = np.array(
        [
            robot.closure.energy_per_kg[own].min(axis=0)
            for own, robot in zip(stops, problem.robots, strict=True)
        ]
    )
    there = np.array([near[:, own].mean(axis=1) for own in stops])
    away: FloatArray = np.minimum(there, there.T)
    partner = _PARTNER * float(np.median(away))
    for sample in draft.samples:
        together = list(handlers(sample))
        if len(together) > 1:
            away[np.ix_(together, together)] = np.minimum(away[np.ix_(together, together)], partner)
    return away


def _searched(part: Slice, draft: Draft, seed: int, iterations: int, effort: Effort) -> Draft | None:
    """Return a better plan of the group from one cooling, None where none is found."""
    own = part.draft(draft)
    hops = max([LEAST_HOPS, *(len(sample.hops) for sample in own.samples)])
    kernel = Kernel(part.case, int(part.case.limits.sum()) + len(own.samples) + 1, hops, seed)
    load(kernel.best, own)
    if not kernel.begin():
        return None
    kernel.counters[CYCLE] = kernel.counters[DONE] = max(1, iterations // LONGER)
    for _ in range(0, iterations, _CHUNK):
        if effort.over:
            break
        kernel.search(_CHUNK)
    return unloaded(part.problem, kernel.best) if kernel.counters[IMPROVED] else None


def _errands(problem: Problem, nodes: list[int]) -> TeamPlan | None:
    """Return a plan over some nodes in which nobody samples, but all that must comes home."""
    team, chosen = range(len(problem.robots)), np.array(nodes, dtype=np.int64)
    idle = tuple(replace(robot, limits=np.zeros_like(robot.limits)) for robot in problem.robots)
    nothing = Information(np.zeros((0, 0)), np.zeros((0, 0)), np.zeros(0), np.zeros(0))
    barren = replace(problem, robots=idle, candidates=(), gained=np.zeros(0))
    found = Improver(sliced(barren, team, chosen, nothing), 0).construct()
    if found is None:
        return None
    routes = tuple(tuple(replace(visit, node=nodes[visit.node]) for visit in route) for route in found.routes)
    return team_plan(problem, routes)
