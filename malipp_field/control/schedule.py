"""When and with how much energy each stop was to be reached, and how far a vehicle is off it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from malipp_field.control.experience import Experience
from malipp_field.control.ledger import CustodyLedger
from malipp_field.control.lookahead import Roads, Whereabouts
from malipp_field.control.tracks import Track
from malipp_field.mission import Mission, TeamState, initial_state
from malipp_field.plan import Plan
from malipp_field.vehicle.steps import Action, Step, VehicleMission


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


class Schedule:
    """What the plan in force expects of every vehicle, and who is off it by how much.

    Parameters
    ----------
    tracks, ledger, experience
        What is known of the vehicles, what is on board, and what edges were found to take.
    plan, missions
        The first plan, and what was compiled from it.
    """

    def __init__(
        self,
        mission: Mission,
        tracks: Mapping[str, Track],
        ledger: CustodyLedger,
        experience: Experience,
        plan: Plan,
        missions: Mapping[str, VehicleMission],
    ) -> None:
        self._mission, self._tracks, self._ledger = mission, tracks, ledger
        self._experience, self._roads = experience, Roads(mission)
        self._expected = self._of(plan, missions, initial_state(mission))

    def _of(
        self, plan: Plan, missions: Mapping[str, VehicleMission], state: TeamState
    ) -> dict[str, Expected]:
        left_j = {robot.id: robot.energy_left_j for robot in state.robots}
        return expectations(plan, missions, left_j, self._mission)

    def renew(
        self,
        plan: Plan,
        compiled: Mapping[str, VehicleMission],
        state: TeamState,
        kept: Mapping[str, Sequence[Step]],
    ) -> None:
        """Expect what another plan says.

        Parameters
        ----------
        compiled, state
            The steps compiled from ``plan`` alone, and where it begins.
        kept
            Of vehicles that go on with the mission they have: those of its steps that stand for the new
            ones, by robot.
        """
        expected = self._of(plan, compiled, state)
        for robot, steps in kept.items():
            for old, new in zip(steps, compiled[robot].steps, strict=True):
                if new.uid in expected:
                    expected[old.uid] = expected.pop(new.uid)
        self._expected = expected

    def whereabouts(self, robot: str) -> Whereabouts:
        """Return where a vehicle is; its present leg is judged by what is known of the edge, too."""
        track = self._tracks[robot]
        step = track.step
        known = self._experience.of(track.last_node, step.node) if step is not None else (1.0, 1.0)
        return track.whereabouts(self._roads, len(self._ledger.on_board(robot)), known)

    def intolerable(self, mission_time_s: float) -> str | None:
        """Return who is off the plan by more than the mission's replanning policy allows, in words."""
        policy = self._mission.replanning
        for robot, track in self._tracks.items():
            if track.telemetry is None or track.finished:
                continue
            now, load = self.whereabouts(robot), len(self._ledger.on_board(robot))
            found = deviation(robot, mission_time_s, now, load, self._expected, self._roads)
            if found is None:
                continue
            budget_j = self._mission.robot(robot).energy_budget_j
            if found.overdraw_j > policy.energy_overdraw * budget_j:
                share = 100.0 * found.overdraw_j / budget_j
                return f"{robot} will have used {share:.0f} % of its budget more than planned at {found.node}"
            if found.late_s > policy.slip_s:
                return f"{robot} will be {found.late_s:.0f} s late at {found.node}"
        return None
