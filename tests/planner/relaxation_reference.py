"""The relaxation's cone program written in cvxpy: the reference for the one built by hand."""

from __future__ import annotations

import cvxpy as cp
import numpy as np

from malipp_field.field import FloatArray
from malipp_field.planner.bounds.relaxation_rows import Polytope


def relaxed_optimum(polytope: Polytope, most: FloatArray) -> tuple[float, FloatArray]:
    """Return the least J over the polytope, and the precision at which it lies."""
    problem, model = polytope.problem, polytope.problem.information
    active = np.flatnonzero(most > 0)
    z = cp.Variable(len(polytope.lower))
    precision = problem.gained + polytope.precision_map() @ z
    A = cp.Variable((len(model.weights), len(active)))
    cross, K = model.k_tv[:, active], model.k_vv[np.ix_(active, active)]
    F = np.linalg.cholesky(K + 1e-12 * np.eye(len(active)))
    total: cp.Expression = cp.Constant(model.prior)
    for j, weight in enumerate(model.weights):
        error = cp.sum_squares(A[j] @ F) - 2.0 * cross[j] @ A[j]
        total += weight * (error + sum(cp.quad_over_lin(A[j, i], precision[v]) for i, v in enumerate(active)))
    rows = [
        polytope.equal.matrix @ z == polytope.equal.right,
        polytope.at_most.matrix @ z <= polytope.at_most.right,
        z >= polytope.lower,
        z <= polytope.upper,
    ]
    optimum = float(cp.Problem(cp.Minimize(total), rows).solve(solver=cp.CLARABEL))
    return optimum, np.asarray(precision.value, dtype=np.float64)
