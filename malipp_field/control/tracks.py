"""What telemetry and confirmations say of each vehicle, joined with the mission it carries out.

The two come each in its own time: the vehicle may say that it has gone on before its confirmation of the last
action gets through, or the other way round. So neither is taken for the other. A payload step is done when it
is confirmed; a drive or a wait when the vehicle says it is past it, or when its gate was opened.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from malipp_field.bus import Telemetry
from malipp_field.control.lookahead import Roads, Whereabouts
from malipp_field.mission import ABSTRACT_ORIGIN, Mission, to_local
from malipp_field.plan import RobotPlan
from malipp_field.vehicle.steps import Action, Step, VehicleMission

# Ratios of measured to predicted are trusted from this distance on, and within these limits: terrain slows
# and drains, but a first metre or a position error must not send the prediction astray.
_TRUSTED_M = 5.0
_RATIO_LIMITS = (1.0, 5.0)
_PROGRESS_M = 2.0
_PASSED_BY = (Action.DRIVE, Action.WAIT)


@dataclass(frozen=True)
class Measured:
    """An edge as it was driven: time and energy over those of the mission file."""

    tail: str
    head: str
    time_ratio: float
    energy_ratio: float


@dataclass
class _Leg:
    """The drive under way, as far as it has been driven. Standing in HOLD is no driving."""

    step: Step
    tail: str
    begin: tuple[float, float]
    here: tuple[float, float]
    time_s: float = 0.0
    energy_j: float = 0.0


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
        self.changed_s = 0.0
        """Clock time at which the vehicle last reported another step."""
        self.progress_s = 0.0
        """Clock time at which the vehicle last began a step or got a little further."""
        self.lost_s: float | None = None
        """Clock time since when its agent has known of no mission; null while it knows one."""
        self.known: Telemetry | None = None
        """The last report with a mission."""
        self._driven: int | None = None  # version of the last mission that it was seen to drive
        self._confirmed: set[str] = set()
        self._reached = 0  # index of the step that telemetry has told of
        self._mark = (math.inf, math.inf)
        self._origin = mission.site.origin or ABSTRACT_ORIGIN
        self._last_node = mission.robot(route.id).start
        self._leg: _Leg | None = None

    @property
    def current(self) -> int:
        """Index of the first step that is not done; the number of steps when all are."""
        steps = self.mission.steps
        return next((i for i, step in enumerate(steps) if not self._is_done(i, step)), len(steps))

    def _is_done(self, index: int, step: Step) -> bool:
        return step.uid in self._confirmed or (step.action in _PASSED_BY and index < self._reached)

    @property
    def done(self) -> tuple[str, ...]:
        """Uids of all steps known to be done, those of earlier missions too."""
        passed = (step.uid for i, step in enumerate(self.mission.steps) if self._is_done(i, step))
        return tuple(sorted({*self._confirmed, *passed}))

    @property
    def begun(self) -> bool:
        """Whether the vehicle was seen to carry out its present mission."""
        return self._driven == self.mission.version

    @property
    def has_driven(self) -> bool:
        """Whether the vehicle was seen to carry out any mission."""
        return self._driven is not None

    @property
    def step(self) -> Step | None:
        """The step being carried out, if any is left."""
        current = self.current
        return self.mission.steps[current] if current < len(self.mission.steps) else None

    @property
    def finished(self) -> bool:
        """Whether nothing is left to do."""
        return self.current == len(self.mission.steps)

    @property
    def last_node(self) -> str:
        """The node at which the vehicle was last."""
        return self._node_before(self.current)

    def _node_before(self, index: int) -> str:
        return self.mission.steps[index - 1].node if index else self._last_node

    @property
    def position(self) -> tuple[float, float]:
        """East and north in metres."""
        assert self.telemetry is not None, "a vehicle is followed only once it has reported"
        return to_local(self.telemetry.lat_deg, self.telemetry.lon_deg, self._origin)

    def confirm(self, uid: str) -> None:
        """Note that a payload step was confirmed, or a gate passed."""
        self._confirmed.add(uid)

    def set_off(self) -> None:
        """Note that the vehicle was started on its mission."""
        self._driven = self.mission.version

    def reports(self, step: Step) -> bool:
        """Tell whether the vehicle itself says that it is at a step."""
        return self.telemetry is not None and self.telemetry.step_uid == step.uid

    def update(self, telemetry: Telemetry, roads: Roads, load: int) -> Measured | None:
        """Take in a report; return how the leg went that ends with it.

        Parameters
        ----------
        roads
            As the mission file has them.
        load
            What the vehicle has had on board since it began the step it was at.
        """
        before, self.telemetry = self.telemetry, telemetry
        self._note_mission(telemetry)
        self._reached = self._reached_by(telemetry)
        begun = before is None or telemetry.step_uid != before.step_uid
        if begun or math.dist(self._mark, self.position) > _PROGRESS_M:
            self._mark, self.progress_s = self.position, telemetry.time_s
        if before is not None and not begun:
            self._follow_leg(before, telemetry)
            return None
        self.changed_s = telemetry.time_s
        done = self._measured(roads, load)
        self._leg = self._leg_begun()
        return done

    def _note_mission(self, telemetry: Telemetry) -> None:
        """Note whether the agent knows of a mission, and which one the vehicle drives."""
        if telemetry.mission_version is None:
            self.lost_s = telemetry.time_s if self.lost_s is None else self.lost_s
            return
        self.lost_s, self.known = None, telemetry
        if telemetry.armed and telemetry.mode == "AUTO" and telemetry.step_uid is not None:
            self._driven = telemetry.mission_version

    def _reached_by(self, telemetry: Telemetry) -> int:
        """Return the index of the step a report tells of; about another mission it may say nothing of that.

        No step at all may also mean that the last is not confirmed, or that a new mission is not begun.
        """
        if telemetry.step_uid is None:
            over = telemetry.finished and telemetry.mission_version == self.mission.version
            return len(self.mission.steps) if over else self._reached
        index = self.mission.index_of(telemetry.step_uid)
        return self._reached if index is None else index

    def _follow_leg(self, before: Telemetry, now: Telemetry) -> None:
        if self._leg is None:
            return
        self._leg.here = self.position
        if before.armed and before.mode == "AUTO":
            self._leg.time_s += now.time_s - before.time_s
            self._leg.energy_j += max(0.0, now.energy_used_j - before.energy_used_j)

    def _leg_begun(self) -> _Leg | None:
        steps = self.mission.steps
        step = steps[self._reached] if self._reached < len(steps) else None
        uid = None if self.telemetry is None else self.telemetry.step_uid
        if step is None or step.uid != uid or step.action is not Action.DRIVE:
            return None
        return _Leg(step, self._node_before(self._reached), self.position, self.position)

    def adopt(self, route: RobotPlan, vehicle_mission: VehicleMission, committed: int) -> None:
        """Follow another mission from now on."""
        uid = None if self.telemetry is None else self.telemetry.step_uid
        index = None if uid is None else vehicle_mission.index_of(uid)
        self._last_node, self._reached = self._node_before(self._reached), index or 0
        self.mission, self.route, self.committed = vehicle_mission, route, committed

    def measured(self, roads: Roads, load: int) -> Measured | None:
        """Return how the leg in progress has gone so far; `None` while that says nothing."""
        step = self.step
        return self._measured(roads, load) if self._leg is not None and self._leg.step == step else None

    def _measured(self, roads: Roads, load: int) -> Measured | None:
        leg = self._leg
        if leg is None or math.dist(leg.begin, leg.here) < _TRUSTED_M:
            return None
        whole_s, whole_j = roads.drive(self.robot_id, leg.tail, leg.step.node, load, leg.begin)
        left_s, left_j = roads.drive(self.robot_id, leg.tail, leg.step.node, load, leg.here)
        return Measured(
            leg.tail,
            leg.step.node,
            _ratio(leg.time_s, whole_s - left_s),
            _ratio(leg.energy_j, whole_j - left_j),
        )

    def whereabouts(self, roads: Roads, load: int, known: tuple[float, float] = (1.0, 1.0)) -> Whereabouts:
        """Return where the vehicle is and how its present leg compares with the mission file.

        ``known`` is how time and energy of the leg's edge compared before: the worse of the two counts.
        """
        assert self.telemetry is not None, "a vehicle is followed only once it has reported"
        x_m, y_m = self.position
        found = self.measured(roads, load)
        time_ratio, energy_ratio = known
        if found is not None:
            time_ratio = max(time_ratio, found.time_ratio)
            energy_ratio = max(energy_ratio, found.energy_ratio)
        return Whereabouts(
            self.mission, self.current, self.last_node, x_m, y_m, self.telemetry.energy_used_j,
            time_ratio, energy_ratio,
        )  # fmt: skip


def _ratio(measured: float, predicted: float) -> float:
    low, high = _RATIO_LIMITS
    return low if predicted <= 0.0 else min(high, max(low, measured / predicted))
