"""Which listed schedules make up a team: cuts over the lists, and one choice after the other by HiGHS.

A choice gives every robot a schedule (see `economy`). The lists are shortened by reduced costs and by
zero-half cuts: three rows of whole numbers are added, halved and rounded down.
"""

from __future__ import annotations

import itertools

import highspy
import numpy as np
from numpy.typing import NDArray

from malipp_field.field import FloatArray
from malipp_field.planner.exact.economy import Economy, Pool
from malipp_field.planner.exact.schedules import Codes
from malipp_field.planner.linear import INFINITY, Effort, LinearModel

Choice = list[Codes]
"""The schedule of every robot of the problem, in order."""

_ROUNDS = 20
_AT_ONCE = 40
"""Cuts added in one round, at most."""
_VIOLATED = 0.02
_SLOW = 1e-4
"""Cutting ends when a round raises the bound by less."""


class Choices:
    """The choices of schedules with the least energy, one after the other.

    Attributes
    ----------
    bound
        No plan has less energy, in units of the first plan's.
    """

    def __init__(self, economy: Economy, pools: list[Pool]) -> None:
        self.economy, self.bound = economy, economy.bound
        self.pools = pools
        self._cuts: list[tuple[FloatArray, float]] = []
        """Rows over all listed schedules, and what they are at most."""
        self._refused: list[list[tuple[int, bytes, int]]] = []

    # the relaxation

    def tighten(self, most: float, effort: Effort) -> None:
        """Cut, and forget schedules of no plan of energy ``most`` or less."""
        before = -INFINITY
        for _ in range(_ROUNDS):
            solved = self._relaxed(effort)
            if solved is None:
                break
            value, x, reduced = solved
            self.bound = max(self.bound, min(value, most))  # of what takes more, not all is listed
            keep = (reduced <= most - value) | (x > 0.0)
            self._keep(keep)
            if value > most or value < before + _SLOW or not self._separate(x[keep]):
                break
            before = value

    def _relaxed(self, effort: Effort) -> tuple[float, FloatArray, FloatArray] | None:
        """Return the value of the linear program, its point and its reduced costs."""
        matrix, lower, upper = self._matrix()
        cost = self._energy()
        solver = highspy.Highs()
        for option, setting in (
            ("output_flag", False), ("threads", 1), ("time_limit", effort.left_s),
            ("primal_feasibility_tolerance", 1e-9), ("dual_feasibility_tolerance", 1e-9),
        ):  # fmt: skip
            solver.setOptionValue(option, setting)
        rows, columns = np.nonzero(matrix)
        starts = np.searchsorted(rows, np.arange(len(matrix))).astype(np.int32)
        solver.passModel(
            len(cost), len(matrix), len(rows), int(highspy.MatrixFormat.kRowwise),
            int(highspy.ObjSense.kMinimize), 0.0, cost, np.zeros(len(cost)), np.full(len(cost), INFINITY),
            lower, upper, starts, columns.astype(np.int32), matrix[rows, columns],
            np.zeros(len(cost), dtype=np.int32),
        )  # fmt: skip
        solver.run()
        status = solver.getModelStatus()
        if status == highspy.HighsModelStatus.kInfeasible:
            return INFINITY, np.zeros(len(cost)), np.full(len(cost), INFINITY)
        if status != highspy.HighsModelStatus.kOptimal:
            return None
        solution = solver.getSolution()
        value = solver.getInfo().objective_function_value
        return value, np.array(solution.col_value), np.array(solution.col_dual)

    def _matrix(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return all rows over all schedules, with their bounds."""
        economy = self.economy
        kinds = np.concatenate([np.full(len(pool.codes), k) for k, pool in enumerate(self.pools)])
        belongs = (kinds[None, :] == np.arange(len(economy.kinds))[:, None]).astype(float)
        values = np.concatenate([pool.values for pool in self.pools]).T
        cuts = np.array([cut for cut, _ in self._cuts]).reshape(-1, len(kinds))
        robots = [float(len(kind)) for kind in economy.kinds]
        lower = [*robots, *(row.lower for row in economy.rows), *(-INFINITY for _ in self._cuts)]
        upper = [*robots, *(row.lower if row.balance else row.upper for row in economy.rows),
                 *(most for _, most in self._cuts)]  # fmt: skip
        return np.concatenate([belongs, values, cuts]), np.array(lower), np.array(upper)

    def _energy(self) -> FloatArray:
        return np.concatenate([pool.energy for pool in self.pools])

    def _keep(self, kept: NDArray[np.bool_]) -> None:
        ends = np.cumsum([len(pool.codes) for pool in self.pools])[:-1]
        self.pools = [pool.only(part) for pool, part in zip(self.pools, np.split(kept, ends), strict=True)]
        self._cuts = [(cut[kept], most) for cut, most in self._cuts]

    def _separate(self, x: FloatArray) -> int:
        """Add zero-half cuts that the point violates; return how many.

        Shares are not negative, so half of a sum of rows with its coefficients rounded down is at most half
        of what the rows add up to, and at a choice it is whole.
        """
        parts, totals = self._whole()
        used = np.flatnonzero(x > 1e-9)
        triples = np.array(list(itertools.combinations(range(len(parts)), 3)), dtype=np.int64).reshape(-1, 3)
        triples = triples[totals[triples].sum(axis=1) % 2 == 1]  # nothing is rounded down otherwise
        most = np.floor(totals[triples].sum(axis=1) / 2.0)
        own = parts[:, used]
        excess = np.zeros(len(triples))
        for first in range(0, len(triples), 4096):
            here = triples[first : first + 4096]
            halves = np.floor((own[here[:, 0]] + own[here[:, 1]] + own[here[:, 2]]) / 2.0)
            excess[first : first + 4096] = halves @ x[used] - most[first : first + 4096]
        worst = np.argsort(-excess, kind="stable")[:_AT_ONCE]
        worst = worst[excess[worst] > _VIOLATED]
        for t in worst:
            self._cuts.append((np.floor(parts[triples[t]].sum(axis=0) / 2.0), float(most[t])))
        return len(worst)

    def _whole(self) -> tuple[FloatArray, FloatArray]:
        """Return rows of whole numbers that plans meet with equality, and what they add up to.

        Robots of each kind, samples at each candidate, and exchanges at each node, with both signs.
        """
        economy = self.economy
        matrix, lower, upper = self._matrix()
        count = len(economy.kinds) + len(economy.rows)
        fixed = [
            i
            for i in range(count)
            if lower[i] == upper[i]
            and (matrix[i] == np.rint(matrix[i])).all()
            and lower[i] == np.rint(lower[i])
        ]
        signed = [i for i in fixed if (matrix[i] < 0.0).any()]
        return np.concatenate([matrix[fixed], -matrix[signed]]), np.concatenate(
            [lower[fixed], -lower[signed]]
        )

    # whole choices

    def energy_j(self, choice: Choice) -> float:
        """Return the energy of the cheapest orders, in joules."""
        total = 0.0
        for kind, pool in zip(self.economy.kinds, self.pools, strict=True):
            known = {codes.tobytes(): energy for codes, energy in zip(pool.codes, pool.energy, strict=True)}
            total += sum(known[choice[r].tobytes()] for r in kind)
        return float(total) * self.economy.unit_j

    def refuse(self, choice: Choice) -> None:
        """Leave a choice out from now on, whichever robots of a kind follow which of its schedules."""
        copies: dict[tuple[int, bytes], int] = {}
        refused = []
        for k, kind in enumerate(self.economy.kinds):
            for r in kind:
                key = (k, choice[r].tobytes())
                copies[key] = copies.get(key, 0) + 1
                refused.append((*key, copies[key]))
        self._refused.append(refused)

    def next(self, most: float, effort: Effort, seed: int) -> tuple[Choice | None, bool]:
        """Return the choice of least energy, ``most`` at most, or None and whether there is none.

        A schedule that several robots of a kind can follow has one binary column for each of them, in order:
        so a refused choice is one row.
        """
        model = LinearModel(seed=seed)
        matrix, lower, upper = self._matrix()
        energy = self._energy()
        column: dict[tuple[int, bytes, int], int] = {}
        copies: list[list[int]] = []
        for k, pool in enumerate(self.pools):
            for codes, many in zip(pool.codes, self._copies(k, pool), strict=True):
                cost = float(energy[len(copies)])
                copies.append([model.column(0, 1, integer=True, cost=cost) for _ in range(many)])
                column |= {(k, codes.tobytes(), c): own for c, own in enumerate(copies[-1], 1)}
        for values, least, greatest in zip(matrix, lower, upper, strict=True):
            terms = [(own, float(values[m])) for m in np.flatnonzero(values) for own in copies[m]]
            model.row(terms, float(least), float(greatest))
        model.row([(own, energy[m]) for m, same in enumerate(copies) for own in same], upper=most)
        for one, other in itertools.chain.from_iterable(map(itertools.pairwise, copies)):
            model.row([(one, 1.0), (other, -1.0)], lower=0.0)
        for refused in self._refused:
            if all(key in column for key in refused):
                model.row([(column[key], 1.0) for key in refused], upper=len(refused) - 1.0)
        outcome = model.solve(effort, gap=1e-9)
        if outcome.point is None or outcome.status != "optimal":
            return None, outcome.status == "infeasible"
        point = outcome.point
        return self._choice([sum(round(float(point[own])) for own in copy) for copy in copies]), False

    def _copies(self, k: int, pool: Pool) -> list[int]:
        """Return how many of a kind can follow each schedule so that all their samples fit at its stops."""
        robot, totals = self.economy.leads[k], self.economy.totals
        position = {v: i for i, v in enumerate(self.economy.problem.candidates)}
        most = np.array([totals[position[v]] if v in position else 0 for v in robot.places])
        taken = robot.taken_of[pool.codes + robot.capacity]
        room = np.where(taken > 0, most // np.maximum(taken, 1), len(self.economy.kinds[k]))
        return [max(1, min(int(n), len(self.economy.kinds[k]))) for n in room.min(axis=1)]

    def _choice(self, parts: list[int]) -> Choice:
        """Return the schedules that have parts, for the robots of each kind in order."""
        choice: Choice = [np.zeros(0, dtype=np.int16)] * len(self.economy.robots)
        listed = iter(parts)
        for kind, pool in zip(self.economy.kinds, self.pools, strict=True):
            followed = [codes for codes in pool.codes for _ in range(next(listed))]
            for r, codes in zip(kind, followed, strict=True):
                choice[r] = codes
        return choice
