"""What telemetry says of each vehicle, joined with the mission it carries out."""

from __future__ import annotations

import math

from malipp_field.bus import Telemetry
from malipp_field.control.lookahead import Roads, Whereabouts
from malipp_field.mission import ABSTRACT_ORIGIN, Mission, to_local
from malipp_field.plan import RobotPlan
from malipp_field.vehicle.steps import Action, Step, VehicleMission

# Ratios of measured to predicted are trusted from this distance on, and within these limits: terrain slows
# and drains, but a first metre or a position error must not send the prediction astray.
_TRUSTED_M = 2.0
_RATIO_LIMITS = (1.0, 5.0)


class Track:
    """One vehicle as the coordinator sees it."""

    def __init__(self, mission: Mission, route: RobotPlan, vehicle_mission: VehicleMission) -> None:
        self.robot_id = route.id
        self.mission = vehicle_mission
        self.route = route
        """The route of the plan that the mission was compiled from."""
        self.committed = 0
        """How many steps of the mission come before those of that route."""
        self.telemetry: Telemetry | None = None
        self.leg_done: tuple[str, str, float, float] | None = None
        """The edge driven last (tail, head), with measured over predicted time and energy."""
        self.changed_s = 0.0
        """Clock time at which the current step last changed."""
        self.progress_s = 0.0
        """Clock time at which the vehicle last began a step or got a little further."""
        self._mark = (math.inf, math.inf)
        self._origin = mission.site.origin or ABSTRACT_ORIGIN
        self._last_node = mission.robot(route.id).start
        self._leg_start: tuple[float, float, float, float] | None = None  # time, energy, x, y

    @property
    def current(self) -> int:
        """Index of the step being carried out; the number of steps when all are done."""
        if self.telemetry is None or self.telemetry.step_uid is None:
            return 0 if self.telemetry is None or not self.telemetry.finished else len(self.mission.steps)
        index = self.mission.index_of(self.telemetry.step_uid)
        return 0 if index is None else index

    @property
    def step(self) -> Step | None:
        """The step being carried out, if any is left."""
        return self.mission.steps[self.current] if self.current < len(self.mission.steps) else None

    @property
    def finished(self) -> bool:
        """Whether nothing is left to do."""
        return not self.mission.steps or (self.telemetry is not None and self.telemetry.finished)

    @property
    def last_node(self) -> str:
        """The node at which the vehicle was last."""
        done = self.mission.steps[: self.current]
        return done[-1].node if done else self._last_node

    @property
    def position(self) -> tuple[float, float]:
        """East and north in metres."""
        assert self.telemetry is not None, "a vehicle is followed only once it has reported"
        return to_local(self.telemetry.lat_deg, self.telemetry.lon_deg, self._origin)

    def update(self, telemetry: Telemetry, roads: Roads, load: int) -> None:
        """Take in a report. One about another mission than the one in force says nothing of progress.

        ``load`` is what the vehicle has had on board since it began the step it was at.
        """
        if (
            telemetry.step_uid is not None
            and telemetry.mission_version == self.mission.version
            and self.mission.index_of(telemetry.step_uid) is None
        ):
            return
        before = None if self.telemetry is None else self.telemetry.step_uid
        if telemetry.step_uid != before and self.step is not None and self.step.action is Action.DRIVE:
            self.leg_done = (self.last_node, self.step.node, *self._ratios(roads, load))
        self.telemetry = telemetry
        if telemetry.step_uid != before:
            self.changed_s = telemetry.time_s
            self._leg_start = (telemetry.time_s, telemetry.energy_used_j, *self.position)
        if telemetry.step_uid != before or math.dist(self._mark, self.position) > _TRUSTED_M:
            self._mark, self.progress_s = self.position, telemetry.time_s

    def adopt(self, route: RobotPlan, vehicle_mission: VehicleMission, committed: int) -> None:
        """Follow another mission from now on."""
        self._last_node = self.last_node
        self.mission, self.route, self.committed = vehicle_mission, route, committed

    def whereabouts(self, roads: Roads, load: int) -> Whereabouts:
        """Return where the vehicle is and how its present leg compares with the prediction."""
        assert self.telemetry is not None, "a vehicle is followed only once it has reported"
        x_m, y_m = self.position
        time_ratio, energy_ratio = self._ratios(roads, load)
        return Whereabouts(
            self.mission, self.current, self.last_node, x_m, y_m, self.telemetry.energy_used_j,
            time_ratio, energy_ratio,
        )  # fmt: skip

    def _ratios(self, roads: Roads, load: int) -> tuple[float, float]:
        """Return measured over predicted time and energy on the leg driven so far."""
        step, telemetry = self.step, self.telemetry
        if step is None or step.action is not Action.DRIVE or self._leg_start is None or telemetry is None:
            return 1.0, 1.0
        start_s, start_j, *start = self._leg_start
        here = self.position
        if math.dist(start, here) < _TRUSTED_M:
            return 1.0, 1.0
        whole_s, whole_j = roads.drive(self.robot_id, self.last_node, step.node, load, (start[0], start[1]))
        left_s, left_j = roads.drive(self.robot_id, self.last_node, step.node, load, here)
        return (
            _ratio(telemetry.time_s - start_s, whole_s - left_s),
            _ratio(telemetry.energy_used_j - start_j, whole_j - left_j),
        )


def _ratio(measured: float, predicted: float) -> float:
    low, high = _RATIO_LIMITS
    return low if predicted <= 0.0 else min(high, max(low, measured / predicted))
