"""A mixed-integer linear model that grows row by row, solved by HiGHS."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Any

import highspy
import numpy as np

from malipp_field.field import FloatArray

Terms = Iterable[tuple[int, float]]
INFINITY = math.inf
_TOLERANCE = 1e-7
_INTERRUPT = highspy.cb.HighsCallbackType.kCallbackMipInterrupt
_IMPROVED = highspy.cb.HighsCallbackType.kCallbackMipImprovingSolution
_OFFER = highspy.cb.HighsCallbackType.kCallbackMipUserSolution
_EVENTS = (_INTERRUPT, _IMPROVED, _OFFER)
_FIRST_PAUSE = 20


@dataclass(frozen=True)
class Outcome:
    """What one run gave: whether it ended by proof, the bound, and the best point (if any).

    ``status`` is "optimal", "infeasible" or "stopped".
    """

    status: str
    bound: float
    point: FloatArray | None


@dataclass(frozen=True)
class Effort:
    """How long a run may take: by the clock, or until somebody cancels."""

    deadline: float
    """On `time.monotonic`."""
    cancelled: Callable[[], bool] = lambda: False

    @property
    def left_s(self) -> float:
        """Seconds until the deadline, never negative."""
        return max(0.0, self.deadline - time.monotonic())

    @property
    def over(self) -> bool:
        """Whether time is up or the caller has cancelled."""
        return self.left_s <= 0.0 or self.cancelled()


@dataclass(frozen=True)
class Listener:
    """What the caller does while branch and cut runs."""

    on_point: Callable[[FloatArray], None]
    """Called with every improving integer point as it is found."""
    on_pause: Callable[[int], FloatArray | None]
    """Called after 20, 40, 80 ... asks of HiGHS whether it should stop, with that number; a point it returns
    is given to the solver as a solution. Unlike seconds, asks come at the same points of every search."""


@dataclass
class LinearModel:
    """Columns and rows in COO form, handed to HiGHS when first solved and then kept in step with it."""

    seed: int = 0
    cost: list[float] = field(default_factory=list)
    lower: list[float] = field(default_factory=list)
    upper: list[float] = field(default_factory=list)
    integer: list[bool] = field(default_factory=list)
    _starts: list[int] = field(default_factory=list)
    _index: list[int] = field(default_factory=list)
    _value: list[float] = field(default_factory=list)
    _row_lower: list[float] = field(default_factory=list)
    _row_upper: list[float] = field(default_factory=list)
    _solver: Any = None

    def column(self, lower: float, upper: float, *, integer: bool = False, cost: float = 0.0) -> int:
        """Add a column and return its index. Columns come before the first solve."""
        assert self._solver is None
        self.lower.append(lower)
        self.upper.append(upper)
        self.integer.append(integer)
        self.cost.append(cost)
        return len(self.cost) - 1

    def row(self, terms: Terms, lower: float = -INFINITY, upper: float = INFINITY) -> None:
        """Add ``lower <= sum(coefficient * column) <= upper``; terms on the same column add up."""
        merged: dict[int, float] = {}
        for column, coefficient in terms:
            merged[column] = merged.get(column, 0.0) + coefficient
        self._starts.append(len(self._index))
        self._index.extend(merged)
        self._value.extend(merged.values())
        self._row_lower.append(lower)
        self._row_upper.append(upper)
        if self._solver is not None:
            self._solver.addRow(
                lower,
                upper,
                len(merged),
                np.array(list(merged), dtype=np.int32),
                np.array(list(merged.values())),
            )

    def objective(self, terms: Terms) -> None:
        """Replace the objective (to be minimised)."""
        costs = np.zeros(len(self.cost))
        for column, coefficient in terms:
            costs[column] += coefficient
        self.cost = list(costs)
        self._live().changeColsCost(len(costs), np.arange(len(costs), dtype=np.int32), costs)

    def solve_relaxed(self, effort: Effort) -> Outcome:
        """Solve with integrality dropped; the bound is minus infinity unless solved to the end."""
        solver = self._live()
        self._set_integrality(relaxed=True)
        solver.setOptionValue("time_limit", effort.left_s)
        solver.run()
        status = solver.getModelStatus()
        if status == highspy.HighsModelStatus.kInfeasible:
            return Outcome("infeasible", INFINITY, None)
        if status != highspy.HighsModelStatus.kOptimal:
            return Outcome("stopped", -INFINITY, None)
        return Outcome("optimal", solver.getInfo().objective_function_value, _point(solver))

    def solve(
        self,
        effort: Effort,
        *,
        gap: float,
        start: FloatArray | None = None,
        listener: Listener | None = None,
    ) -> Outcome:
        """Branch and cut to a relative gap, from a full feasible point ``start`` if there is one."""
        solver = self._live()
        self._set_integrality(relaxed=False)
        solver.clearSolver()
        solver.setOptionValue("time_limit", effort.left_s)
        solver.setOptionValue("mip_rel_gap", gap)
        # With presolve a start can cut off better points (HiGHS 1.15.1: a wrong optimum, 11 of 20 seeds).
        solver.setOptionValue("presolve", "choose" if start is None else "off")
        if start is not None:
            _set_start(solver, start)
        _watch(solver, effort, listener)
        solver.run()
        for event in _EVENTS:
            solver.stopCallback(event)
        return _outcome(solver)

    def _live(self) -> Any:
        if self._solver is None:
            self._solver = _new_solver(self.seed)
            self._solver.passModel(
                len(self.cost), len(self._row_lower), len(self._index), int(highspy.MatrixFormat.kRowwise),
                int(highspy.ObjSense.kMinimize), 0.0, np.array(self.cost), np.array(self.lower),
                np.array(self.upper), np.array(self._row_lower), np.array(self._row_upper),
                np.array(self._starts, dtype=np.int32), np.array(self._index, dtype=np.int32),
                np.array(self._value), np.array(self.integer, dtype=np.int32),
            )  # fmt: skip
        return self._solver

    def _set_integrality(self, *, relaxed: bool) -> None:
        kinds = [
            highspy.HighsVarType.kInteger if whole and not relaxed else highspy.HighsVarType.kContinuous
            for whole in self.integer
        ]
        columns = np.arange(len(kinds), dtype=np.int32)
        self._live().changeColsIntegrality(
            len(kinds), columns, np.array([int(k) for k in kinds], dtype=np.uint8)
        )


def _new_solver(seed: int) -> Any:
    solver = highspy.Highs()
    solver.setOptionValue("output_flag", False)
    solver.setOptionValue("random_seed", seed)
    solver.setOptionValue("primal_feasibility_tolerance", _TOLERANCE)
    solver.setOptionValue("mip_feasibility_tolerance", _TOLERANCE)
    solver.setOptionValue("mip_abs_gap", 1e-9)
    # Plans come from ruin and recreate, and most LP work went into trying out branches: both cost more than
    # they gave (measured on two robots and eight candidates).
    solver.setOptionValue("mip_heuristic_effort", 0.01)
    solver.setOptionValue("mip_pscost_minreliable", 2)
    # HiGHS has one scheduler a process and refuses a second number of threads; searches gain little by two
    solver.setOptionValue("threads", 1)
    return solver


def _set_start(solver: Any, start: FloatArray) -> None:
    solution = highspy.HighsSolution()
    solution.col_value = list(start)
    solver.setSolution(solution)


def _watch(solver: Any, effort: Effort, listener: Listener | None) -> None:
    calls, pause = 0, _FIRST_PAUSE
    offered: FloatArray | None = None

    def heard(what: Any, _message: str, said: Any, answer: Any, _data: object) -> None:
        nonlocal calls, pause, offered
        if what == int(_INTERRUPT):
            calls += 1
            if listener is not None and calls == pause:
                offered, pause = listener.on_pause(calls), 2 * pause
            answer.user_interrupt = effort.over
        elif what == int(_IMPROVED):
            if listener is not None:
                listener.on_point(np.array(said.mip_solution, dtype=np.float64))
        elif offered is not None:
            answer.setSolution(offered)
            offered = None

    solver.setCallback(heard, None)
    for event in _EVENTS:
        solver.startCallback(event)


def _outcome(solver: Any) -> Outcome:
    status = solver.getModelStatus()
    if status == highspy.HighsModelStatus.kInfeasible:
        return Outcome("infeasible", INFINITY, None)
    info = solver.getInfo()
    found = info.primal_solution_status == highspy.SolutionStatus.kSolutionStatusFeasible
    done = status == highspy.HighsModelStatus.kOptimal
    return Outcome("optimal" if done else "stopped", info.mip_dual_bound, _point(solver) if found else None)


def _point(solver: Any) -> FloatArray:
    return np.array(solver.getSolution().col_value, dtype=np.float64)
