"""Steps as the MAVLink items that a vehicle with its payload hardware carries out.

Item 0 is home, and item 1 always a waypoint: AUTO is entered once before the vehicle is armed, and there a
Rover carries out whatever is no drive. A drive is one waypoint. An action by the payload script is one
NAV_SCRIPT_TIME; by a servo, relay or gripper it is a DO command and a NAV_DELAY that gives it time (DO
commands end at once); by a person it is a NAV_LOITER_UNLIM, which ends when the ground makes the next item
current.

A gate at which the vehicle only waits for the ground is NAV_SCRIPT_TIME or NAV_LOITER_UNLIM, after what picks
there. One that may also open by time is NAV_DELAY to a time of day (UTC) where there is no script; the script
is told the time and keeps it itself, since it can tell a gate that is late from one of tomorrow.

y of a scripted action is twice the number of the run, and 1 more where the vehicle goes on without the
container.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

from malipp_field.mission.vehicles import Actuator, ByGripper, ByHand, ByRelay, ByScript, ByServo, Means
from malipp_field.vehicle.items import (
    IN_PASSING,
    MAV_CMD_DO_GRIPPER,
    MAV_CMD_DO_SET_RELAY,
    MAV_CMD_DO_SET_SERVO,
    MAV_CMD_NAV_DELAY,
    MAV_CMD_NAV_LOITER_UNLIM,
    MAV_CMD_NAV_SCRIPT_TIME,
    MAV_CMD_NAV_WAYPOINT,
    MAV_FRAME_GLOBAL,
    MissionItem,
    degrees_e7,
    item_at,
    item_without_place,
)
from malipp_field.vehicle.steps import Action, GeoPoint, Step, VehicleMission, Witness

ACTION_CODES = {Action.WAIT: 1, Action.COLLECT: 2, Action.DROP: 3, Action.PICK: 4, Action.UNLOAD: 5}
"""``command`` (param 1) of NAV_SCRIPT_TIME, as the payload script on the vehicle knows it."""

GATE_UNIT_S = 4
"""The time of day of a script's gate travels in y as 1 + seconds / 4, so that it fits an int16; 0 is none."""
DAY_S = 86400

_GRAB, _RELEASE = 1.0, 0.0
_ON, _OFF = 1.0, 0.0
_NOT_RELATIVE = -1.0  # NAV_DELAY: wait until the time of day in params 2 to 4


class Layout(NamedTuple):
    """A vehicle's mission items, and the step each belongs to.

    Attributes
    ----------
    items
        Home first; sequence numbers count from 0.
    steps
        For every item the index of its step; -1 for home.
    """

    items: list[MissionItem]
    steps: list[int]

    def first_item(self, step: int) -> int:
        """Return the sequence number of a step's first item."""
        return self.steps.index(step)

    def last_item(self, step: int) -> int:
        """Return the sequence number of a step's last item."""
        return len(self.steps) - 1 - self.steps[::-1].index(step)

    def shown_at(self, item: int) -> int:
        """Return which item MISSION_CURRENT shows when ``item`` has been made current."""
        return next(i.seq for i in self.items[item:] if i.command not in IN_PASSING)


def lay_out(vehicle: VehicleMission) -> Layout:
    """Return the MAVLink mission of a vehicle."""
    items, steps = [_home_item(vehicle.home)], [-1]
    for index, step in enumerate(vehicle.steps):
        for item in _items(vehicle, step):
            if len(items) == 1 and item.command != MAV_CMD_NAV_WAYPOINT:
                items.append(_waypoint(step)._replace(seq=1))
                steps.append(index)
            items.append(item._replace(seq=len(items)))
            steps.append(index)
    return Layout(items, steps)


def means_of(vehicle: VehicleMission, step: Step) -> Means | None:
    """Return how a payload step is done on that vehicle; `None` for a drive or a gate."""
    profile = vehicle.payload
    return {
        Action.COLLECT: profile.collect, Action.DROP: profile.drop,
        Action.PICK: profile.pick, Action.UNLOAD: profile.unload,
    }.get(step.action)  # fmt: skip


def held_for_operator(means: Means | None) -> bool:
    """Tell whether an action ends with the vehicle holding until a person has confirmed it."""
    return isinstance(means, ByHand) or getattr(means, "confirm", "progress") == "operator"


def confirmed_by(vehicle: VehicleMission, step: Step) -> Witness | None:
    """Return who confirms a payload step on that vehicle; `None` for a drive or a gate."""
    means = means_of(vehicle, step)
    if means is None or isinstance(means, ByScript):
        return None if means is None else "script"
    return "person" if held_for_operator(means) else "progress"


def gate_code(not_before_s: float) -> int:
    """Return the time of a gate (seconds since the Unix epoch) for the payload script, rounded up."""
    return 1 + math.ceil(not_before_s % DAY_S / GATE_UNIT_S) % (DAY_S // GATE_UNIT_S)


def _home_item(home: GeoPoint) -> MissionItem:
    return MissionItem(
        0, MAV_FRAME_GLOBAL, MAV_CMD_NAV_WAYPOINT, 0, 1, 0.0, 0.0, 0.0, 0.0,
        degrees_e7(home.lat_deg), degrees_e7(home.lon_deg), home.alt_m,
    )  # fmt: skip


def _items(vehicle: VehicleMission, step: Step) -> Iterator[MissionItem]:
    """Yield the items of a step, not numbered yet."""
    means = means_of(vehicle, step)
    if step.action is Action.DRIVE:
        yield _waypoint(step)
    elif step.action is Action.WAIT:
        yield _gate(step, by_script=isinstance(vehicle.payload.pick, ByScript))
    elif isinstance(means, ByScript):
        yield _scripted(step, y=2 * vehicle.run + (step.if_missing == "go_on"))
    elif means is not None:
        if not isinstance(means, ByHand):
            yield from _actuated(means)
        if held_for_operator(means):
            yield _hold(step)


def _waypoint(step: Step) -> MissionItem:
    return item_at(0, MAV_CMD_NAV_WAYPOINT, step.place.lat_deg, step.place.lon_deg)


def _gate(step: Step, *, by_script: bool) -> MissionItem:
    if by_script:
        return _scripted(step, y=0 if step.not_before_s is None else gate_code(step.not_before_s))
    if step.not_before_s is None:
        return _hold(step)
    second = math.ceil(step.not_before_s) % DAY_S
    return item_without_place(
        0, MAV_CMD_NAV_DELAY, _NOT_RELATIVE, second // 3600, second // 60 % 60, second % 60
    )


def _hold(step: Step) -> MissionItem:
    return item_at(0, MAV_CMD_NAV_LOITER_UNLIM, step.place.lat_deg, step.place.lon_deg)


def _scripted(step: Step, y: int) -> MissionItem:
    # Timeout 0: ArduPilot then waits for the script's word for ever. A vehicle that stands still is found
    # again; one that drives on without its sample is not noticed ("reached" is no proof).
    return item_without_place(
        0, MAV_CMD_NAV_SCRIPT_TIME, float(ACTION_CODES[step.action]), 0.0, float(step.stop),
        float(len(step.tags)), x=step.tags[0] if step.tags else 0, y=y,
    )  # fmt: skip


def _actuated(means: Actuator) -> Iterator[MissionItem]:
    """Yield setting an output, the time it is given, and putting it to rest."""
    delay = item_without_place(0, MAV_CMD_NAV_DELAY, means.duration_s, -1.0, -1.0, -1.0)
    if isinstance(means, ByGripper):
        # Only 0 and 1: with any other action ArduPilot hangs.
        move = _GRAB if means.move == "grab" else _RELEASE
        yield item_without_place(0, MAV_CMD_DO_GRIPPER, float(means.gripper), move)
        yield delay
    elif isinstance(means, ByRelay):
        yield item_without_place(0, MAV_CMD_DO_SET_RELAY, float(means.relay), _ON)
        yield delay
        yield item_without_place(0, MAV_CMD_DO_SET_RELAY, float(means.relay), _OFF)
    elif isinstance(means, ByServo):
        yield item_without_place(0, MAV_CMD_DO_SET_SERVO, float(means.channel), float(means.pwm_us))
        yield delay
        if means.rest_us is not None:
            yield item_without_place(0, MAV_CMD_DO_SET_SERVO, float(means.channel), float(means.rest_us))
