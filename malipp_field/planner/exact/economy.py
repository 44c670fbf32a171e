"""Least energy for given samples over whole schedules: the linear master, its prices and its lists.

    min  sum_k sum_c e_kc lambda_kc
    s.t. sum_c lambda_kc = robots of kind k                       for every kind
         samples of each class at each candidate as they are given
         sum_k sum_c h_cv lambda_kc = stock_v                     what is dropped is picked
         drops of t or more find others who pick t                custody drop by drop, as in `master`

e_kc is the least energy of a schedule over the orders of its stops. Robots that could stand in for each other
are of one kind and choose together, so that swapping them makes no second solution. While schedules are
priced, more may be picked than is dropped: that changes no optimum and keeps the dominance of `labels` valid.
Energies are in units of that of the plan at hand.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import highspy
import numpy as np
from numpy.typing import NDArray

from malipp_field.field import FloatArray
from malipp_field.planner.exact.schedules import Codes, Robot, robots_of
from malipp_field.planner.extract import TeamPlan
from malipp_field.planner.linear import INFINITY, Effort
from malipp_field.planner.problem import Problem, prune

_PENALTY = 10.0
"""Cost of what no schedule does yet: only to have a solution from the start."""
_REDUCED_COST = 1e-9
"""Schedules that save less are not looked for."""
_CONVERGED = 1e-7
"""Pricing ends when the bound is so near the master's value."""
_SAME = 1e-9
"""Relative difference of precision that is none."""
_LIST_ROOM = 1_500_000
"""Labels allowed for the list of one kind."""
_MOST_LISTED = 60_000
"""Schedules of all kinds together that are looked at."""


@dataclass(frozen=True)
class Row:
    """Bounds on a sum over robots of what a table, shape (P, C), has for the codes of their schedules."""

    lower: float
    upper: float
    tables: dict[int, FloatArray]
    """By kind of robot."""
    balance: bool = False
    """Whether plans meet ``lower`` exactly; more is allowed while schedules are priced."""


@dataclass(frozen=True)
class Pool:
    """Schedules of one kind.

    Attributes
    ----------
    codes : array, shape (M, P), less K
    energy : array, shape (M,)
        The least over the orders, in units of the plan's.
    values : array, shape (M, rows)
        What they bring into the rows.
    """

    codes: Codes
    energy: FloatArray
    values: FloatArray

    def only(self, kept: NDArray[np.bool_]) -> Pool:
        """Return some of them."""
        return Pool(self.codes[kept], self.energy[kept], self.values[kept])


class Economy:
    """The master, and how to find its columns.

    Attributes
    ----------
    problem : Problem
        With no more samples allowed than the plan takes, and without stops that are useless then.
    kinds : list of tuple of int
        Robots that could stand in for each other, in time as well.
    leads : list of Robot
        The first of each kind.
    totals : array, shape (V,)
        Most samples at each candidate.
    """

    def __init__(self, problem: Problem, best: TeamPlan) -> None:
        self.unit_j, self.precision = best.energy_j, best.precision
        classes = sorted({robot.precision for robot in problem.robots})
        options = [
            _combinations(problem, classes, i, float(precision)) for i, precision in enumerate(best.precision)
        ]
        self.totals = np.array([max(map(sum, own), default=0) for own in options], dtype=np.int64)
        self.problem = _limited(problem, classes, options)
        self.robots = robots_of(self.problem)
        for robot in self.robots:
            robot.actor = robot.actor._replace(toll=1.0 / self.unit_j)
        self.kinds = _kinds(self.problem, self.robots)
        self.leads = [self.robots[kind[0]] for kind in self.kinds]
        self.rows = [*self._sample_rows(classes, options), *self._exchange_rows()]
        self._tables = [
            np.array([row.tables.get(k, _nothing(robot)).ravel() for row in self.rows]).reshape(
                len(self.rows), len(robot.places) * robot.width
            )
            for k, robot in enumerate(self.leads)
        ]
        self.bound = -INFINITY
        self._dual = np.zeros(len(self.kinds) + len(self.rows))
        self._known: list[dict[bytes, float]] = [{} for _ in self.kinds]
        self._solver = self._new_solver()

    # rows

    def _sample_rows(self, classes: list[float], options: list[list[tuple[int, ...]]]) -> Iterator[Row]:
        for v, own in zip(self.problem.candidates, options, strict=True):
            here = [(k, robot) for k, robot in enumerate(self.leads) if v in robot.places]
            for c, precision in enumerate(classes):
                counts = [option[c] for option in own]
                if max(counts, default=0):
                    tables = {
                        k: _table(robot, v, robot.taken_of)
                        for k, robot in here
                        if robot.precision == precision
                    }
                    yield Row(min(counts), max(counts), tables)
            if len(own) > 1:  # the classes together make up the precision
                unit = classes[-1]
                total = sum(n * p for n, p in zip(own[0], classes, strict=True)) / unit
                tables = {k: _table(robot, v, robot.taken_of * (robot.precision / unit)) for k, robot in here}
                yield Row(total, total, tables)

    def _exchange_rows(self) -> Iterator[Row]:
        position = {v: i for i, v in enumerate(self.problem.candidates)}
        for v in sorted({v for robot in self.robots for v in robot.places}):
            here = [(k, robot) for k, robot in enumerate(self.leads) if v in robot.places]
            stock = sum(s.count for s in self.problem.stocks if s.node == v)
            drops = {k: int(robot.actor.most_drop[robot.places.index(v)]) for k, robot in here}
            if not any(drops.values()) and not stock:
                continue
            tables = {k: _table(robot, v, robot.exchange_of) for k, robot in here}
            yield Row(float(stock), INFINITY, tables, balance=True)
            taken = int(self.totals[position[v]]) if v in position else 0
            for t in range(1, max(drops.values()) + 1):
                yield from (self._sender_row(v, here, k, t) for k in drops if drops[k] >= t)
                if taken:
                    yield _anchored_row(v, here, t, taken)

    def _sender_row(self, v: int, here: list[tuple[int, Robot]], k: int, t: int) -> Row:
        """Return: robots of kind k that drop t or more at v need others that pick t.

        The sum over the kind of the rows of `master`, each robot of which counts the picks of all but itself.
        """
        alike, tables = len(self.kinds[k]), {}
        for o, robot in here:
            h = robot.exchange_of
            picks = np.clip(h, 0, t) * (alike - (o == k))
            tables[o] = _table(robot, v, picks - t * (h <= -t) if o == k else picks)
        return Row(0.0, INFINITY, tables)

    # pricing

    def _new_solver(self) -> highspy.Highs:
        solver = highspy.Highs()
        for option, value in (
            ("output_flag", False), ("threads", 1), ("presolve", "off"),
            ("primal_feasibility_tolerance", 1e-9), ("dual_feasibility_tolerance", 1e-9),
        ):  # fmt: skip
            solver.setOptionValue(option, value)
        none, nothing = np.zeros(0, dtype=np.int32), np.zeros(0)
        bounds = [(float(len(kind)), float(len(kind))) for kind in self.kinds]
        bounds += [(row.lower, row.upper) for row in self.rows]
        for i, (lower, upper) in enumerate(bounds):
            solver.addRow(lower, upper, 0, none, nothing)
            if lower > 0.0:
                solver.addCol(_PENALTY, 0.0, INFINITY, 1, np.array([i], dtype=np.int32), np.ones(1))
        return solver

    def price(self, effort: Effort) -> bool:
        """Raise the bound until no schedule lowers the master's value; tell whether there is one at all."""
        while not effort.over:
            self._solver.run()
            if self._solver.getModelStatus() != highspy.HighsModelStatus.kOptimal:
                return False
            value = self._solver.getInfo().objective_function_value
            dual = np.array(self._solver.getSolution().row_dual)
            news, lost = False, 0.0
            for k, robot in enumerate(self.leads):
                gain, least = self._gains(dual, k), -float(dual[k])
                most, found = robot.price_anew(gain, least + _REDUCED_COST)
                lost += len(self.kinds[k]) * max(0.0, most - least)
                for codes, worth in found:
                    energy = float(gain[np.arange(len(codes)), codes + robot.capacity].sum()) - worth
                    news |= self._add(k, codes, energy)
            if value - lost > self.bound:
                self.bound, self._dual = value - lost, dual
            if not news or value - self.bound < _CONVERGED:
                break
        return self.bound > -INFINITY

    def _gains(self, dual: FloatArray, k: int) -> FloatArray:
        """Return what the codes of a kind are worth, shape (P, C)."""
        gain: FloatArray = dual[len(self.kinds) :] @ self._tables[k]
        return gain.reshape(len(self.leads[k].places), -1)

    def _add(self, k: int, codes: Codes, energy: float) -> bool:
        """Add a schedule; tell whether it is new, or known only with more energy."""
        key = codes.tobytes()
        if energy > self._known[k].get(key, INFINITY) - _REDUCED_COST:
            return False
        self._known[k][key] = energy
        values = self._values(k, codes[None, :])[0]
        index = np.concatenate([[k], np.flatnonzero(values) + len(self.kinds)]).astype(np.int32)
        self._solver.addCol(energy, 0.0, INFINITY, len(index), index, np.append(1.0, values[values != 0.0]))
        return True

    def _values(self, k: int, codes: Codes) -> FloatArray:
        """Return what schedules bring into the rows, shape (M, rows)."""
        robot, tables = self.leads[k], self._tables[k].T
        if len(codes) > 1:
            tables = np.ascontiguousarray(tables)
        values = np.zeros((len(codes), len(self.rows)))
        for w in range(len(robot.places)):
            values += tables[w * robot.width + codes[:, w] + robot.capacity]
        return values

    def pools(self, most: float, effort: Effort) -> list[Pool] | None:
        """Return all schedules that a plan of energy ``most`` or less may hold; None if too many or too late.

        Parameters
        ----------
        most
            In units of the plan's energy.
        """
        found = []
        for k, robot in enumerate(self.leads):
            gain, least = self._gains(self._dual, k), -float(self._dual[k]) - (most - self.bound)
            listed = None if effort.over else robot.listed(gain, least, _LIST_ROOM)
            if listed is None:
                return None
            codes, energy = listed[0], listed[1] / self.unit_j
            worth = gain[np.arange(codes.shape[1]), codes + robot.capacity].sum(axis=1) - energy
            found.append((codes[worth >= least], energy[worth >= least]))
        if sum(len(codes) for codes, _ in found) > _MOST_LISTED:
            return None
        return [Pool(codes, energy, self._values(k, codes)) for k, (codes, energy) in enumerate(found)]


def _kinds(problem: Problem, robots: list[Robot]) -> list[tuple[int, ...]]:
    """Return the robots by what they can do, what it costs and when."""
    kinds: dict[tuple[object, ...], list[int]] = {}
    for r, (robot, view) in enumerate(zip(robots, problem.robots, strict=True)):
        times = view.closure.time_s[np.ix_(view.places, view.places)]
        kinds.setdefault((robot.twins, view.ready_s, times.tobytes()), []).append(r)
    return [tuple(kind) for kind in kinds.values()]


def _nothing(robot: Robot) -> FloatArray:
    return np.zeros((len(robot.places), robot.width))


def _table(robot: Robot, v: int, values: NDArray[Any]) -> FloatArray:
    table = _nothing(robot)
    table[robot.places.index(v)] = values
    return table


def _anchored_row(v: int, here: list[tuple[int, Robot]], t: int, taken: int) -> Row:
    """Return: robots that sample at v and drop t or more there need picks of t, but for samples beyond one.

    As in `master`: N of them take N samples or more, so N - 1 is no more than ``taken`` - 1, and somebody
    picks.
    """
    tables = {}
    for k, robot in here:
        h = robot.exchange_of
        tables[k] = _table(robot, v, np.clip(h, 0, t) - t * ((h <= -t) & (robot.taken_of > 0)))
    return Row(-float(t * (taken - 1)), INFINITY, tables)


def _combinations(problem: Problem, classes: list[float], i: int, precision: float) -> list[tuple[int, ...]]:
    """Return the samples by sensor class that gain just this precision at candidate i."""
    v = problem.candidates[i]
    most = [
        sum(min(int(robot.limits[v]), robot.capacity) for robot in problem.robots
            if robot.precision == kind and v in robot.places) for kind in classes
    ]  # fmt: skip
    close = _SAME * (precision + classes[-1])
    found: list[tuple[int, ...]] = []

    def extend(counts: tuple[int, ...], rest: float) -> None:
        c = len(counts)
        if c == len(classes):
            if abs(rest) <= close:
                found.append(counts)
            return
        for n in range(min(most[c], int((rest + close) / classes[c])) + 1):
            extend((*counts, n), rest - n * classes[c])

    extend((), precision - float(problem.gained[i]))
    return found


def _limited(problem: Problem, classes: list[float], options: list[list[tuple[int, ...]]]) -> Problem:
    """Return the problem in which nobody takes more samples anywhere than ``options`` have of his class."""
    robots = []
    for robot in problem.robots:
        limits, c = np.zeros_like(robot.limits), classes.index(robot.precision)
        for v, own in zip(problem.candidates, options, strict=True):
            limits[v] = min(int(robot.limits[v]), max((option[c] for option in own), default=0))
        robots.append(replace(robot, limits=limits))
    return prune(replace(problem, robots=tuple(robots)))
