"""What the plans in force said a robot would use, as a curve over mission time."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np

from malipp_field.bus.messages import PlanAdopted, Telemetry
from malipp_field.field import FloatArray
from malipp_field.mission import node_positions
from malipp_field.plan import RobotPlan
from malipp_field.record import Run
from malipp_field.review.custody import loads
from malipp_field.review.tracks import local_track


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
    when it came into force, to which come the way to the node where its route begins (straight: that is the
    leg in progress), and then its own legs.
    """
    curves: list[tuple[FloatArray, FloatArray]] = []
    times, used = energy_used(run, robot)
    for adopted in run.plans:
        route = adopted.plan.robot(robot)
        curve = _legs(route)
        if curves and times.size:
            now_s = adopted.time_s - run.start_s
            measured = float(np.interp(now_s, times, used))
            curve = _continued(now_s, measured, _committed_j(run, robot, adopted), curve)
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
    now_s: float, measured_j: float, committed_j: float, legs: tuple[FloatArray, FloatArray]
) -> tuple[FloatArray, FloatArray]:
    """Return the curve of a plan for the rest of a mission from ``now_s`` on."""
    times, energies = legs
    later = times > now_s
    start_j = measured_j + committed_j - float(np.interp(now_s, times, energies))
    return (
        np.concatenate([[now_s], times[later]]),
        np.concatenate([[measured_j], start_j + energies[later]]),
    )


def _committed_j(run: Run, robot: str, adopted: PlanAdopted) -> float:
    """Return the energy from where a robot was to the node where its route under a new plan begins."""
    times, places = local_track(run, robot)
    now_s = adopted.time_s - run.start_s
    here = [float(np.interp(now_s, times, axis)) for axis in places.T]
    there = node_positions(run.mission)[adopted.plan.robot(robot).route[0].node]
    load = [0, *(count for time_s, count in loads(run, robot) if time_s <= adopted.time_s)][-1]
    who = run.mission.robot(robot)
    mass_kg = who.empty_mass_kg + load * run.mission.team.sample_mass_kg
    return who.energy_per_kg_m * mass_kg * math.dist(here, there)


def adoption_time(run: Run, adopted: PlanAdopted) -> float:
    """Return when a plan came into force, in mission time (s); the first one is in force from 0."""
    return max(0.0, adopted.time_s - run.start_s)
