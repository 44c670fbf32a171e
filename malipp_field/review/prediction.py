"""What the plans in force said a robot would use, as a curve over mission time."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from malipp_field.bus.messages import PlanAdopted, Telemetry
from malipp_field.field import FloatArray
from malipp_field.plan import RobotPlan
from malipp_field.record import Run


def energy_used(run: Run, robot: str) -> tuple[FloatArray, FloatArray]:
    """Return mission times (s) and the energy used (J) since mission time 0, one of each per telemetry.

    Vehicles count from when they were switched on: what was used before mission time 0 is taken off.
    """
    reports = run.telemetry[robot]
    times = np.array([report.time_s - run.start_s for report in reports])
    used = np.array([report.energy_used_j for report in reports])
    return times, used - _before_start(reports, run.start_s)


def _before_start(reports: tuple[Telemetry, ...], start_s: float) -> float:
    earlier = [report.energy_used_j for report in reports if report.time_s <= start_s]
    return earlier[-1] if earlier else reports[0].energy_used_j if reports else 0.0


def predicted_energy(run: Run, robot: str) -> list[tuple[FloatArray, FloatArray]]:
    """Return for every plan version the energy (J) it predicts over mission time (s), as a polyline.

    Version 1 begins at nothing. A later one plans the rest of the mission: it begins with what was measured
    when it came into force, to which come what its predecessor still predicts for the part that was
    committed, and then its own legs.
    """
    curves: list[tuple[FloatArray, FloatArray]] = []
    times, used = energy_used(run, robot)
    for adopted in run.plans:
        route = adopted.plan.robot(robot)
        curve = _legs(route)
        if curves and times.size:
            now_s = adopted.time_s - run.start_s
            measured = float(np.interp(now_s, times, used))
            curve = _continued(now_s, measured, curves[-1], curve)
        curves.append(curve)
    return curves


def _legs(route: RobotPlan) -> tuple[FloatArray, FloatArray]:
    """Return the energy of a route alone, growing along each leg and level during service."""
    times, energies = [route.route[0].depart_s], [0.0]
    for before, stop in pairwise(route.route):
        arrive_s = before.depart_s if stop.arrive_s is None else stop.arrive_s
        reached = energies[-1] + (stop.leg_energy_j or 0.0)
        times += [arrive_s, stop.depart_s]
        energies += [reached, reached]
    return np.array(times), np.array(energies)


def _continued(
    now_s: float, measured: float, old: tuple[FloatArray, FloatArray], new: tuple[FloatArray, FloatArray]
) -> tuple[FloatArray, FloatArray]:
    """Return a new plan's curve from ``now_s`` on, with its predecessor's for what was committed."""
    free_s = max(now_s, float(new[0][0]))
    committed = np.interp(free_s, *old) - np.interp(now_s, *old)
    later = new[0] > now_s
    times = np.concatenate([[now_s], new[0][later]])
    start = measured + committed - np.interp(now_s, *new)
    return times, np.concatenate([[measured], start + new[1][later]])


def adoption_time(run: Run, adopted: PlanAdopted) -> float:
    """Return when a plan came into force, in mission time (s); the first one is in force from 0."""
    return max(0.0, adopted.time_s - run.start_s)
