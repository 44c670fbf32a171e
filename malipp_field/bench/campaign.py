"""Running studies: what is missing is given out, and what comes back is kept at once.

All is kept in one folder: ``rows.jsonl`` (every plan's figures), ``instances.jsonl`` (every instance's
budget) and mission files. A run can be killed at any time; the next one in the same folder does only what is
missing.
"""

from __future__ import annotations

import contextlib
import fcntl
import functools
import hashlib
import statistics
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from malipp_field.bench.budgets import FIRST_BUDGET_J
from malipp_field.bench.cases import Cases
from malipp_field.bench.farm import Done, Farm
from malipp_field.bench.instances import Specification, build
from malipp_field.bench.labour import Made, NoInstanceError, Terms, make_instance, plan_instance, task_of
from malipp_field.bench.lines import JsonLines
from malipp_field.bench.studies import Arm, Study
from malipp_field.bench.tasks import FAILED, Results, Row, Task, unfinished
from malipp_field.documents import StrictModel, whole_file
from malipp_field.errors import InputError, MalippError

_LOST = "its worker died, and so did the next"


class Instance(StrictModel):
    """What is kept of an instance: the rest follows from its specification.

    ``site`` is a fingerprint of the mission but for its budgets, so that another generator's are not taken.
    """

    study: str
    name: str
    site: str
    carrier_budget_j: float


@dataclass(frozen=True)
class Piece:
    """An instance to be made (without an arm), or to be planned."""

    study: Study
    specification: Specification
    arm: Arm | None = None

    @property
    def where(self) -> tuple[str, Specification, str]:
        """Return what tells plans apart."""
        assert self.arm is not None
        return self.study.name, self.specification, self.arm.label


@dataclass(frozen=True)
class Standing:
    """How far a run is; ``left_s`` is an estimate, None while nothing is known."""

    done: int
    total: int
    running: int
    workers: int
    left_s: float | None
    faults: int

    def __str__(self) -> str:
        if not self.workers:
            return f"{self.done} of {self.total} plans, waiting for workers"
        words = f"{self.done} of {self.total} plans, at work: {self.running}"
        if self.faults:
            words += f", {self.faults} failed"
        return words if self.left_s is None else f"{words}, about {_duration(self.left_s)} left"


@dataclass
class Campaign:
    """Studies run in a folder.

    Parameters
    ----------
    studies
        What is to be done.
    folder
        Where everything is kept.
    terms
        How plans are made.
    """

    studies: Sequence[Study]
    folder: Path
    terms: Terms = field(default_factory=Terms)
    faults: list[str] = field(default_factory=list, init=False)
    """Instances that could not be made, in words."""

    def __post_init__(self) -> None:
        self._results = Results(self.folder / "rows.jsonl")
        self._instances = _Instances(self.folder)
        self._known: dict[tuple[str, Specification, str], Row] = {}
        self._pace = _Pace()
        self._made_at: dict[Piece, float] = {}
        self._pending = deque(
            Piece(study, spec) for study in self.studies for spec in study.specifications if study.planned
        )

    @property
    def total(self) -> int:
        """Return how many plans there are to be."""
        return sum(len(study.specifications) * len(study.planned) for study in self.studies)

    def budget(self, study: Study, specification: Specification) -> float | None:
        """Return the carriers' budget of an instance that has been made."""
        return self._instances.budget(study, specification)

    def cases(self, study: Study) -> Cases:
        """Return what is known of a study."""
        rows = {(spec, label): row for (name, spec, label), row in self._known.items() if name == study.name}
        return Cases(study, rows)

    def run(self, farm: Farm[Piece], on_progress: Callable[[Standing], None] = lambda _: None) -> None:
        """Do what is missing.

        Raises
        ------
        MalippError
            When the scheduler is gone, or a file cannot be written.
        """
        while self._pending or farm.running:
            while self._pending and farm.running < farm.slots:
                self._give_out(self._pending.popleft(), farm)
            on_progress(self._standing(farm))
            for done in farm.done():
                self._take_in(done)
        on_progress(self._standing(farm))

    def _give_out(self, piece: Piece, farm: Farm[Piece]) -> None:
        study, spec, arm = piece.study, piece.specification, piece.arm
        budget_j = self._instances.budget(study, spec)
        if arm is not None:
            assert budget_j is not None
            farm.submit(piece, plan_instance, spec, budget_j, arm, self.terms, study.fresh)
        elif budget_j is None:
            self._made_at[piece] = time.monotonic()
            farm.submit(piece, make_instance, spec, study.budgets, self.terms)
        else:
            self._plan_what_is_missing(piece, budget_j)

    def _plan_what_is_missing(self, piece: Piece, budget_j: float) -> None:
        missing = []
        for arm in piece.study.planned:
            plan = Piece(piece.study, piece.specification, arm)
            row = self._results.find(task_of(piece.specification, budget_j, arm, self.terms))
            if row is None:
                missing.append(plan)
            else:
                self._keep(plan, row)
        self._pending.extendleft(reversed(missing))  # an instance is finished before the next is begun

    def _take_in(self, done: Done[Piece]) -> None:
        piece = done.tag
        if done.fault is not None and not isinstance(done.fault, NoInstanceError):
            raise MalippError(f"a Dask worker cannot do its work: {done.fault}") from done.fault
        if piece.arm is None:
            self._made(piece, done)
            return
        task = self._task(piece)
        row = done.result
        if row is None:
            row = unfinished(task, "crashed", _LOST, 0.0)
        elif row.key != task.key:
            raise MalippError("the Dask workers have another version of malipp-field: update them")
        self._results.add(row)
        self._keep(piece, row)

    def _made(self, piece: Piece, done: Done[Piece]) -> None:
        if not isinstance(done.result, Made):
            self.faults.append(f"{piece.study.name}, {piece.specification.name}: {done.fault or _LOST}")
            return
        self._instances.add(piece.study, piece.specification, done.result)
        self._pace.note(piece, time.monotonic() - self._made_at.pop(piece))
        self._pending.appendleft(piece)

    def _task(self, piece: Piece) -> Task:
        budget_j = self._instances.budget(piece.study, piece.specification)
        assert budget_j is not None
        assert piece.arm is not None
        return task_of(piece.specification, budget_j, piece.arm, self.terms)

    def _keep(self, piece: Piece, row: Row) -> None:
        self._known[piece.where] = row
        self._pace.note(piece, row.time_s)

    def _standing(self, farm: Farm[Piece]) -> Standing:
        slots = farm.slots
        missing = (piece for piece in self._everything() if not self._has(piece))
        left_s = sum(map(self._pace.expected_s, missing)) / slots if slots and self._known else None
        faults = sum(row.status in FAILED for row in self._known.values()) + len(self.faults)
        return Standing(len(self._known), self.total, farm.running, slots, left_s, faults)

    def _has(self, piece: Piece) -> bool:
        if piece.arm is None:
            return self._instances.budget(piece.study, piece.specification) is not None
        return piece.where in self._known

    def _everything(self) -> Iterator[Piece]:
        for study in self.studies:
            for spec in study.specifications:
                yield Piece(study, spec)
                yield from (Piece(study, spec, arm) for arm in study.planned)


class _Pace:
    """How long pieces take: the mean of those of the same study, way and size, or of the same way at all."""

    def __init__(self) -> None:
        self._times: dict[tuple[object, ...], list[float]] = {}

    def note(self, piece: Piece, time_s: float) -> None:
        """Learn how long a piece took."""
        for group in self._groups(piece):
            self._times.setdefault(group, []).append(time_s)

    def expected_s(self, piece: Piece) -> float:
        """Return how long a piece will take; nothing like it having been seen, its limit."""
        for group in self._groups(piece):
            if group in self._times:
                return statistics.fmean(self._times[group])
        return 0.0 if piece.arm is None else piece.arm.time_limit_s

    @staticmethod
    def _groups(piece: Piece) -> tuple[tuple[object, ...], ...]:
        spec = piece.specification
        way = piece.study.budgets if piece.arm is None else piece.arm.method
        return (piece.study.name, way, spec.robots, spec.candidates), (piece.study.name, way), (way,)


class _Instances:
    """The budgets of instances, and their mission files."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._lines = JsonLines(folder / "instances.jsonl", Instance)
        self._budgets = {
            (known.study, known.name, known.site): known.carrier_budget_j for known in self._lines.read()
        }

    def budget(self, study: Study, spec: Specification) -> float | None:
        """Return the carriers' budget of an instance, None where it has not been made."""
        return self._budgets.get((study.name, spec.name, _site(spec)))

    def add(self, study: Study, spec: Specification, made: Made) -> None:
        """Keep an instance: its mission file first, so that whatever is known has one."""
        with whole_file(self._folder / "instances" / study.name / f"{spec.name}.yaml") as partial:
            partial.write_text(made.text, encoding="utf-8")
        known = Instance(
            study=study.name, name=spec.name, site=_site(spec), carrier_budget_j=made.carrier_budget_j
        )
        self._lines.append(known)
        self._budgets[known.study, known.name, known.site] = known.carrier_budget_j


@contextlib.contextmanager
def alone_in(folder: Path) -> Iterator[None]:
    """Hold a folder against a second run in it, which would do everything twice.

    Raises
    ------
    InputError
        When another run holds it, or it cannot be made.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock = (folder / ".lock").open("w")
    except OSError as fault:
        raise InputError(str(folder), None, "", f"cannot be written: {fault.strerror}") from None
    with lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            problem = "another malipp bench is at work in this folder"
            raise InputError(str(folder), None, "", problem) from None
        yield


def _duration(time_s: float) -> str:
    minutes, seconds = divmod(round(time_s), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{seconds:02d}" if hours else f"{minutes}:{seconds:02d}"


@functools.cache
def _site(spec: Specification) -> str:
    text = build(spec, FIRST_BUDGET_J).model_dump_json(exclude_defaults=True)
    return hashlib.sha256(text.encode()).hexdigest()[:16]
