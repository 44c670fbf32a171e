"""One robot on its own (the paper's LIPP): all it could do is listed, and J worked out for each.

A robot that carries a few samples has some ten or hundred thousand schedules at most, and J of a schedule of
k samples costs one system of k equations: that is quicker than any search. The listing does not depend on J,
so it serves for every stage of Seq-LIPP, and it gives the least energy of every schedule as well.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from malipp_field.field import FloatArray
from malipp_field.planner.exact.labels import complete_schedules, enumerate_labels, without_dominated
from malipp_field.planner.exact.realise import realise
from malipp_field.planner.exact.schedules import MOST_PLACES, Codes, Robot, robots_of
from malipp_field.planner.extract import TeamPlan
from malipp_field.planner.problem import IntArray, Problem

_ROOM = 1_000_000
"""Labels at most: half a second, and as many megabytes as a robot has places, times two."""
Group = tuple[IntArray, IntArray, FloatArray]

_NOTHING = -1e300
_TIE = 1e-12
"""Schedules whose J differ by less than this share of the prior are equal: the cheaper is taken."""


@dataclass(frozen=True)
class Options:
    """All that one robot could do: schedules that no other one beats by one sample more.

    Attributes
    ----------
    codes : array, shape (M, P), less K
    energy_j : array, shape (M,)
        Least energy over the orders of the stops.
    groups : list of (rows, candidates, precision)
        Schedules by number k of places sampled: their rows, shape (m,), positions in V and the precision
        gained there, shape (m, k).
    """

    robot: Robot
    codes: Codes
    energy_j: FloatArray
    groups: list[Group]


def options_of(problem: Problem) -> Options | None:
    """Return all that the only robot of a problem could do, bringing home all it has and all that lies.

    None where that cannot be listed: more than `MOST_PLACES` places, or too many schedules. What has been
    gained already and J do not matter.
    """
    (robot,) = robots_of(problem)
    if len(robot.places) > MOST_PLACES:
        return None
    nothing = np.zeros((len(robot.places), robot.width))
    count, labels, *rest, _ = enumerate_labels(robot.actor, nothing, _NOTHING, _ROOM)
    if count < 0:
        return None
    label, energy_j = complete_schedules(robot.actor, count, labels, *rest)
    codes = labels[label]
    lying = [sum(stock.count for stock in problem.stocks if stock.node == v) for v in robot.places]
    whole = (robot.exchange_of[codes + robot.capacity] == lying).all(axis=1)
    codes, energy_j = codes[whole], energy_j[whole]
    kept = without_dominated(codes, robot.capacity, robot.actor.limits, robot.actor.most_pick)
    codes, energy_j = codes[kept], energy_j[kept]
    return Options(robot, codes, energy_j, _grouped(robot, codes, problem.candidates))


def _grouped(robot: Robot, codes: Codes, candidates: tuple[int, ...]) -> list[Group]:
    taken = robot.taken_of[codes + robot.capacity]
    position = {v: i for i, v in enumerate(candidates)}
    where = np.array([position.get(v, -1) for v in robot.places], dtype=np.int64)
    counts = (taken > 0).sum(axis=1)
    groups: list[Group] = []
    for k in np.unique(counts[counts > 0]):
        rows: IntArray = np.flatnonzero(counts == k)
        own = np.nonzero(taken[rows])[1].reshape(-1, k)
        precision = (robot.precision * np.take_along_axis(taken[rows], own, axis=1)).astype(np.float64)
        groups.append((rows, where[own], precision))
    return groups


def plan_alone(problem: Problem, options: Options) -> TeamPlan | None:
    """Return the plan of least J and, for that J, of least energy; None where the robot has no way at all.

    ``options`` may have been listed with other precisions gained. J falls by
    tr[(C_SS + D^-1)^-1 C_ST W C_TS] with S the candidates sampled and D the precisions: the posterior of
    eq:generic_llse2, updated at S only. Both matrices are those given what has been gained already.
    """
    if not len(options.codes):
        return None
    c_vv, c_tv = problem.information.posterior(problem.gained)
    worth = c_tv.T @ (problem.information.weights[:, None] * c_tv)  # C_VT W C_TV
    fall = np.zeros(len(options.codes))
    for rows, s, precision in options.groups:
        noise = np.eye(s.shape[1]) / precision[:, :, None]
        pairs = s[:, :, None], s[:, None, :]
        fall[rows] = np.trace(np.linalg.solve(c_vv[pairs] + noise, worth[pairs]), axis1=1, axis2=2)
    equal = np.flatnonzero(fall >= fall.max() - _TIE * problem.information.prior)
    best = equal[np.argmin(options.energy_j[equal])]
    return realise(problem, [options.robot], [options.codes[best]])
