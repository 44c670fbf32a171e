"""How a search is run, what it tells on its way, and how it ends."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from malipp_field.planner.extract import TeamPlan
from malipp_field.planner.linear import Effort


@dataclass(frozen=True)
class Progress:
    """How far a search is; gap is (incumbent - bound) / incumbent."""

    elapsed_s: float
    stage: str
    incumbent: float | None
    bound: float | None
    gap: float | None
    rounds: int

    def times(self, unit: float) -> Progress:
        """Return the same with J measured in other units."""
        return replace(
            self,
            incumbent=None if self.incumbent is None else unit * self.incumbent,
            bound=None if self.bound is None else unit * self.bound,
        )


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
