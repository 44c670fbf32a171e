"""The independent verifier: every constraint of the paper and of the plan format, recomputed.

It shares no code with the solvers. Legs are measured along the mission's edges, J is evaluated in the
estimator form over the nodes sampled, custody and times are followed stop by stop. What is the caller's
choice and not a constraint (`planner.energy_reserve`, the method, its gap) is not judged.

The makespan T^end is the final departure of the last robot (eq:makespan: the service window at the terminal
belongs to the mission); a robot with a single stop counts with the departure of that stop.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterator

import numpy as np

from malipp_field.errors import PlanError
from malipp_field.field.kernel import covariance
from malipp_field.mission import Mission, TeamState, initial_state, locate, node_positions
from malipp_field.plan import Objective, Plan
from malipp_field.planner.verifier.case import TOLERANCE, Case, Violation, above, differs
from malipp_field.planner.verifier.custody import handoff_rules, visit_rules
from malipp_field.planner.verifier.routes import Leg, legs_of, roads_of, route_energy_j, route_rules

__all__ = ["Violation", "check", "verify"]

_GAP_TOLERANCE = 1e-4
"""Files state gaps rounded, and solvers divide by either end: a gap is right to within this."""


def verify(mission: Mission, plan: Plan, state: TeamState | None = None) -> list[Violation]:
    """Return every rule that ``plan`` breaks for ``mission`` from ``state`` on; none for a plan that holds.

    Parameters
    ----------
    mission, plan
        As read from their files, or as built.
    state
        Where the team stands; the beginning of the mission where it is None.
    """
    case = Case(mission, plan, state or initial_state(mission))
    found = [*_status(case), *_entries(case)]
    roads = roads_of(case) if case.routes else {}
    legs = [legs_of(roads[route[0].robot.id], route) for route in case.routes]
    for route, its_legs in zip(case.routes, legs, strict=True):
        found += route_rules(case, route, its_legs)
        found += [fault for visit in route for fault in visit_rules(case, visit)]
    found += handoff_rules(case)
    if plan.objective is not None:
        found += [*_objective(case, plan.objective, legs), *_bound(plan, plan.objective)]
    return found


def check(mission: Mission, plan: Plan, state: TeamState | None = None) -> None:
    """Let a plan pass that keeps every rule.

    Raises
    ------
    PlanError
        Naming the first rule broken, and how many more are.
    """
    found = verify(mission, plan, state)
    if found:
        more = f" (and {len(found) - 1} more)" if len(found) > 1 else ""
        raise PlanError(f"the plan breaks {found[0]}{more}")


def _status(case: Case) -> Iterator[Violation]:
    """Yield what does not fit the status: routes, objective, bound or reason too much or missing."""
    plan = case.plan
    if plan.mission != case.mission.name:
        yield Violation(
            "format:mission", None, None, f"the plan is for {plan.mission}, not {case.mission.name}"
        )
    if plan.status in {"optimal", "feasible"}:
        if plan.objective is None or plan.reason is not None:
            yield _about("format:status", f"a plan that is {plan.status} has an objective, and no reason")
        if plan.status == "optimal" and (plan.bound.information is None or plan.gap is None):
            yield _about("format:status", "a plan that is optimal proves it with a bound and a gap")
        return
    if plan.robots or plan.objective is not None or plan.gap is not None:
        yield _about("format:status", f"status {plan.status} has no routes, objective or gap")
    if plan.status == "infeasible" and not plan.reason:
        yield _about("format:reason", "an infeasible mission needs a reason in words")


def _entries(case: Case) -> Iterator[Violation]:
    if case.plan.status not in {"optimal", "feasible"}:
        return
    entries = Counter(entry.id for entry in case.plan.robots)
    for robot in sorted(set(entries) - set(case.team)):
        yield Violation("format:robots", robot, None, "the mission has no such robot")
    for robot in case.team:
        if entries[robot] != 1:
            yield Violation("format:robots", robot, None, f"has {entries[robot]} entries, one is needed")


def _objective(case: Case, stated: Objective, legs: list[list[Leg | None]]) -> Iterator[Violation]:
    information = _information(case)
    # J is a sum of prior variances less what is known: its rounding is in proportion to the prior
    prior = case.mission.field.kernel.variance * sum(t.weight for t in case.mission.field.test_points)
    if abs(stated.information - information) > TOLERANCE * prior:
        yield _about("eq:llse_objective", f"information is {stated.information:.9g}, J is {information:.9g}")
    energies = [route_energy_j(case, its_legs) for its_legs in legs]
    known = [energy_j for energy_j in energies if energy_j is not None]
    if len(known) == len(energies) and differs(stated.energy_j, sum(known)):
        yield _about("eq:total_energy", f"energy_j is {stated.energy_j:.9g}, the legs take {sum(known):.9g}")
    makespan_s = max((route[-1].stop.depart_s for route in case.routes), default=0.0)
    if differs(stated.makespan_s, makespan_s):
        yield _about(
            "eq:makespan", f"makespan_s is {stated.makespan_s:.9g}, the last ends at {makespan_s:.9g}"
        )


def _bound(plan: Plan, stated: Objective) -> Iterator[Violation]:
    bound = plan.bound.information
    if (bound is None) != (plan.gap is None):
        yield _about("format:gap", "bound and gap are given together or not at all")
    if bound is None:
        return
    if above(bound, stated.information):
        yield _about(
            "format:bound", f"the bound {bound:.9g} is above the information {stated.information:.9g}"
        )
        return
    gap = (stated.information - bound) / stated.information if stated.information > 0 else 0.0
    if plan.gap is not None and abs(plan.gap - gap) > _GAP_TOLERANCE * max(1.0, gap):
        yield _about("format:gap", f"gap is {plan.gap:.6g}; (information - bound) / information is {gap:.6g}")


def _information(case: Case) -> float:
    """Return J of the samples taken so far and planned, in the estimator form (eq:generic_llse).

    A = K_TV (K_VV + N)^-1 over the nodes sampled, N = diag(1 / p), and J is the error of that estimator.
    """
    precision = _precision(case)
    mission, kernel = case.mission, case.mission.field.kernel
    places = node_positions(mission)
    v = np.array([places[node] for node in precision]).reshape(-1, 2)
    t = np.array([locate(point, mission.site.origin) for point in mission.field.test_points])
    weights = np.array([point.weight for point in mission.field.test_points])
    noisy = covariance(kernel, v, v) + np.diag([1.0 / p for p in precision.values()])
    cross = covariance(kernel, t, v)
    A = np.linalg.solve(noisy, cross.T).T
    errors = np.sum((A @ noisy) * A, axis=1) - 2.0 * np.sum(cross * A, axis=1) + kernel.variance
    return float(weights @ errors)


def _precision(case: Case) -> dict[str, float]:
    """Return p_v of every node that is sampled (eq:precision)."""
    precision: dict[str, float] = defaultdict(float)
    for robot in case.state.robots:
        for node, count in robot.collected.items():
            precision[node] += count / case.team[robot.id].noise_variance
    for visit in case.visits():
        if visit.stop.collect and case.roles.get(visit.stop.node) == "candidate":
            precision[visit.stop.node] += visit.stop.collect / visit.robot.noise_variance
    return precision


def _about(rule: str, text: str) -> Violation:
    return Violation(rule, None, None, text)
