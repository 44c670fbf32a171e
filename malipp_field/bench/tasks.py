"""One plan to be made and measured, what came of it, and the file that keeps what came of many."""

from __future__ import annotations

import datetime
import functools
import hashlib
import json
import math
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, cast, get_args

import malipp_field.planner
from malipp_field.bench.budgets import sampled_nodes
from malipp_field.bench.lines import JsonLines
from malipp_field.bench.machine import machine, versions
from malipp_field.documents import StrictModel
from malipp_field.mission import Mission, TeamState
from malipp_field.mission.schema import Method
from malipp_field.plan import Plan
from malipp_field.planner import Progress, solve

Ending = Literal[
    "optimal",
    "feasible",
    "infeasible",
    "no_plan",
    "fault",
    "crashed",
    "killed",
    "out of memory",
    "not available",
]
"""A plan's status, or why there is none: the planner raised, its process died, overran its time by far, took
too much memory, or does not know the method."""

FAILED: frozenset[Ending] = frozenset({"fault", "crashed", "killed", "out of memory"})
"""Endings that should not be."""

Moment = tuple[float, float | None, float | None]
"""Seconds since the planner was called, J of the best plan and the proven bound then (None: none yet)."""
_BOUND_STEP = 1e-3
"""A trail keeps a bound that has risen by this share; every better plan is kept."""


@dataclass(frozen=True)
class Task:
    """A mission (from ``state`` on) to be planned by one method within a limit."""

    mission: Mission
    method: str
    handoffs: bool = True
    time_limit_s: float = 60.0
    mip_gap: float = 1e-4
    state: TeamState | None = None
    threads: int | None = None

    @functools.cached_property
    def key(self) -> str:
        """Return a fingerprint of all that the result may depend on, the planner's code apart."""
        parts = [
            self.mission.model_dump_json(exclude_defaults=True),
            None if self.state is None else self.state.model_dump_json(exclude_defaults=True),
            self.method, self.handoffs, self.time_limit_s, self.mip_gap, self.threads,
        ]  # fmt: skip
        return hashlib.sha256(json.dumps(parts).encode()).hexdigest()[:16]


class Row(StrictModel):
    """What came of a task.

    ``root_bound`` is the first bound on J that was reported, ``trail`` how plan and bound became better,
    ``peak_mib`` the largest resident memory of the process that planned (and, at most, of processes it
    started), ``code`` the planner's fingerprint.
    """

    key: str
    instance: str
    method: str
    handoffs: bool
    time_limit_s: float
    mip_gap: float
    threads: int | None = None
    planner_seed: int = 0
    status: Ending
    reason: str | None = None
    time_s: float
    information: float | None = None
    energy_j: float | None = None
    makespan_s: float | None = None
    bound: float | None = None
    root_bound: float | None = None
    trail: tuple[Moment, ...] = ()
    drops: int = 0
    sampled: int = 0
    candidates: int = 0
    peak_mib: float | None = None
    code: str = ""
    machine: str = ""
    versions: str = ""
    date: str = ""

    @property
    def first_plan_s(self) -> float | None:
        """Return when the first plan was there; None if there never was one."""
        return next((time_s for time_s, information, _ in self.trail if information is not None), None)

    def information_at(self, time_s: float) -> float | None:
        """Return J of the best plan there was at a time; None before the first."""
        known = [j for moment_s, j, _ in self.trail if moment_s <= time_s and j is not None]
        return min(known, default=None)

    @property
    def gap(self) -> float | None:
        """Return (J - bound) / J, never below zero; None without a plan or a bound."""
        return _gap(self.information, self.bound)

    @property
    def root_gap(self) -> float | None:
        """Return the gap between the plan at the end and the first bound; None without either."""
        return _gap(self.information, self.root_bound)

    @property
    def certified(self) -> bool:
        """Tell whether J is proven to the gap asked for (or proven not to exist)."""
        return self.status == "infeasible" or (self.gap is not None and self.gap <= 1.001 * self.mip_gap)


def run_task(task: Task) -> Row:
    """Plan, and return what came of it; a fault of the planner is a row, too.

    Plans that break a rule never get here: `solve` refuses them, which shows as a fault.
    """
    if task.method not in get_args(Method):
        return unfinished(task, "not available", f"this planner has no method {task.method}", 0.0)
    trail = Trail()
    started = time.monotonic()
    try:
        plan = solve(
            task.mission,
            state=task.state,
            method=cast("Method", task.method),
            handoffs=task.handoffs,
            time_limit_s=task.time_limit_s,
            mip_gap=task.mip_gap,
            threads=task.threads,
            on_progress=trail.note,
        )
    except Exception as fault:  # whatever it is, it costs this row only
        return unfinished(task, "fault", f"{type(fault).__name__}: {fault}", time.monotonic() - started)
    return _finished(task, plan, time.monotonic() - started, trail)


@dataclass
class Trail:
    """What a planner told on its way, as far as it was news."""

    moments: list[Moment] = field(default_factory=list)
    root_bound: float | None = None

    def note(self, progress: Progress) -> None:
        """Keep a better plan, or a bound that has risen by more than a little."""
        bound = progress.bound if progress.bound is not None and math.isfinite(progress.bound) else None
        if self.root_bound is None:
            self.root_bound = bound
        _, best, proven = self.moments[-1] if self.moments else (0.0, None, None)
        better = progress.incumbent is not None and (best is None or progress.incumbent < best)
        higher = bound is not None and (proven is None or bound - proven > _BOUND_STEP * abs(bound))
        if better or higher:
            self.moments.append((
                progress.elapsed_s,
                progress.incumbent if better else best,
                bound if higher else proven,
            ))  # fmt: skip

    def ended(self, time_s: float, information: float | None, bound: float | None) -> tuple[Moment, ...]:
        """Return the trail with the plan at the end as its last moment."""
        return (*self.moments, (time_s, information, bound))


def unfinished(task: Task, status: Ending, reason: str, time_s: float) -> Row:
    """Return the row of a task that gave no plan."""
    return Row(
        key=task.key,
        instance=task.mission.name,
        method=task.method,
        handoffs=task.handoffs,
        time_limit_s=task.time_limit_s,
        mip_gap=task.mip_gap,
        threads=task.threads,
        planner_seed=task.mission.planner.seed,
        status=status,
        reason=reason,
        time_s=time_s,
        code=planner_fingerprint(),
        machine=machine(),
        versions=versions(),
        date=datetime.datetime.now(tz=datetime.UTC).date().isoformat(),
    )


def _finished(task: Task, plan: Plan, time_s: float, trail: Trail) -> Row:
    row = unfinished(task, plan.status, plan.reason or "", time_s)
    goal = plan.objective
    return row.model_copy(
        update={
            "reason": plan.reason,
            "information": None if goal is None else goal.information,
            "energy_j": None if goal is None else goal.energy_j,
            "makespan_s": None if goal is None else goal.makespan_s,
            "bound": plan.bound.information,
            "root_bound": trail.root_bound,
            "trail": trail.ended(time_s, None if goal is None else goal.information, plan.bound.information),
            "drops": plan.handoffs,
            "sampled": sampled_nodes(plan),
            "candidates": sum(node.role == "candidate" for node in task.mission.site.nodes),
        }
    )


@functools.cache
def planner_fingerprint() -> str:
    """Return a short hash of the planner's sources, so that rows of different code are told apart."""
    digest = hashlib.sha256()
    for path in sorted(Path(malipp_field.planner.__path__[0]).glob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:8]


class Results:
    """Rows in a file of JSON lines, appended as they come, so that a run can be stopped and resumed.

    Raises
    ------
    InputError
        When the file cannot be read, or holds something else.
    """

    def __init__(self, path: Path) -> None:
        self._lines = JsonLines(path, Row)
        self.rows = {row.key: row for row in self._lines.read()}

    def find(self, task: Task) -> Row | None:
        """Return what is known of a task; what failed is not known once the planner's code has changed."""
        row = self.rows.get(task.key)
        failed = row is not None and row.status in {"fault", "crashed", "not available"}
        return None if row is None or (failed and row.code != planner_fingerprint()) else row

    def add(self, row: Row) -> None:
        """Keep a row, on disk at once.

        Raises
        ------
        InputError
            When the file cannot be written.
        """
        self._lines.append(row)
        self.rows[row.key] = row


def _gap(incumbent: float | None, bound: float | None) -> float | None:
    if incumbent is None or bound is None:
        return None
    return max(0.0, incumbent - bound) / incumbent if incumbent > 0.0 else 0.0
