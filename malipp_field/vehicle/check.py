"""The check before an upload: what would go wrong on this vehicle with this firmware.

Pure: nothing is read, nothing is sent. The rules are in `check_items` (the firmware), `check_fence` (what of
the fence is stored), `check_way` (fence and keep-outs), `check_energy`, `check_times` and `check_team`.
"""

from __future__ import annotations

from collections.abc import Sequence

from malipp_field.mission import Mission, Passage, TeamState, drives_alike, passages
from malipp_field.mission.vehicles import VehicleSettings
from malipp_field.plan import Plan, RobotPlan
from malipp_field.vehicle.check_energy import Roads, energy_findings, length_findings
from malipp_field.vehicle.check_fence import fence_findings
from malipp_field.vehicle.check_items import item_findings, time_of_day
from malipp_field.vehicle.check_team import team_findings
from malipp_field.vehicle.check_times import gate_findings, hold_findings, service_findings
from malipp_field.vehicle.check_way import way_findings
from malipp_field.vehicle.compile import Custody, compile_plan
from malipp_field.vehicle.finding import Finding, Spot
from malipp_field.vehicle.gate_times import gate_times
from malipp_field.vehicle.items import MAV_CMD_NAV_LOITER_UNLIM, MissionItem
from malipp_field.vehicle.layout import Layout, lay_out
from malipp_field.vehicle.steps import Action, VehicleMission

__all__ = ["Finding", "check", "check_items", "way_findings"]


def check(
    mission: Mission,
    plan: Plan,
    start_s: float | None = None,
    custody: Custody | None = None,
    state: TeamState | None = None,
) -> list[Finding]:
    """Return what is wrong, doubtful or to be known before the missions of a plan are sent.

    Parameters
    ----------
    mission, plan
        A verified plan and the mission it is for.
    start_s
        When mission time 0 is, in seconds since the Unix epoch; without it no gate opens by time.
    custody
        Containers on board and in caches when the plan begins, as for `compile_plan`.
    state
        Where the team stands when the plan begins; the beginning of the mission where not given.

    Returns
    -------
    list of Finding
        Those about the team first, then robot by robot in the order of the plan.

    Raises
    ------
    PlanError
        When the plan cannot be compiled.
    """
    compiled = compile_plan(mission, plan, custody, start_s)
    times = {} if start_s is None else gate_times(mission, plan)
    found = [*team_findings(mission), *fence_findings(mission)]
    for group in drives_alike(mission):
        drivable = passages(mission, group[0])
        for route in plan.robots:
            if route.id in group:
                vehicle = compiled.missions[route.id]
                found += _vehicle(mission, route, vehicle, drivable, state)
                found += gate_findings(mission, vehicle, lay_out(vehicle), start_s, times)
    order = {route.id: index for index, route in enumerate(plan.robots)}
    return sorted(found, key=lambda finding: -1 if finding.robot is None else order.get(finding.robot, -1))


def check_items(
    items: Sequence[MissionItem], settings: VehicleSettings, robot: str | None = None
) -> list[Finding]:
    """Return what this firmware and this vehicle would make of a mission from anywhere.

    Parameters
    ----------
    items
        A whole mission, home first: downloaded, or read from a file that somebody has edited.
    settings
        The vehicle's.
    robot
        Whose mission it is, for the findings.
    """
    found = item_findings(items, settings, robot)
    for index, item in enumerate(items):
        spot = Spot(robot, index)
        until = time_of_day(item)
        if until is not None:
            found.append(
                spot.warning(
                    "gate-late",
                    f"waits until {until} UTC; coming later, the vehicle waits until the next day",
                    "see that it cannot come late, or wait for a number of seconds",
                )
            )
        if item.command == MAV_CMD_NAV_LOITER_UNLIM:
            found.append(
                spot.note(
                    "holds",
                    "holds here until the ground makes the next item current",
                    "have somebody there to do that",
                )
            )
    return found


def _vehicle(
    mission: Mission,
    route: RobotPlan,
    vehicle: VehicleMission,
    drivable: Sequence[Passage],
    state: TeamState | None,
) -> list[Finding]:
    robot, settings = mission.robot(route.id), mission.vehicle(route.id)
    layout = lay_out(vehicle)
    where = _words(vehicle, layout)
    roads = Roads(mission, robot, drivable)
    begin_j = robot.energy_budget_j if state is None else state.robot(route.id).energy_left_j
    return [
        *item_findings(layout.items, settings, route.id, where),
        *way_findings(mission, route.id, layout.items, where, begin=route.route[0].node),
        *energy_findings(route, roads, begin_j, _reserve(mission, begun=state is not None)),
        *length_findings(route, roads),
        *service_findings(mission, vehicle),
        *hold_findings(vehicle, gates_open_by_time=settings.gate == "time"),
    ]


def _reserve(mission: Mission, *, begun: bool) -> float:
    """Return the share of a robot's energy that should be left: the planner's, or that of replans."""
    replanning = mission.replanning.energy_reserve
    return replanning if begun else mission.planner.energy_reserve or replanning


def _words(vehicle: VehicleMission, layout: Layout) -> dict[int, str]:
    """Return what each item is for, by sequence number."""
    found = {0: "home"}
    for item, index in enumerate(layout.steps):
        if index >= 0:
            step = vehicle.steps[index]
            tags = "".join(f" {tag}" for tag in step.tags)
            found[item] = step.node if step.action is Action.DRIVE else f"{step.node}: {step.action}{tags}"
    return found
