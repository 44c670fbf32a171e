"""What a worker of the farm is asked to do: make an instance, or plan it."""

from __future__ import annotations

import multiprocessing
import threading
from dataclasses import dataclass

from malipp_field.bench.budgets import tune
from malipp_field.bench.instances import Specification, build, mission_text
from malipp_field.bench.studies import GROWTH_BUDGET_J, Arm, Budgets
from malipp_field.bench.tasks import Row, Task, run_task
from malipp_field.bench.tours import tour_mission
from malipp_field.bench.worker import Runner, Worker
from malipp_field.mission import Mission

_TUNING_LIMIT_S = 600.0
"""For one Seq-LIPP plan while budgets are tuned."""
_own = threading.local()
"""The child process of each thread of a Dask worker."""


@dataclass(frozen=True)
class Terms:
    """How plans are made: threads of each, the memory at which it is ended, and by what function."""

    threads: int | None = 1
    memory_limit_mib: float = 8192.0
    run: Runner = run_task


class NoInstanceError(RuntimeError):
    """An instance that cannot be made; its text says why."""


@dataclass(frozen=True)
class Made:
    """An instance: the budget of its carriers, and its mission file."""

    carrier_budget_j: float
    text: str


def make_instance(specification: Specification, budgets: Budgets, terms: Terms) -> Made:
    """Return an instance with the budgets of its study.

    Raises
    ------
    NoInstanceError
        When Seq-LIPP, by which budgets are tuned, does not give a plan.
    """
    if budgets == "tuned":
        mission, _ = tune(specification, lambda mission: _sampled(mission, terms))
    elif budgets == "tour":
        mission = tour_mission(specification)
    else:
        mission = build(specification, GROWTH_BUDGET_J)
    budget_j = max(robot.energy_budget_j for robot in mission.team.robots)
    return Made(budget_j, mission_text(mission))


def task_of(specification: Specification, carrier_budget_j: float, arm: Arm, terms: Terms) -> Task:
    """Return the plan to be made of an instance."""
    return Task(
        build(specification, carrier_budget_j), arm.method, arm.handoffs, arm.time_limit_s,
        threads=terms.threads,
    )  # fmt: skip


def plan_instance(
    specification: Specification, carrier_budget_j: float, arm: Arm, terms: Terms, fresh: bool
) -> Row:
    """Plan an instance in this thread's child process, or in a new one."""
    task = task_of(specification, carrier_budget_j, arm, terms)
    worker = _worker(terms)
    return worker.fresh(task) if fresh else worker.warmed(task)


def _sampled(mission: Mission, terms: Terms) -> int:
    row = _worker(terms).warmed(
        Task(mission, "seq", handoffs=False, time_limit_s=_TUNING_LIMIT_S, threads=terms.threads)
    )
    if row.information is None:
        raise NoInstanceError(f"no Seq-LIPP plan to tune budgets by: {row.status}, {row.reason}")
    return row.sampled


def _worker(terms: Terms) -> Worker:
    if multiprocessing.current_process().daemon:
        raise RuntimeError("it is a daemon; start it with DASK_DISTRIBUTED__WORKER__DAEMON=False")
    known: tuple[Terms, Worker] | None = getattr(_own, "worker", None)
    if known is None or known[0] != terms:
        if known is not None:
            known[1].close()
        known = terms, Worker(terms.run, memory_limit_mib=terms.memory_limit_mib)
        _own.worker = known
    return known[1]
