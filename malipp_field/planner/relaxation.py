"""A proven lower bound on the information objective, for teams of any size.

The continuous relaxation of the paper's first stage in perspective form: over the polytope of
`relaxation_rows` with p = p0 + D z,

    min  sum_j W_jj [ k_jj - 2 k_j A_j + A_j' K_VV A_j + sum_v A_jv^2 / p_v ],

a cone program (each A_jv^2 / p_v a rotated cone) given to Clarabel by cvxpy. What is returned does not rest
on the solver's tolerance. J is convex, so J(p) >= J(q) + grad J(q).(p - q) for the solver's q, whatever q is;
and the smallest value of the right side over the polytope is at least what weak duality gives with the
solver's multipliers, whatever they are, because every variable lies in a finite box. Good solver output makes
that bound tight; bad output could only make it weak.
"""

from __future__ import annotations

import time
import warnings
from dataclasses import dataclass

import cvxpy as cp
import numpy as np
from scipy.linalg import eigh

from malipp_field.field import FloatArray
from malipp_field.mission import Mission, TeamState, initial_state
from malipp_field.planner.problem import Problem, build_problem
from malipp_field.planner.relaxation_rows import Polytope

_BUDGET_SLACK = 3e-6
"""The verifier forgives a millionth of a budget; the bound must hold for those plans too."""
_ROUNDING = 1e-9
"""Share of the prior J taken off the bound for rounding errors of its evaluation."""
_ROUNDS = 6
_WORTH = 1e-3
"""Rounds of cuts end when one raises the bound by less than this share of it."""


def relaxation_bound(mission: Mission, state: TeamState | None = None, time_limit_s: float = 60.0) -> float:
    """Return a lower bound on J (`eq:llse_objective`) of every plan, with or without handoffs.

    Parameters
    ----------
    mission
        The mission. Plans that draw on its `planner.energy_reserve` are not bounded, as no solver makes them.
    state
        Where the team stands; precision gained so far counts in full.
    time_limit_s
        Rounds of cuts stop when this is over; the bound is valid whenever it stops.

    Returns
    -------
    float
        Finite always, also for a mission that has no plan.
    """
    deadline = time.monotonic() + time_limit_s
    problem = build_problem(mission, _forgiving(state or initial_state(mission)))
    most = _most_precision(problem)
    slack = _ROUNDING * problem.information.prior
    bound = problem.information.value(most)
    if not all(robot.depots for robot in problem.robots) or not np.any(most > problem.gained):
        return bound - slack
    return max(bound, _cut_and_solve(Polytope(problem), most, deadline)) - slack


def _cut_and_solve(polytope: Polytope, most: FloatArray, deadline: float) -> float:
    """Return the best bound of a few rounds of solving and cutting off circles."""
    bound = -np.inf
    for _ in range(_ROUNDS):
        answer = _solve(polytope, most, deadline - time.monotonic())
        if answer is None:
            break
        before, bound = bound, max(bound, _certified(polytope, answer))
        if bound - before < _WORTH * abs(bound) or time.monotonic() > deadline or not polytope.cut(answer.z):
            break
    return float(bound)


def _forgiving(state: TeamState) -> TeamState:
    """Return the state with budgets as far as the verifier lets a plan go."""
    robots = tuple(
        robot.model_copy(update={"energy_left_j": robot.energy_left_j * (1 + _BUDGET_SLACK) + _BUDGET_SLACK})
        for robot in state.robots
    )
    return state.model_copy(update={"robots": robots})


def _most_precision(problem: Problem) -> FloatArray:
    """Return the precision if every robot took all it may wherever it can drive to, shape (V,)."""
    most = problem.gained.copy()
    for robot in problem.robots:
        for i, v in enumerate(problem.candidates):
            if v in robot.places:
                most[i] += robot.limits[v] * robot.precision
    return most


@dataclass(frozen=True)
class _Answer:
    """What the cone solver gave: a point, its precision, and multipliers of the polytope's rows."""

    z: FloatArray
    precision: FloatArray
    equal: FloatArray
    at_most: FloatArray


def _solve(polytope: Polytope, most: FloatArray, time_limit_s: float) -> _Answer | None:
    """Return the solver's answer, of whatever quality; None where it gave none."""
    problem = polytope.problem
    z = cp.Variable(len(polytope.lower))
    gain, rows, ceiling = polytope.precision_map(), polytope.equal, polytope.at_most
    constraints = [rows.matrix @ z == rows.right, ceiling.matrix @ z <= ceiling.right]
    constraints += [z >= polytope.lower, z <= polytope.upper]
    objective = cp.Minimize(_perspective(problem, most, problem.gained + gain @ z))
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # an inaccurate answer is no worse than the bound made of it
            cp.Problem(objective, constraints).solve(solver=cp.CLARABEL, time_limit=max(time_limit_s, 0.1))
    except cp.SolverError:
        return None
    if z.value is None or constraints[0].dual_value is None or constraints[1].dual_value is None:
        return None
    point = np.clip(z.value, polytope.lower, polytope.upper)
    return _Answer(
        z=point,
        precision=problem.gained + gain @ point,
        equal=np.asarray(constraints[0].dual_value, dtype=np.float64),
        at_most=np.maximum(np.asarray(constraints[1].dual_value, dtype=np.float64), 0.0),
    )


def _perspective(problem: Problem, most: FloatArray, precision: cp.Expression) -> cp.Expression:
    """Return J less a constant, as a convex expression in the estimator and the precision.

    The weighted test points enter only by K_VT W K_TV = L L', so there are as many rows of A as that has
    rank, not as many as test points.
    """
    model = problem.information
    active = np.flatnonzero(most > 0)
    K = model.k_vv[np.ix_(active, active)]
    cross = model.k_tv[:, active]
    L, F = _root((cross.T * model.weights) @ cross), _root(K)
    A = cp.Variable((L.shape[1], len(active)))
    noise = sum(
        cp.quad_over_lin(A[:, i] / np.sqrt(most[v]), precision[v] / most[v]) for i, v in enumerate(active)
    )
    return cp.sum_squares(A @ F) - 2.0 * cp.sum(cp.multiply(L.T, A)) + noise


def _root(matrix: FloatArray) -> FloatArray:
    """Return B with B B' = matrix but for what is a billionth of its size."""
    size, vectors = eigh(matrix)
    kept = size > 1e-9 * size[-1]
    return np.asarray(vectors[:, kept] * np.sqrt(size[kept]), dtype=np.float64)


def _certified(polytope: Polytope, answer: _Answer) -> float:
    """Return the bound that tangent and multipliers prove (see the head of this module)."""
    problem, equal, at_most = polytope.problem, polytope.equal, polytope.at_most
    value, gradient = problem.information.value_and_gradient(answer.precision)
    slope = polytope.precision_map().T @ gradient
    reduced = slope + equal.matrix.T @ answer.equal + at_most.matrix.T @ answer.at_most
    smallest = np.minimum(reduced * polytope.lower, reduced * polytope.upper).sum()
    constant = gradient @ (problem.gained - answer.precision)
    return float(value + constant + smallest - answer.equal @ equal.right - answer.at_most @ at_most.right)
