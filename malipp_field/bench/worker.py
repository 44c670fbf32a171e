"""Tasks run in a child process, so that neither a crash nor a hunger for memory costs more than one row."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import resource
import signal
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from multiprocessing.connection import Connection
from pathlib import Path
from types import TracebackType

from malipp_field.bench.instances import Specification, build
from malipp_field.bench.tasks import Ending, Row, Task, run_task, unfinished

_PAGE_MIB = resource.getpagesize() / 2**20
_POLL_S = 0.25
_WARM_UP_PATIENCE_S = 600.0
"""Compiling what has never been compiled takes more than a minute."""

Runner = Callable[[Task], Row]


class Worker:
    """A child process that runs one task after another; use it as a context manager.

    Parameters
    ----------
    run
        What is done with a task, in the child; a function of a module.
    memory_limit_mib
        Resident memory at which the child is killed.
    grace_s
        Seconds beyond its limit (and a tenth of that) after which a task's child is killed.
    """

    def __init__(
        self, run: Runner = run_task, *, memory_limit_mib: float = 8192.0, grace_s: float = 30.0
    ) -> None:
        self._run, self._memory_limit_mib, self._grace_s = run, memory_limit_mib, grace_s
        self._process: multiprocessing.process.BaseProcess | None = None
        self._pipe: Connection | None = None
        self._peak_mib = 0.0
        self._warm: set[tuple[str, bool]] = set()

    def __enter__(self) -> Worker:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, fault: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def fresh(self, task: Task) -> Row:
        """Run a task in a new process, after a tiny one of its kind that loads and compiles all code."""
        self.close()
        row = self.warmed(task)
        self.close()
        return row

    def warmed(self, task: Task) -> Row:
        """Run a task in the present process, after a tiny one of its kind if there has been none."""
        kind = task.method, task.handoffs
        if self._process is None or kind not in self._warm:
            warm_up = replace(task, mission=build(Specification(robots=2, candidates=2), 30.0), state=None)
            cold = self._ask(warm_up, _WARM_UP_PATIENCE_S)
            if cold.status in {"crashed", "killed", "out of memory"}:
                return unfinished(task, cold.status, f"on the tiny mission before it: {cold.reason}", 0.0)
            self._warm.add(kind)
        return self.run(task)

    def run(self, task: Task) -> Row:
        """Run a task in the present process, or in a new one if there is none."""
        return self._ask(task, 1.1 * task.time_limit_s + self._grace_s)

    def close(self) -> None:
        """End the child, and what it may have started."""
        if self._process is None:
            return
        assert self._process.pid is not None
        with contextlib.suppress(ProcessLookupError, PermissionError):  # it may not lead a group yet
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.kill()
        self._process.join()
        if self._pipe is not None:
            self._pipe.close()
        self._process = self._pipe = None
        self._warm.clear()

    def _ask(self, task: Task, patience_s: float) -> Row:
        """Have a task run; the clock of ``patience_s`` begins when the child is ready for it."""
        began = time.monotonic()
        try:
            pipe = self._begin()
            began = time.monotonic()
            pipe.send(task)
            why_not = self._wait(pipe, began + patience_s)
            if why_not is None:
                row: Row = pipe.recv()
                return row
            status, reason = why_not
        except (EOFError, OSError):
            status, reason = "crashed", self._last_words()
        self.close()
        row = unfinished(task, status, reason, time.monotonic() - began)
        return row.model_copy(update={"peak_mib": self._peak_mib})

    def _last_words(self) -> str:
        assert self._process is not None
        self._process.join(5.0)
        return f"the process ended with code {self._process.exitcode}"

    def _wait(self, pipe: Connection, deadline: float) -> tuple[Ending, str] | None:
        """Wait for an answer or the child's end; return why it must be killed, if so."""
        assert self._process is not None
        while not pipe.poll(_POLL_S):
            resident_mib = _resident_mib(self._process.pid)
            self._peak_mib = max(self._peak_mib, resident_mib)
            if resident_mib > self._memory_limit_mib:
                return "out of memory", f"more than {self._memory_limit_mib:.0f} MiB"
            if time.monotonic() > deadline:
                return "killed", "far beyond its time limit"
        return None

    def _begin(self) -> Connection:
        if self._pipe is not None:
            return self._pipe
        context = multiprocessing.get_context("spawn")  # forked, it would begin with this process's memory
        ours, theirs = context.Pipe()
        self._process = context.Process(target=_serve, args=(theirs, self._run))
        self._process.start()
        theirs.close()
        self._pipe, self._peak_mib = ours, 0.0
        ours.recv()  # it has loaded its modules: time counts from here
        return ours


def _serve(pipe: Connection, run: Runner) -> None:
    """Answer tasks until the parent is gone."""
    os.setsid()  # its own group: it can be ended with all it starts, and Ctrl-C reaches the parent alone
    threading.Thread(target=_end_with_parent, daemon=True).start()
    pipe.send(None)
    while True:
        try:
            task: Task = pipe.recv()
        except EOFError:
            return
        row = run(task)
        pipe.send(row.model_copy(update={"peak_mib": _peak_mib()}))


def _end_with_parent() -> None:
    """End this process and what it started as soon as its parent is gone, in the middle of a plan too."""
    parent = multiprocessing.parent_process()
    assert parent is not None
    parent.join()
    os.killpg(0, signal.SIGKILL)


def _peak_mib() -> float:
    """Return the peak of this process, plus the largest of those it has started and seen end."""
    children = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 2**10
    status = Path("/proc/self/status")
    if not status.exists():
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**10 + children
    # ru_maxrss would count what the parent held when it started this process
    (line,) = (line for line in status.read_text().splitlines() if line.startswith("VmHWM:"))
    return int(line.split()[1]) / 2**10 + children


def _resident_mib(pid: int | None) -> float:
    """Return the resident memory of a process; 0 where it cannot be told."""
    try:
        return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * _PAGE_MIB
    except (OSError, IndexError):
        return 0.0
