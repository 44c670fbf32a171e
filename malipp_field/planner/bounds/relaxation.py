"""A proven lower bound on the information objective, for teams of any size.

The continuous relaxation of the paper's first stage in perspective form: over the polytope of
`relaxation_rows` with p = p0 + D z,

    min  sum_j W_jj [ k_jj - 2 k_j A_j + A_j' K_VV A_j + sum_v A_jv^2 / p_v ],

a cone program (each A_jv^2 / p_v a rotated cone) for Clarabel (`relaxation_cone`). What is returned does not
rest on the solver's tolerance. J is convex, so J(p) >= J(q) + grad J(q).(p - q) for the solver's q, whatever
q is; and the smallest value of the right side over the polytope is at least what weak duality gives with the
solver's multipliers, whatever they are, because every variable lies in a finite box. Good solver output makes
that bound tight; bad output could only make it weak.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from malipp_field.field import FloatArray
from malipp_field.mission import Mission, TeamState, initial_state
from malipp_field.planner.bounds.quick import is_relaxable
from malipp_field.planner.bounds.relaxation_cone import solve_cone
from malipp_field.planner.bounds.relaxation_rows import Polytope
from malipp_field.planner.problem import Problem, build_problem

_BUDGET_SLACK = 3e-6
"""The verifier forgives a millionth of a budget; the bound must hold for those plans too."""
_ROUNDING = 1e-9
"""Share of the prior J taken off the bound for rounding errors of its evaluation."""
_STEP = 1e-6
"""Change of a capacity, or of a budget as a share of it, from which a slope is taken."""
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


@dataclass(frozen=True)
class RelaxedValue:
    """By how much the relaxed optimum falls with a little more of what a robot has.

    Attributes
    ----------
    per_joule
        Fall in J per joule of B_r.
    per_sample
        Fall in J per sample of K_r.
    """

    per_joule: float
    per_sample: float


def relaxed_values(
    mission: Mission, state: TeamState | None = None, time_limit_s: float = 60.0
) -> dict[str, RelaxedValue] | None:
    """Return what budgets and capacities are worth at the margin of the relaxation, by robot id.

    They come from the multipliers of one cone program (the derivative of its Lagrangian), whatever the size
    of the team, and speak of the relaxed problem, before any cuts: samples and routes in fractions, drops
    for nothing.

    Returns
    -------
    dict or None
        Without the robots for which there was no time (the multipliers may take as long again as the solver
        did); None where some robot reaches no depot, the team is too large (`is_relaxable`), or the
        solver gave no answer in time.
    """
    started = time.monotonic()
    problem = build_problem(mission, state)
    most = _most_precision(problem)
    if not is_relaxable(problem) or not all(robot.depots for robot in problem.robots):
        return None
    if not np.any(most > problem.gained):
        return {robot.id: RelaxedValue(0.0, 0.0) for robot in problem.robots}
    polytope = Polytope(problem)
    answer = _solve(polytope, most, time_limit_s)
    if answer is None:
        return None
    solved = time.monotonic()
    deadline = max(started + time_limit_s, 2 * solved - started)
    values = {}
    for r, robot in enumerate(problem.robots):
        if time.monotonic() > deadline:
            break
        values[robot.id] = RelaxedValue(
            per_joule=_slope(polytope, answer, r, "budget_j", _STEP * max(robot.budget_j, 1.0)),
            per_sample=_slope(polytope, answer, r, "capacity", _STEP),
        )
    return values


def _slope(polytope: Polytope, answer: _Answer, r: int, what: str, step: float) -> float:
    """Return by how much the optimum falls per unit as ``what`` robot ``r`` has changes by ``step``.

    By the envelope theorem: the change of the Lagrangian at the answer, with rows and box of the changed
    robot. More is tried, then less: a change that adds or removes an arc cannot be compared.
    """
    problem, robot = polytope.problem, polytope.problem.robots[r]
    _, gradient = problem.information.value_and_gradient(answer.precision)
    reduced = polytope.precision_map().T @ gradient + _pull(polytope, answer)
    for change in (step, -step):
        # Also of a capacity: to the relaxation fractions of a sample are as good as samples.
        changes: dict[str, Any] = {what: max(0.0, getattr(robot, what) + change)}
        robots = (*problem.robots[:r], replace(robot, **changes), *problem.robots[r + 1 :])
        other = Polytope(replace(problem, robots=robots))
        if len(other.lower) != len(polytope.lower):
            continue
        box = np.minimum(reduced, 0.0) @ (other.upper - polytope.upper)
        box += np.maximum(reduced, 0.0) @ (other.lower - polytope.lower)
        rows = _excess(other, answer) - _excess(polytope, answer)
        return max(0.0, -float(rows + box) / change)
    return 0.0


def _pull(polytope: Polytope, answer: _Answer) -> FloatArray:
    """Return the multipliers times the rows, shape (Z,)."""
    return np.asarray(
        polytope.equal.matrix.T @ answer.equal + polytope.at_most.matrix.T @ answer.at_most, dtype=np.float64
    )


def _excess(polytope: Polytope, answer: _Answer) -> float:
    """Return the multipliers times what the answer exceeds the right sides by."""
    right = answer.equal @ polytope.equal.right + answer.at_most @ polytope.at_most.right
    return float(_pull(polytope, answer) @ answer.z - right)


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
    solution = solve_cone(polytope, most, max(time_limit_s, 0.1))
    if solution is None:
        return None
    point = np.clip(solution.z, polytope.lower, polytope.upper)
    return _Answer(
        z=point,
        precision=polytope.problem.gained + polytope.precision_map() @ point,
        equal=solution.equal,
        at_most=np.maximum(solution.at_most, 0.0),
    )


def _certified(polytope: Polytope, answer: _Answer) -> float:
    """Return the bound that tangent and multipliers prove (see the head of this module)."""
    problem, equal, at_most = polytope.problem, polytope.equal, polytope.at_most
    value, gradient = problem.information.value_and_gradient(answer.precision)
    reduced = polytope.precision_map().T @ gradient + _pull(polytope, answer)
    smallest = np.minimum(reduced * polytope.lower, reduced * polytope.upper).sum()
    constant = gradient @ (problem.gained - answer.precision)
    return float(value + constant + smallest - answer.equal @ equal.right - answer.at_most @ at_most.right)
