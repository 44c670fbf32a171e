"""Small studies, and stand-ins for planners that Dask workers and their children can import."""

from __future__ import annotations

import os
import signal
from dataclasses import replace
from pathlib import Path
from typing import Any

from malipp_field.bench import Row, Specification, Task
from malipp_field.bench.labour import Terms, task_of
from malipp_field.bench.studies import SEQ, Arm, Study
from malipp_field.bench.tasks import unfinished

CELLS = (Specification(2, 3), Specification(2, 4))
DEADLY = (CELLS[0].name, "auto")
DEADLY_ONCE = (CELLS[1].name, "no-handoffs")
DIARY = "MALIPP_TEST_DIARY"
"""Environment variable: a file to which stand-ins add a line for every plan begun."""


def study(name: str = "joint", **changes: Any) -> Study:
    """Return a study of four instances, two of each of two kinds, with three ways of planning."""
    arms = (
        Arm(SEQ, "seq", 5.0, handoffs=False),
        Arm("no handoffs", "no-handoffs", 5.0, handoffs=False),
        Arm("full", "auto", 5.0),
    )
    return replace(Study(name, "Joint", CELLS, 2, "fixed", arms), **changes)


def planned(task: Task, information: float, **figures: Any) -> Row:
    """Return the row of a plan with a given J."""
    values: dict[str, Any] = {
        "information": information, "bound": 0.5 * information, "drops": 2, "sampled": 2, "candidates": 4,
        "trail": ((0.5, 1.1 * information, None), (1.0, information, 0.5 * information)), "peak_mib": 100.0,
    }  # fmt: skip
    return unfinished(task, "feasible", "", 1.0).model_copy(update=values | figures)


def pretend(task: Task) -> Row:
    """Plan in no time: J = 10 by Seq-LIPP, 9 without handoffs, 8 by all else."""
    _write_down(task)
    return _figures(task)


def task_here(specification: Specification, arm: Arm) -> Task:
    """Return the task of an instance with carriers of 30 J."""
    return task_of(specification, 30.0, arm, Terms())


def pretend_here(specification: Specification, arm: Arm) -> Row:
    """Return what `pretend` does, without leaving a trace."""
    return _figures(task_here(specification, arm))


def kill_workers(task: Task) -> Row:
    """Kill the Dask worker that this is a child of: at one plan always, at another the first time."""
    what = task.mission.name, task.method
    if what == DEADLY or (what == DEADLY_ONCE and " ".join(what) not in begun()):
        _write_down(task)
        os.kill(os.getppid(), signal.SIGKILL)
        signal.pause()  # a child ends with its worker
    return pretend(task)


def stop_after_two(task: Task) -> Row:
    """Make two plans, then work on and on."""
    if len(begun()) >= 2 and not _is_warm_up(task):
        signal.pause()
    return pretend(task)


def _figures(task: Task) -> Row:
    return planned(task, {"seq": 10.0, "no-handoffs": 9.0}.get(task.method, 8.0))


def begun() -> list[str]:
    """Return what stand-ins have begun, as lines of instance and method."""
    path = Path(os.environ[DIARY])
    return path.read_text().splitlines() if path.exists() else []


def _is_warm_up(task: Task) -> bool:
    return len(task.mission.site.nodes) == 3  # the tiny mission before the first of its kind


def _write_down(task: Task) -> None:
    if not _is_warm_up(task):
        with Path(os.environ[DIARY]).open("a") as stream:
            stream.write(f"{task.mission.name} {task.method}\n")
