"""The relaxation of `relaxation` as a cone program, row by row as Clarabel takes it.

    min  1/2 x' P x + q' x   such that   M x + s = b,  s in a product of cones,

with x = (z, A by rows, t): z in the polytope, A the estimator over the candidates that can be sampled, and
t_v >= sum_j A_jv^2 / p_v. J less a constant is sum_j A_j K A_j' - 2 <L', A> + sum_v t_v, where
L L' = K_VT W K_TV: the weighted test points enter by it alone, so A has as many rows as that has rank, not as
many as test points. With u = A_.v / sqrt(m_v) and p = p_v / m_v (m the most precision there can be),
t p >= u'u is the cone ||(p - t, 2 u)|| <= p + t. The same program in cvxpy is a test's reference: importing
cvxpy takes longer than solving this.
"""

from __future__ import annotations

from typing import NamedTuple

import clarabel
import numpy as np
from scipy import sparse

from malipp_field.field import FloatArray
from malipp_field.planner.bounds.relaxation_rows import Polytope

_ANSWERS = {"Solved", "AlmostSolved", "MaxIterations", "MaxTime"}
"""Clarabel's words for an end with a point."""


class ConeSolution(NamedTuple):
    """Clarabel's point of the polytope and its multipliers of `Polytope.equal` and `Polytope.at_most`."""

    z: FloatArray
    equal: FloatArray
    at_most: FloatArray


def solve_cone(polytope: Polytope, most: FloatArray, time_limit_s: float) -> ConeSolution | None:
    """Return what Clarabel finds in this time, None where it gives no point.

    Parameters
    ----------
    most : array, shape (V,)
        m: the precision if every robot took all it may.
    """
    equal, at_most = polytope.equal, polytope.at_most
    lower, upper = polytope.lower, polytope.upper
    active = np.flatnonzero(most > 0)
    quadratic, linear = _objective(polytope, active)
    estimator = quadratic.shape[0] // len(active)
    cone_rows, cone_right = _cones(polytope, most, active, estimator)
    identity = sparse.eye_array(len(lower))
    box = sparse.vstack([equal.matrix, at_most.matrix, -identity, identity])
    box = sparse.hstack([box, sparse.csc_array((box.shape[0], cone_rows.shape[1] - len(lower)))])
    no_cost = sparse.csc_array((len(lower), len(lower)))
    none = sparse.csc_array((len(active), len(active)))
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.time_limit = time_limit_s
    solution = clarabel.DefaultSolver(
        sparse.csc_matrix(sparse.triu(sparse.block_diag([no_cost, quadratic, none]))),
        np.concatenate([np.zeros(len(lower)), linear, np.ones(len(active))]),
        sparse.csc_matrix(sparse.vstack([box, cone_rows])),
        np.concatenate([equal.right, at_most.right, -lower, upper, cone_right]),
        [
            clarabel.ZeroConeT(len(equal.right)),
            clarabel.NonnegativeConeT(len(at_most.right) + 2 * len(lower)),
            *[clarabel.SecondOrderConeT(estimator + 2)] * len(active),
        ],
        settings,
    ).solve()
    if str(solution.status) not in _ANSWERS:
        return None
    multipliers = np.array(solution.z)
    first, last = len(equal.right), len(equal.right) + len(at_most.right)
    return ConeSolution(np.array(solution.x)[: len(lower)], multipliers[:first], multipliers[first:last])


def _objective(polytope: Polytope, active: np.ndarray) -> tuple[sparse.csc_array, FloatArray]:
    """Return P and q of the estimator, A by rows."""
    model = polytope.problem.information
    cross = model.k_tv[:, active]
    L, F = _root((cross.T * model.weights) @ cross), _root(model.k_vv[np.ix_(active, active)])
    quadratic = sparse.kron(sparse.eye_array(L.shape[1]), 2.0 * F @ F.T, format="csc")
    return quadratic, -2.0 * L.T.ravel()


def _cones(
    polytope: Polytope, most: FloatArray, active: np.ndarray, estimator: int
) -> tuple[sparse.csc_array, FloatArray]:
    """Return the rows of M and b for s_v = (p + t, p - t, 2 u) of every candidate that can be sampled."""
    gained = polytope.problem.gained[active] / most[active]
    precision = sparse.diags_array(1.0 / most[active]) @ polytope.precision_map()[active]
    size, count = estimator + 2, len(active)
    # row numbers: candidate by candidate, in each the sum, the difference, and u
    sums, differences = np.arange(count) * size, np.arange(count) * size + 1
    ones, at = np.ones(count), np.arange(count)
    shape = (count * size, count)
    slots = sparse.csc_array((ones, (sums, at)), shape) + sparse.csc_array((ones, (differences, at)), shape)
    ends = sparse.csc_array((ones, (sums, at)), shape) - sparse.csc_array((ones, (differences, at)), shape)
    j, v = np.divmod(np.arange(estimator * count), count)
    entries = 2.0 / np.sqrt(most[active])[v]
    columns = sparse.csc_array((entries, (v * size + 2 + j, np.arange(len(v)))), (count * size, len(v)))
    return sparse.csc_array(sparse.hstack([-slots @ precision, -columns, -ends])), slots @ gained


def _root(matrix: FloatArray) -> FloatArray:
    """Return B with B B' = matrix but for what is a billionth of its size."""
    size, vectors = np.linalg.eigh(matrix)
    kept = size > 1e-9 * size[-1]
    return np.asarray(vectors[:, kept] * np.sqrt(size[kept]), dtype=np.float64)
