"""Jobs on Dask workers: a local cluster of one-threaded processes, or a scheduler somewhere else.

A Dask worker does not plan itself. Each of its threads has a child process (`malipp_field.bench.worker`)
that does, so that the limits on time and memory hold everywhere, and compiled code that keeps the
interpreter's lock for seconds does not make the worker look dead. At most as many jobs as there are threads
are given out at once, so a worker that is lost takes one job for each of its threads with it, and those are
given out again. How often, is the scheduler's ``allowed-failures``: once on the local cluster.
"""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Callable
from dataclasses import dataclass
from types import TracebackType
from typing import Any, Generic, TypeVar

import dask
from distributed import Client, Future, KilledWorker, LocalCluster, wait

from malipp_field.errors import MalippError

_PATIENCE_S = 5.0
"""For a scheduler to answer."""
_POLL_S = 1.0
_SETTINGS: dict[str, Any] = {
    "distributed.worker.daemon": False,  # daemons may not have children
    "distributed.scheduler.allowed-failures": 1,
    "distributed.scheduler.worker-saturation": 1.0,
    # Ctrl-C at a terminal reaches the workers, too; it is the command that ends them.
    "distributed.worker.preload": ["import signal; signal.signal(signal.SIGINT, signal.SIG_IGN)"],
}
TagT = TypeVar("TagT")


@dataclass(frozen=True)
class Done(Generic[TagT]):
    """A job that has ended: its result, or ``lost`` as its workers died, or what it raised."""

    tag: TagT
    result: Any = None
    lost: bool = False
    fault: BaseException | None = None


class Farm(Generic[TagT]):
    """Workers to give jobs to; use it as a context manager.

    Parameters
    ----------
    scheduler
        Address of a Dask scheduler; None starts a cluster on this machine, reachable from it alone.
    jobs
        Workers of the local cluster.

    Raises
    ------
    MalippError
        When no scheduler answers.
    """

    def __init__(self, scheduler: str | None, jobs: int) -> None:
        self._scheduler, self._jobs = scheduler, jobs
        self._cluster: LocalCluster | None = None
        self._running: dict[Future[Any], TagT] = {}

    def __enter__(self) -> Farm[TagT]:
        for name in ("distributed", "asyncio"):  # what is lost is told by us, in our words
            logging.getLogger(name).setLevel(logging.CRITICAL)
        if self._scheduler is None:
            self._cluster = local_cluster(self._jobs)
        self._client = _connect(self._scheduler or self._cluster)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, fault: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._client.close()
        if self._cluster is not None:
            self._cluster.close(timeout=5.0)

    @property
    def slots(self) -> int:
        """Return how many jobs can run at once; workers may come and go."""
        return sum(self._client.nthreads().values())

    @property
    def running(self) -> int:
        """Return how many jobs have been given out."""
        return len(self._running)

    def submit(self, tag: TagT, function: Callable[..., Any], *arguments: Any) -> None:
        """Give out a job: a function of a module, with arguments that can be pickled."""
        self._running[self._client.submit(function, *arguments, pure=False)] = tag

    def done(self) -> list[Done[TagT]]:
        """Wait for about a second and return the jobs that have ended; without jobs, for workers.

        Raises
        ------
        MalippError
            When the scheduler is gone.
        """
        if not self._running:
            time.sleep(_POLL_S)
            return []
        try:
            ended = wait(list(self._running), timeout=_POLL_S, return_when="FIRST_COMPLETED").done
        except TimeoutError:
            ended = set()
        except (OSError, asyncio.CancelledError):
            raise self._gone() from None
        if self._client.status != "running":
            raise self._gone()
        return [self._outcome(future) for future in ended]

    def _outcome(self, future: Future[Any]) -> Done[TagT]:
        tag = self._running.pop(future)
        if future.status == "finished":
            return Done(tag, future.result())
        if future.status != "error":  # cancelled: the scheduler does not know it any more
            raise self._gone()
        fault = future.exception()
        lost = isinstance(fault, KilledWorker)
        return Done(tag, lost=lost, fault=None if lost else fault)

    def _gone(self) -> MalippError:
        where = self._scheduler or "on this machine"
        return MalippError(f"the Dask scheduler {where} is gone; the same command goes on from here")


def local_cluster(jobs: int) -> LocalCluster:
    """Start one-threaded workers on this machine, reachable from it alone, on free ports."""
    dask.config.set(_SETTINGS)  # to stay: workers that take the place of lost ones are started by them, too
    return LocalCluster(
        n_workers=jobs,
        threads_per_worker=1,
        processes=True,
        host="127.0.0.1",
        dashboard_address="127.0.0.1:0",
        memory_limit=0,  # the planner's memory is its child's, which is watched there
        silence_logs=logging.CRITICAL,
    )


def _connect(target: str | LocalCluster | None) -> Client:
    try:
        return Client(target, timeout=_PATIENCE_S)
    except (OSError, ValueError, TypeError, asyncio.CancelledError):
        raise MalippError(
            f"--scheduler {target}: no Dask scheduler answers there; "
            "expected an address such as tcp://192.0.2.1:8786"
        ) from None
