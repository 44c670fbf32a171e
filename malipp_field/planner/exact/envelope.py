"""Lower bounds on J that hold between sampling plans, not only at them.

J is convex in the precision, so a mixture of plans looks better to a linear relaxation than each of them:
half a sample at either of two neighbours tells more than a whole sample at one of them, half of the time.
For some test points and the few candidates near them (a cluster), the convex envelope of J over all
combinations of levels there is computed instead: the least average of J over combinations drawn so that each
candidate has the levels of the relaxation in the right shares,

    env(z) = min { sum_pi w_pi J(pi) : w >= 0, sum_pi w_pi = 1, sum_{pi: pi_v = l} w_pi = z_vl }.

All other candidates are taken at their highest precision, which only lowers J. The dual solution of this
small linear program is a cut that is linear in z and valid everywhere.

A robot that samples u and v in one schedule does so in the same world: E[n_u n_v] is at least the sum of
lambda_c a_cu a_cv over its schedules. With these rows no mixture can pretend to sample neighbours in turn.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import highspy
import numpy as np
from numpy.typing import NDArray

from malipp_field.field import FloatArray, Information
from malipp_field.planner.linear import INFINITY

Pair = tuple[int, int, int]
"""Sensor class and two positions in V, the smaller first."""

_MOST_COMBINATIONS = 6000
_LEAST_RELEVANCE = 1e-5
"""Candidates that explain less of a group than this share of its prior variance stay out of its cluster."""


@dataclass(frozen=True)
class Level:
    """Selectors of one candidate that the envelope does not tell apart.

    Attributes
    ----------
    selectors : tuple of int
        Positions in the candidate's list of selectors; none stands for "not sampled".
    precision
        The highest of them: J is not overestimated.
    counts : tuple of int
        Most samples of each class.
    """

    selectors: tuple[int, ...]
    precision: float
    counts: tuple[int, ...]


@dataclass(frozen=True)
class Cut:
    """theta >= constant + sum of slopes times selectors + sum of pair slopes times E[n_u n_v]."""

    constant: float
    slopes: Mapping[tuple[int, int], float]
    """By (position in V, selector)."""
    pairs: Mapping[Pair, float]


def levels_of(counts: Mapping[int, tuple[int, ...]], classes: Sequence[float], gained: float) -> list[Level]:
    """Return the levels of a candidate: single samples apart, more than one together by the best class.

    Parameters
    ----------
    counts
        Samples by class of each selector that may be set.
    """
    groups: dict[tuple[str, int], list[int]] = {}
    for s, taken in counts.items():
        best = max(k for k, n in enumerate(taken) if n)
        groups.setdefault(("one" if sum(taken) == 1 else "more", best), []).append(s)
    found = [Level((), gained, (0,) * len(classes))]
    for members in groups.values():
        most = tuple(max(counts[s][k] for s in members) for k in range(len(classes)))
        precision = max(sum(n * p for n, p in zip(counts[s], classes, strict=True)) for s in members)
        found.append(Level(tuple(members), gained + precision, most))
    return found


class Envelope:
    """The envelope of J restricted to some test points.

    Parameters
    ----------
    information
        Prior covariance of those test points and of all candidates.
    levels : sequence, length V
        Levels of every candidate; one that is never sampled has only the first.
    """

    def __init__(self, information: Information, levels: Sequence[Sequence[Level]]) -> None:
        self.cluster = _cluster(information, levels)
        self.levels = [list(levels[i]) for i in self.cluster]
        shape = [len(own) for own in self.levels]
        self._grid = np.indices(shape).reshape(len(shape), -1).T if shape else np.zeros((1, 0), dtype=int)
        self.values = _values(information, levels, self.cluster, self._grid)
        self._pairs = self._pair_rows()
        self._first = np.cumsum([1, *(n - 1 for n in shape)])
        self._solver = self._linear_program()

    def separate(self, share: Sequence[FloatArray], together: Mapping[Pair, float]) -> Cut | None:
        """Return the cut that is highest at a point; None where the solver fails.

        Parameters
        ----------
        share : sequence, length V
            Selectors' values of every candidate.
        together
            Values of E[n_u n_v] at the point, zero where not given.
        """
        for c, (i, own) in enumerate(zip(self.cluster, self.levels, strict=True)):
            parts = np.array([sum(share[i][s] for s in level.selectors) for level in own[1:]])
            parts = np.clip(parts, 0.0, 1.0)
            parts /= max(1.0, parts.sum())
            for k, part in enumerate(parts):
                self._solver.changeRowBounds(int(self._first[c] + k), float(part), float(part))
        for row, (pair, _) in enumerate(self._pairs, start=int(self._first[-1])):
            self._solver.changeRowBounds(row, max(0.0, together.get(pair, 0.0) - 1e-7), INFINITY)
        if not self._solved():
            for row in range(int(self._first[-1]), int(self._first[-1]) + len(self._pairs)):
                self._solver.changeRowBounds(row, 0.0, INFINITY)
            if not self._solved():
                return None
        return self._cut(np.array(self._solver.getSolution().row_dual))

    def _solved(self) -> bool:
        self._solver.run()
        return bool(self._solver.getModelStatus() == highspy.HighsModelStatus.kOptimal)

    def _cut(self, dual: FloatArray) -> Cut:
        """Return the cut of a dual solution, lowered until it holds at every combination."""
        slopes: dict[tuple[int, int], float] = {}
        total = np.zeros(len(self.values))
        for c, (i, own) in enumerate(zip(self.cluster, self.levels, strict=True)):
            slope = np.concatenate(([0.0], dual[self._first[c] : self._first[c] + len(own) - 1]))
            total += slope[self._grid[:, c]]
            slopes |= {
                (i, s): float(slope[k]) for k, level in enumerate(own) for s in level.selectors if slope[k]
            }
        pairs = {}
        for (pair, product), value in zip(self._pairs, dual[self._first[-1] :], strict=True):
            if value > 1e-7:
                pairs[pair] = float(value)
                total += value * product
        return Cut(float((self.values - total).min()), slopes, pairs)

    def _pair_rows(self) -> list[tuple[Pair, FloatArray]]:
        """Return n_u n_v at every combination for each class and pair of the cluster."""
        rows: list[tuple[Pair, FloatArray]] = []
        classes = len(self.levels[0][0].counts) if self.levels else 0
        for k in range(classes):
            counts = [
                np.array([level.counts[k] for level in own], dtype=float)[self._grid[:, c]]
                for c, own in enumerate(self.levels)
            ]
            for c, i in enumerate(self.cluster):
                for d in range(c):
                    product = counts[c] * counts[d]
                    if product.any():
                        j = self.cluster[d]
                        rows.append(((k, min(i, j), max(i, j)), product))
        return rows

    def _linear_program(self) -> highspy.Highs:
        solver = highspy.Highs()
        solver.setOptionValue("output_flag", False)
        solver.setOptionValue("threads", 1)
        solver.setOptionValue("presolve", "off")
        rows = [np.ones(len(self.values))]
        for c, own in enumerate(self.levels):
            rows += [(self._grid[:, c] == k).astype(float) for k in range(1, len(own))]
        rows += [product for _, product in self._pairs]
        matrix = np.array(rows)
        lp = highspy.HighsLp()
        lp.num_col_, lp.num_row_ = len(self.values), len(rows)
        lp.col_cost_ = self.values
        lp.col_lower_, lp.col_upper_ = np.zeros(len(self.values)), np.full(len(self.values), np.inf)
        lp.row_lower_ = np.array([1.0] + [0.0] * (len(rows) - 1))
        lp.row_upper_ = np.array([1.0] + [0.0] * (int(self._first[-1]) - 1) + [np.inf] * len(self._pairs))
        column, row = np.nonzero(matrix.T)
        lp.a_matrix_.format_ = highspy.MatrixFormat.kColwise
        lp.a_matrix_.start_ = np.searchsorted(column, np.arange(len(self.values) + 1)).astype(np.int32)
        lp.a_matrix_.index_ = row.astype(np.int32)
        lp.a_matrix_.value_ = matrix.T[column, row]
        solver.passModel(lp)
        return solver


def _cluster(information: Information, levels: Sequence[Sequence[Level]]) -> list[int]:
    """Return the candidates that explain most of the test points, as many as can be combined."""
    prior = np.diag(information.k_vv)
    explained = information.weights @ (information.k_tv**2 / np.maximum(prior, 1e-12))
    least = _LEAST_RELEVANCE * float(information.weights @ information.k_tt)
    found, size = [], 1
    for i in np.argsort(-explained, kind="stable"):
        many = len(levels[i])
        if many == 1:
            continue
        if explained[i] < least or size * many > _MOST_COMBINATIONS:
            break
        found.append(int(i))
        size *= many
    return found


def _values(
    information: Information,
    levels: Sequence[Sequence[Level]],
    cluster: Sequence[int],
    grid: NDArray[np.int64],
) -> FloatArray:
    """Return J at every combination of the cluster's levels, the others at their highest."""
    highest = np.array(
        [own[-1].precision if len(own) == 1 else max(level.precision for level in own) for own in levels]
    )
    rest = [i for i in range(len(levels)) if i not in cluster and highest[i] > 0.0]
    k_vv, k_tv, k_tt = information.k_vv, information.k_tv, information.k_tt.copy()
    inner, cross = k_vv[np.ix_(cluster, cluster)], k_tv[:, cluster]
    if rest:
        noisy = k_vv[np.ix_(rest, rest)] + np.diag(1.0 / highest[rest])
        to_cluster, to_tests = k_vv[np.ix_(rest, cluster)], k_tv[:, rest]
        weights = np.linalg.solve(noisy, np.hstack([to_cluster, to_tests.T]))
        inner = inner - to_cluster.T @ weights[:, : len(cluster)]
        cross = cross - to_tests @ weights[:, : len(cluster)]
        k_tt -= np.einsum("tr,rt->t", to_tests, weights[:, len(cluster) :])
    if not cluster:
        return np.array([float(information.weights @ k_tt)])
    precision = np.stack(
        [np.array([level.precision for level in levels[i]])[grid[:, c]] for c, i in enumerate(cluster)],
        axis=1,
    )
    root = np.sqrt(precision)
    system = np.eye(len(cluster)) + root[:, :, None] * inner * root[:, None, :]
    told = root[:, :, None] * cross.T
    fall = np.einsum("bct,bct->bt", told, np.linalg.solve(system, told))
    values: FloatArray = (k_tt - fall) @ information.weights
    return values
