"""The autopilot of one rover: modes, arming, battery, and carrying out the mission item by item."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from malipp_field.mission.vehicles import ByHand
from malipp_field.sim.activities import Activity, Do, InTurn, Pause
from malipp_field.sim.change_detector import ChangeDetector
from malipp_field.sim.items import NAVIGATION, WITH_POSITION
from malipp_field.sim.mission_run import MissionRun, RunState
from malipp_field.sim.mission_store import MAX_ITEMS, MissionStore
from malipp_field.sim.motion import Leg, Position
from malipp_field.sim.outputs import Outputs, hangs
from malipp_field.sim.params import Parameters
from malipp_field.sim.payload import PayloadScript, action_of, gate_delay_s, goes_on_without
from malipp_field.sim.world import Outcome, World
from malipp_field.vehicle.items import MissionItem, degrees_e7
from malipp_field.vehicle.steps import Action

MODES = {
    mavlink.ROVER_MODE_MANUAL, mavlink.ROVER_MODE_HOLD, mavlink.ROVER_MODE_LOITER,
    mavlink.ROVER_MODE_AUTO, mavlink.ROVER_MODE_GUIDED,
}  # fmt: skip
"""Modes that can be entered. Only AUTO drives: the others stand still, as nobody is at the sticks."""

_BUDGET_SLACK = 1e-6
"""A plan may use a budget to the last joule; rounding on the way must not strand it there."""
_HOUR_S, _DAY_S = 3600, 86400
_OUTPUTS = {mavlink.MAV_CMD_DO_SET_SERVO, mavlink.MAV_CMD_DO_SET_RELAY, mavlink.MAV_CMD_DO_GRIPPER}


@dataclass(frozen=True)
class RoverConfig:
    """What may differ from rover to rover.

    Attributes
    ----------
    ready_after_s
        Seconds from boot until the position estimate is good and the rover lets itself be armed (about
        40 s on a real one).
    has_script
        Whether the payload script is on board. Without it a NAV_SCRIPT_TIME lasts its timeout, and is then
        reported as reached as if it had been done; without a timeout it never ends.
    max_items
        Mission items it stores, home included.
    """

    ready_after_s: float = 5.0
    has_script: bool = True
    max_items: int = MAX_ITEMS


class Autopilot:
    """One rover in the world, without its radio.

    Attributes
    ----------
    position : tuple of float
        East and north, metres.
    energy_used_j : float
        Drawn from the battery since it was full; a restart does not fill it.
    stranded : bool
        The battery is empty: the rover stands where it is and never moves again. Its radio, autopilot and
        payload have a supply of their own.
    hung : bool
        A mission item has stopped the autopilot: it does and says nothing until it is restarted.
    outputs : Outputs
        Servos, relays and gripper.
    said : list
        STATUSTEXT and MISSION_ITEM_REACHED messages not yet taken by the radio.
    """

    def __init__(
        self,
        robot_id: str,
        world: World,
        parameters: Parameters,
        config: RoverConfig,
        now_s: float,
    ) -> None:
        self.robot = world.mission.robot(robot_id)
        self.parameters = parameters
        self.position: Position = world.places[self.robot.start]
        self.heading_deg = 0.0
        self.energy_used_j = 0.0
        self.stranded = False
        self.store = MissionStore(home=self.home_item, max_items=config.max_items)
        self.said: list[Any] = []
        self._world = world
        self._config = config
        self._time_s = now_s
        self.reboot(now_s)

    def reboot(self, now_s: float) -> None:
        """Start the autopilot anew: disarmed, at no item, counting from 1; the stored mission survives."""
        self.boot_s = self._time_s = now_s
        self.mode: int = mavlink.ROVER_MODE_MANUAL
        self.armed = False
        self.internal_error = False
        self.hung = False
        self.home = self.position
        self.script = PayloadScript(self.robot.id, self._world)
        self.outputs = Outputs(self.robot.id, self._world, self.parameters)
        self.run = MissionRun(self.store, self._begin, self._perform, self._completed)
        self._changes = ChangeDetector(self.store)
        self._energy_at_boot_j = self.energy_used_j
        self._activity: Activity | None = None
        self._leg: Leg | None = None
        self._was_in_auto = False

    @property
    def energy_since_boot_j(self) -> float:
        """Energy drawn since the autopilot was started."""
        return self.energy_used_j - self._energy_at_boot_j

    @property
    def battery_share(self) -> float:
        """Share of the battery that is left, 0 to 1."""
        budget_j = self.robot.energy_budget_j
        return max(0.0, 1.0 - self.energy_used_j / budget_j) if budget_j > 0.0 else 0.0

    @property
    def speed_m_s(self) -> float:
        """Speed over ground."""
        if self._leg is None or self.stranded or not (self.armed and self._active):
            return 0.0
        return self._leg.speed_m_s

    def ready_to_arm(self) -> bool:
        """Return whether the position estimate is good."""
        return self._time_s - self.boot_s >= self._config.ready_after_s

    def home_item(self) -> MissionItem:
        """Return home as item 0."""
        lat_deg, lon_deg = self._world.globe(self.home)
        return MissionItem(
            0, mavlink.MAV_FRAME_GLOBAL, mavlink.MAV_CMD_NAV_WAYPOINT, 0, 1, 0.0, 0.0, 0.0, 0.0,
            degrees_e7(lat_deg), degrees_e7(lon_deg), self._world.origin.alt_m,
        )  # fmt: skip

    def say(self, severity: int, text: str) -> None:
        """Put a STATUSTEXT on the list."""
        self.said.append(mavlink.MAVLink_statustext_message(severity, text.encode("ascii", "replace")[:50]))

    def arm(self, force: bool = False) -> bool:
        """Arm; refused with a text until ready, or after an internal error."""
        if self.internal_error:
            self.say(mavlink.MAV_SEVERITY_CRITICAL, "Arm: Internal errors 0x400 l:0 flow_of_ctrl")
        elif not force and not self.ready_to_arm():
            self.say(mavlink.MAV_SEVERITY_CRITICAL, "Arm: AHRS: waiting for position estimate")
        else:
            self.armed = True
            self.say(mavlink.MAV_SEVERITY_INFO, "Throttle armed")
        return self.armed

    def disarm(self) -> None:
        """Disarm: the motors stop wherever the rover is. Outside AUTO the mission begins anew after that."""
        if self.armed:
            self.armed = False
            if self.mode != mavlink.ROVER_MODE_AUTO:
                self.run.reset()
            self.say(mavlink.MAV_SEVERITY_INFO, "Throttle disarmed")

    def set_mode(self, mode: int) -> bool:
        """Change the mode; return whether the rover is in it now. Entering the present mode does nothing."""
        if mode == self.mode:
            return True
        if mode not in MODES:
            return False
        if mode == mavlink.ROVER_MODE_AUTO and len(self.store.items) <= 1:
            self.say(mavlink.MAV_SEVERITY_NOTICE, "No Mission. Can't set AUTO.")
            return False
        if self.mode == mavlink.ROVER_MODE_AUTO:
            self.run.stop()
        self.mode = mode
        self._activity = self._leg = None
        if mode == mavlink.ROVER_MODE_AUTO:
            self._was_in_auto = True
            self._changes.forget()
            self.run.start_or_resume(restart=self.parameters["MIS_RESTART"] == 1)
        return True

    def set_current(self, seq: int, reset: bool) -> bool:
        """Make a mission item current; with ``reset`` also resume a mission that is not running."""
        if reset and not self._was_in_auto:
            # Seen on a real Rover: the mission is started outside AUTO, and arming is blocked from then on.
            self.internal_error = True
            self.say(mavlink.MAV_SEVERITY_CRITICAL, "Internal error 0x400")
        return self.run.set_current(seq, resume=reset)

    def advance(self, now_s: float) -> None:
        """Live until ``now_s``, however far away that is."""
        if self._active:
            self._look_for_changes()
        while self._active and self._activity is not None and self._time_s < now_s:
            left_s = self._activity.advance(now_s - self._time_s)
            if left_s is None:
                break
            self._time_s = now_s - left_s
            self._item_ended()
        self._time_s = max(self._time_s, now_s)

    def leg_to(self, target: Position) -> Leg:
        """Return a new leg from here and set out on it."""
        self._leg = self._world.leg(self.robot.id, self.position, target)
        if not self._leg.done:
            self.heading_deg = self._leg.heading_deg
        return self._leg

    def drive(self, leg: Leg, duration_s: float) -> float | None:
        """Drive on along a leg as far as time and battery allow; see `Activity.advance`."""
        capacity_j = self.robot.energy_budget_j * (1.0 + _BUDGET_SLACK)
        progress = leg.advance(
            duration_s, self._world.mass_kg(self.robot.id), max(0.0, capacity_j - self.energy_used_j)
        )
        self.energy_used_j += progress.energy_j
        self.position = leg.position
        if leg.done:
            return max(0.0, duration_s - progress.time_s)
        if not self.stranded and self.energy_used_j >= capacity_j * (1.0 - _BUDGET_SLACK / 10):
            self.stranded = True
            self.say(mavlink.MAV_SEVERITY_EMERGENCY, "Battery empty: cannot move")
        return None

    @property
    def _active(self) -> bool:
        """Whether the mission goes on: armed or not, but only in AUTO."""
        return self.mode == mavlink.ROVER_MODE_AUTO and not self.hung

    def _look_for_changes(self) -> None:
        """Begin the present leg anew, out of what is stored by now, when the mission has changed ahead."""
        if not self._changes.look(self.run.seq) or self.run.state is not RunState.RUNNING:
            return
        if self.run.active is not None and self.run.active.command in WITH_POSITION:
            what = ", restarted" if self.run.set_current(self.run.seq) else " but failed to restart"
            self.say(mavlink.MAV_SEVERITY_CRITICAL, f"Auto mission changed{what} command")

    def _item_ended(self) -> None:
        self._activity = self._leg = None
        ended, follower = self.run.active, self.store.item(self.run.seq + 1)
        # Each link has one slot for "reached": a DO command right behind a waypoint can take the waypoint's.
        waypoint = ended is not None and ended.command == mavlink.MAV_CMD_NAV_WAYPOINT
        if not (waypoint and follower is not None and follower.command not in NAVIGATION):
            self._reached(self.run.seq)
        self.run.item_ended()

    def _reached(self, seq: int) -> None:
        self.said.append(mavlink.MAVLink_mission_item_reached_message(seq))

    def _completed(self) -> None:
        self._activity = self._leg = None
        self.say(mavlink.MAV_SEVERITY_NOTICE, "Mission Complete")

    def _perform(self, item: MissionItem) -> None:
        """Carry out a DO command."""
        if hangs(item):
            self.hung = True
        elif item.command in _OUTPUTS:
            text = self.outputs.drive(item, self.position)
            if text is not None:
                self.say(mavlink.MAV_SEVERITY_INFO, text)
        elif item.command == mavlink.MAV_CMD_DO_WINCH:
            self.say(mavlink.MAV_SEVERITY_WARNING, f"Skipping invalid cmd #{item.command}")
            self._reached(item.seq)

    def _begin(self, item: MissionItem) -> None:
        self._leg = None
        match item.command:
            case mavlink.MAV_CMD_NAV_WAYPOINT | mavlink.MAV_CMD_NAV_LOITER_TIME:
                self._activity = self._visit(item, item.param1)
            case mavlink.MAV_CMD_NAV_LOITER_UNLIM:
                self._activity = self._visit(item, None)
            case mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH:
                self._activity = self._visit(self.home_item(), 0.0)
            case mavlink.MAV_CMD_NAV_DELAY:
                self._activity = Pause(self._delay_s(item))
            case _:
                self._activity = self._scripted(item)

    def _visit(self, item: MissionItem, stay_s: float | None) -> Activity:
        """Return driving to the item's place, saying so, and staying there."""
        text = f"Reached waypoint #{self.run.seq}"
        if stay_s:
            text += f". Loiter for {stay_s:.0f} seconds"
        target = self._world.local(item.x / 1e7, item.y / 1e7)
        announce = Do(partial(self.say, mavlink.MAV_SEVERITY_INFO, text))
        return InTurn(_Travel(self, target), announce, Pause(stay_s))

    def _delay_s(self, item: MissionItem) -> float:
        """Return how long NAV_DELAY lasts: param 1, or else until a time of day (UTC).

        Of hour, minute and second those that are -1 are left out. A time just past is waited for until it
        comes again: tomorrow, where the hour is given.
        """
        if item.param1 > 0.0:
            return item.param1
        hour, minute, second = item.param2, item.param3, item.param4
        cycles_s = [_DAY_S] * (hour >= 0) + [_HOUR_S] * (minute >= 0) + [60] * (second >= 0)
        target_s = max(hour, 0.0) * _HOUR_S + max(minute, 0.0) * 60 + max(second, 0.0)
        return (target_s - self._time_s) % cycles_s[0] if cycles_s else 0.0

    def _scripted(self, item: MissionItem) -> Activity:
        timeout_s = item.param2 if item.param2 > 0.0 else math.inf
        if not self._config.has_script:
            return Pause(timeout_s)
        action = action_of(item)
        if action is Action.WAIT:
            return Pause(min(timeout_s, gate_delay_s(item.y, self._time_s)))
        if action is None:
            return Do(partial(self._refuse, f"MLP unknown action code {item.param1:.0f}"))
        duration_s = self.script.duration_s(self.store.items, item.seq)
        if duration_s > timeout_s:
            return Pause(timeout_s)
        return InTurn(Pause(duration_s), Do(partial(self._handle, action, item)))

    def attended(self, action: Action, tag: int) -> Outcome:
        """Return what a person finds who does an action by hand, or looks at what the hardware has done."""
        if isinstance(getattr(self._world.mission.vehicle(self.robot.id).payload, action.value), ByHand):
            return self._world.act(self.robot.id, action, tag, self.position)
        return self.outputs.outcome or Outcome("unknown")

    def _handle(self, action: Action, item: MissionItem) -> bool:
        """Carry out a payload action; the rover holds when it cannot be done, rather than drive on."""
        result = self.script.carry_out(action, item, self.position)
        if result == "ok" or (result == "missing" and goes_on_without(item)):
            return True
        return self._refuse(f"Cannot {action} {item.x}: holding")

    def _refuse(self, text: str) -> bool:
        self.say(mavlink.MAV_SEVERITY_ERROR, text)
        self.set_mode(mavlink.ROVER_MODE_HOLD)
        return False


class _Travel:
    """Driving straight to a place; disarmed the rover does not get there, even where it is there already."""

    def __init__(self, autopilot: Autopilot, target: Position) -> None:
        self._autopilot = autopilot
        self._target = target
        self._leg: Leg | None = None

    def advance(self, duration_s: float) -> float | None:
        """See `Activity`."""
        if not self._autopilot.armed:
            return None
        if self._leg is None:
            self._leg = self._autopilot.leg_to(self._target)
        return self._autopilot.drive(self._leg, duration_s)


def mission_state(autopilot: Autopilot) -> int:
    """Return MISSION_STATE as ArduPilot reports it; it never says paused."""
    if len(autopilot.store.items) <= 1:
        return int(mavlink.MISSION_STATE_NO_MISSION)
    return int(
        {
            RunState.STOPPED: mavlink.MISSION_STATE_NOT_STARTED,
            RunState.RUNNING: mavlink.MISSION_STATE_ACTIVE,
            RunState.COMPLETE: mavlink.MISSION_STATE_COMPLETE,
        }[autopilot.run.state]
    )
