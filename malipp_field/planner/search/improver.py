"""Ruin and recreate: a quick search for better plans, started from any plan.

A few samples are taken out of the plan, then samples are put in one after the other, each with the way home
that buys most information for the energy it costs. Changes are accepted as in annealing on J. It proves
nothing; it gives the exact search its incumbents. The loop itself is compiled
(`malipp_field.planner.search.kernel`); every plan that leaves here is derived anew, exactly.
"""

from __future__ import annotations

import random
import time

from malipp_field.planner.draft import Draft, draft_of
from malipp_field.planner.extract import TeamPlan, team_plan
from malipp_field.planner.linear import Effort
from malipp_field.planner.problem import Problem
from malipp_field.planner.search.kernel import CYCLE, DONE, IMPROVED, LONGER, Kernel
from malipp_field.planner.search.state import (
    LEAST_HOPS,
    Case,
    case_of,
    load,
    mandatory_samples,
    most_samples,
    unloaded,
)

_CONSTRUCTIONS = 200
"""Attempts to build a plan where there is none to begin with."""
_FIRST_CYCLE = 500
"""Iterations of the first cooling; every further one is longer."""
_CHUNK_S = 0.02
"""Time between two looks at the clock, about."""
_FIRST_CHUNK = 4


class Improver:
    """Repeated improvement of one problem's plans, reproducible for a seed.

    The search goes on where the last call left it: its plan, its temperature and its random numbers are
    kept, so that many small calls are as good as a large one.

    Parameters
    ----------
    case
        The problem as arrays, where others that search it have them already: nothing of it is changed.
    """

    def __init__(self, problem: Problem, seed: int, case: Case | None = None) -> None:
        self.problem = problem
        self._case = case_of(problem) if case is None else case
        self._samples = most_samples(problem, self._case)
        self._seed = random.Random(seed).getrandbits(64)  # noqa: S311 (a search, not a secret)
        self._kernel, self._hops = self._new_kernel(LEAST_HOPS), LEAST_HOPS
        self._rate = 0.0
        self._seen = 0
        self._known: TeamPlan | None = None

    def improve(self, team: TeamPlan, iterations: int, effort: Effort) -> TeamPlan:
        """Return the best plan found in so many iterations; never a worse one than ``team``."""
        if (self._known is None or team.rank < self._known.rank) and not self._begin(team):
            return team
        self._run(iterations, effort)
        if self._kernel.counters[IMPROVED] > self._seen:
            self._take()
        return self._known if self._known is not None and self._known.rank < team.rank else team

    def cool(self, team: TeamPlan, iterations: int, effort: Effort) -> TeamPlan:
        """Return the best plan of one whole cooling begun with ``team``; never a worse one."""
        if not self._begin(team):
            return team
        counters = self._kernel.counters
        counters[CYCLE] = counters[DONE] = max(1, iterations // LONGER)
        self._run(LONGER * max(1, iterations // LONGER), effort)
        if self._kernel.counters[IMPROVED] > self._seen:
            self._take()
        return self._known if self._known is not None and self._known.rank < team.rank else team

    def construct(self) -> TeamPlan | None:
        """Return a plan in which all robots and what must come home do come home; None if none is found.

        The paper's fallback of direct-depot routes, with samples on board and in drops put in one by one.
        """
        must = mandatory_samples(self.problem)
        kernel = self._new_kernel(LEAST_HOPS)
        for _ in range(_CONSTRUCTIONS if must else 1):
            load(kernel.best, Draft(self.problem, self._direct_routes(), []))
            for row, sample in zip(kernel.scratch.homeless, must, strict=False):
                row[:] = sample.kind, sample.node, sample.robot, sample.stock
            if kernel.begin(len(must)):
                return team_plan(self.problem, unloaded(self.problem, kernel.best).visits())
        return None

    def _direct_routes(self) -> list[list[int]]:
        ends = self._case.terminal_at_once
        return [[robot.start, int(end)] for robot, end in zip(self.problem.robots, ends, strict=True)]

    def _new_kernel(self, hops: int) -> Kernel:
        return Kernel(self._case, self._samples, hops, self._seed)

    def _begin(self, team: TeamPlan) -> bool:
        """Go on from ``team``; return False where it uses what the search cannot express."""
        draft = draft_of(self.problem, team)
        hops = max((len(sample.hops) for sample in draft.samples), default=0)
        if hops > self._hops:
            self._kernel, self._hops = self._new_kernel(hops), hops
        load(self._kernel.best, draft)
        good = self._kernel.begin()
        self._known = team if good else None
        counters = self._kernel.counters
        self._seen = int(counters[IMPROVED])
        counters[CYCLE] = max(counters[CYCLE] // 2, _FIRST_CYCLE)
        counters[DONE] = counters[CYCLE]
        return good

    def _run(self, iterations: int, effort: Effort) -> None:
        """Search in chunks, short enough to stop in time. How it is split does not change what is found."""
        done = 0
        while done < iterations and not effort.over:
            longest = min(_CHUNK_S, effort.left_s)
            chunk = max(_FIRST_CHUNK, min(iterations - done, int(longest * self._rate)))
            chunk = min(chunk, iterations - done)
            started = time.perf_counter()
            self._kernel.search(chunk)
            self._rate = min(chunk / max(time.perf_counter() - started, 1e-6), 4.0 * max(self._rate, 1e3))
            done += chunk

    def _take(self) -> None:
        """Take the search's best plan, with exact figures, if it is better than the one known."""
        self._seen = int(self._kernel.counters[IMPROVED])
        found = team_plan(self.problem, unloaded(self.problem, self._kernel.best).visits())
        if found is not None and self._known is not None and found.rank < self._known.rank:
            self._known = found
