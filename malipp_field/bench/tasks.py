"""One plan to be made and measured, what came of it, and the file that keeps what came of many."""

from __future__ import annotations

import datetime
import functools
import hashlib
import json
import os
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, cast, get_args

from pydantic import ValidationError

import malipp_field.planner
from malipp_field.bench.budgets import sampled_nodes
from malipp_field.documents import StrictModel
from malipp_field.errors import InputError
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
            self.mission.model_dump_json(),
            None if self.state is None else self.state.model_dump_json(),
            self.method, self.handoffs, self.time_limit_s, self.mip_gap, self.threads,
        ]  # fmt: skip
        return hashlib.sha256(json.dumps(parts).encode()).hexdigest()[:16]


class Row(StrictModel):
    """What came of a task.

    ``root_bound`` is the first bound on J that was reported, ``peak_mib`` the largest resident memory of the
    process that planned (and, at most, of processes it started), ``code`` the planner's fingerprint.
    """

    key: str
    instance: str
    method: str
    handoffs: bool
    time_limit_s: float
    mip_gap: float
    status: Ending
    reason: str | None = None
    time_s: float
    information: float | None = None
    energy_j: float | None = None
    makespan_s: float | None = None
    bound: float | None = None
    root_bound: float | None = None
    drops: int = 0
    sampled: int = 0
    candidates: int = 0
    peak_mib: float | None = None
    code: str = ""
    date: str = ""

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
    bounds: list[float] = []

    def note(progress: Progress) -> None:
        if not bounds and progress.bound is not None:
            bounds.append(progress.bound)

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
            on_progress=note,
        )
    except Exception as fault:  # whatever it is, it costs this row only
        return unfinished(task, "fault", f"{type(fault).__name__}: {fault}", time.monotonic() - started)
    return _finished(task, plan, time.monotonic() - started, bounds[0] if bounds else None)


def unfinished(task: Task, status: Ending, reason: str, time_s: float) -> Row:
    """Return the row of a task that gave no plan."""
    return Row(
        key=task.key,
        instance=task.mission.name,
        method=task.method,
        handoffs=task.handoffs,
        time_limit_s=task.time_limit_s,
        mip_gap=task.mip_gap,
        status=status,
        reason=reason,
        time_s=time_s,
        code=planner_fingerprint(),
        date=datetime.datetime.now(tz=datetime.UTC).date().isoformat(),
    )


def _finished(task: Task, plan: Plan, time_s: float, root_bound: float | None) -> Row:
    row = unfinished(task, plan.status, plan.reason or "", time_s)
    goal = plan.objective
    return row.model_copy(
        update={
            "reason": plan.reason,
            "information": None if goal is None else goal.information,
            "energy_j": None if goal is None else goal.energy_j,
            "makespan_s": None if goal is None else goal.makespan_s,
            "bound": plan.bound.information,
            "root_bound": root_bound,
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

    A last line cut short by a kill is dropped: its task is done again.

    Raises
    ------
    InputError
        When the file cannot be read, or holds something else.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.rows: dict[str, Row] = {}
        try:
            content = path.read_bytes() if path.exists() else b""
        except OSError as fault:
            raise InputError(str(path), None, "", fault.strerror or str(fault)) from None
        self._whole = content.rfind(b"\n") + 1
        self._torn = self._whole < len(content)
        for number, line in enumerate(content[: self._whole].splitlines(), 1):
            row = _parsed(line, path, number)
            self.rows[row.key] = row

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
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            if self._torn:
                os.truncate(self.path, self._whole)
                self._torn = False
            with self.path.open("a", encoding="utf-8") as stream:
                stream.write(row.model_dump_json() + "\n")
        except OSError as fault:
            raise InputError(str(self.path), None, "", f"cannot be written: {fault.strerror}") from None
        self.rows[row.key] = row


def _parsed(line: bytes, path: Path, number: int) -> Row:
    try:
        return Row.model_validate_json(line)
    except ValidationError:
        problem = "not a result of this benchmark; name another file, or remove this one"
        raise InputError(str(path), number, "", problem) from None


def _gap(incumbent: float | None, bound: float | None) -> float | None:
    if incumbent is None or bound is None:
        return None
    return max(0.0, incumbent - bound) / incumbent if incumbent > 0.0 else 0.0
