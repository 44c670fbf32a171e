"""Several walks of ruin and recreate at once, one on each core, that tell each other what they find.

A walk is one cooling, begun with the best plan known. All walks of a round are equally long, and the next
round begins when the last of them has ended: what is found does not depend on which core was quicker.
"""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

from malipp_field.planner.extract import TeamPlan
from malipp_field.planner.linear import Effort
from malipp_field.planner.problem import Problem
from malipp_field.planner.search.improver import Improver
from malipp_field.planner.search.state import case_of

_FIRST_ROUND = 1_000
"""Iterations of each walk in the first round."""
_LONGER = 2.0
"""How much longer every round is than the one before: a slower cooling ends in better plans."""
_LONGEST_ROUND = 64_000
"""Iterations from which on rounds no longer grow: other walks' news would come too late."""
_LAST = 1.5
"""A round that would leave less time than this share of its own after it takes all the time that is left."""
_SHORTEST_ROUND = 200
"""Iterations of a round at the very end."""


def cores() -> int:
    """Return how many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class Walks:
    """Walks of one problem, reproducible for a seed and a number of walks."""

    def __init__(self, problem: Problem, seed: int, many: int) -> None:
        case = case_of(problem)
        self._improvers = [Improver(problem, seed + k, case) for k in range(many)]

    def rounds(self, start: TeamPlan, effort: Effort) -> Iterator[TeamPlan]:
        """Yield the best plan after every round, for as long as the effort lasts."""
        best, length, rate = start, _FIRST_ROUND, 0.0
        with ThreadPoolExecutor(len(self._improvers)) as pool:
            while not effort.over:
                left = rate * effort.left_s
                if 0.0 < left < (1.0 + _LAST) * length:
                    length = max(_SHORTEST_ROUND, int(left))
                begun = time.monotonic()
                found = pool.map(lambda walk: walk.cool(best, length, effort), self._improvers)  # noqa: B023
                best = min([best, *found], key=lambda plan: plan.rank)
                yield best
                rate = length / max(time.monotonic() - begun, 1e-6)
                length = min(int(_LONGER * length), _LONGEST_ROUND)
