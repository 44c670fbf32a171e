"""In which order the LNS tries pairs of robots (paper, Section "Heuristic", Pairwise improvement)."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import combinations

from malipp_field.planner.extract import Route, TeamPlan, leg_energies
from malipp_field.planner.problem import Problem

Pair = tuple[int, ...]
"""Indices of two robots, ascending; a team of one has one "pair" of one."""

SLACK_WEIGHT = 1.0
SHARED_WEIGHT = 1.0
"""Both criteria run from 0 to 1 and the paper prefers neither."""
FAILURE_WEIGHT = 1.0
"""A pair that failed once goes behind all that it led by a whole criterion, after two failures behind all."""


def pairs_of(problem: Problem) -> list[Pair]:
    """Return all pairs of the team."""
    team = range(len(problem.robots))
    return list(combinations(team, min(2, len(team))))


def ranked(problem: Problem, best: TeamPlan, failures: Mapping[Pair, int]) -> list[Pair]:
    """Return all pairs, the most promising first; equals in the order of their robots.

    Parameters
    ----------
    failures
        Attempts at a pair since it was last improved.
    """
    slack = [energy_slack(problem, r, route) for r, route in enumerate(best.routes)]
    shared = {pair: shared_nodes(problem, pair) for pair in pairs_of(problem)}
    most = max(1, *shared.values())

    def promise(pair: Pair) -> float:
        asymmetry = abs(slack[pair[0]] - slack[pair[-1]])
        wanted = SLACK_WEIGHT * asymmetry + SHARED_WEIGHT * shared[pair] / most
        return wanted - FAILURE_WEIGHT * failures.get(pair, 0)

    return sorted(shared, key=lambda pair: (-promise(pair), pair))


def energy_slack(problem: Problem, r: int, route: Route) -> float:
    """Return the share of its budget that a robot does not spend."""
    robot = problem.robots[r]
    if robot.budget_j <= 0.0:
        return 0.0
    return max(0.0, 1.0 - sum(leg_energies(problem, robot, route)) / robot.budget_j)


def shared_nodes(problem: Problem, pair: Pair) -> int:
    """Return how many nodes all robots of a pair can reach and come home from."""
    return len(set.intersection(*(set(problem.robots[r].places) for r in pair)))
