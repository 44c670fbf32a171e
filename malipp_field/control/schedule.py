"""When and with how much energy each stop was to be reached, and how far a vehicle is off it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from malipp_field.control.lookahead import Roads, Whereabouts
from malipp_field.mission import Mission
from malipp_field.plan import Plan
from malipp_field.vehicle.steps import Action, VehicleMission


@dataclass(frozen=True)
class Expected:
    """The plan's word on one arrival: mission time (s) and energy used since the start (J)."""

    arrive_s: float
    energy_used_j: float


@dataclass(frozen=True)
class Deviation:
    """How far a vehicle is off its plan at the next stop it will reach."""

    robot: str
    node: str
    late_s: float
    overdraw_j: float


def expectations(
    plan: Plan, missions: Mapping[str, VehicleMission], energy_left_j: Mapping[str, float], mission: Mission
) -> dict[str, Expected]:
    """Return what the plan expects at the end of every leg, by the uid of the drive that ends it.

    Parameters
    ----------
    missions
        The steps compiled from ``plan``, without any committed steps before them.
    energy_left_j
        What each robot had left where the plan begins.
    """
    expected: dict[str, Expected] = {}
    for robot in plan.robots:
        used_j = mission.robot(robot.id).energy_budget_j - energy_left_j[robot.id]
        last_drive = {step.stop: step.uid for step in missions[robot.id].steps if step.action is Action.DRIVE}
        for index, stop in enumerate(robot.route):
            used_j += stop.leg_energy_j or 0.0
            if stop.arrive_s is not None and index in last_drive:
                expected[last_drive[index]] = Expected(stop.arrive_s, used_j)
    return expected


def deviation(
    robot_id: str,
    now_s: float,
    now: Whereabouts,
    load: int,
    expected: Mapping[str, Expected],
    roads: Roads,
) -> Deviation | None:
    """Return how far a vehicle is off its plan, or `None` while it is not driving to a planned stop.

    The rest of the leg is predicted at the pace and drain measured on it so far, so a vehicle that crawls
    through sand is late before it arrives.
    """
    at: tuple[float, float] | None = (now.x_m, now.y_m)
    node, time_s, energy_j = now.last_node, now_s, now.energy_used_j
    for step in now.mission.steps[now.current :]:
        if step.action is not Action.DRIVE:
            return None
        leg_s, leg_j = roads.drive(robot_id, node, step.node, load, at)
        time_s += leg_s * (now.time_ratio if at else 1.0)
        energy_j += leg_j * (now.energy_ratio if at else 1.0)
        node, at = step.node, None
        if step.uid in expected:
            plan = expected[step.uid]
            return Deviation(robot_id, node, time_s - plan.arrive_s, energy_j - plan.energy_used_j)
    return None
