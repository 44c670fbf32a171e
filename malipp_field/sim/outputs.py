"""Servo, relay and gripper outputs of one vehicle, and the payload mechanism that hangs on them.

DO commands drive outputs and know nothing of containers. Which movement does what is the vehicle's payload
profile; what comes of it depends on what is there (`World.work`).
"""

from __future__ import annotations

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from malipp_field.mission.vehicles import ByGripper, ByRelay, ByServo, Means
from malipp_field.sim.motion import Position
from malipp_field.sim.params import Parameters
from malipp_field.sim.world import Outcome, World
from malipp_field.vehicle.items import MissionItem
from malipp_field.vehicle.steps import Action

_FREE_FUNCTIONS = {0, 1, 22, 23, 28, *range(51, 67)}
"""SERVOn_FUNCTION with which a channel obeys DO_SET_SERVO."""
_RELEASE, _GRAB = 0, 1


class Outputs:
    """What drives a payload mechanism.

    Attributes
    ----------
    servos_us, relays : dict
        As last set, by channel and by relay.
    outcome : Outcome or None
        What the last movement of the mechanism came to; a person can see that, the vehicle cannot.
    """

    def __init__(self, robot_id: str, world: World, parameters: Parameters) -> None:
        self._robot_id, self._world, self._parameters = robot_id, world, parameters
        self._profile = world.mission.vehicle(robot_id).payload
        self.servos_us: dict[int, int] = {}
        self.relays: dict[int, bool] = {}
        self.outcome: Outcome | None = None

    def drive(self, item: MissionItem, place: Position) -> str | None:
        """Carry out a DO command on an output; return what the autopilot says of it."""
        number, value = int(item.param1), int(item.param2)
        text = None
        if item.command == mavlink.MAV_CMD_DO_SET_SERVO:
            if self._parameters.get(f"SERVO{number}_FUNCTION", 0) not in _FREE_FUNCTIONS:
                return f"ServoRelayEvent: Channel {number} is already in use"
            self.servos_us[number] = value
        elif item.command == mavlink.MAV_CMD_DO_SET_RELAY:
            if self._parameters.get(f"RELAY{number + 1}_FUNCTION", 0) != 1:
                return None
            self.relays[number] = bool(value)
        else:
            text = "Gripper Grabbed" if value == _GRAB else "Gripper Released"
            if self._parameters["GRIP_ENABLE"] != 1:  # it says so all the same
                return text
        actions = {
            action
            for action in (Action.COLLECT, Action.DROP, Action.PICK, Action.UNLOAD)
            if _works(getattr(self._profile, action.value), item.command, number, value)
        }
        if actions:
            self.outcome = self._world.work(self._robot_id, actions, place)
        return text


def hangs(item: MissionItem) -> bool:
    """Tell whether an item is one that the autopilot never comes back from."""
    return item.command == mavlink.MAV_CMD_DO_GRIPPER and item.param2 not in (_RELEASE, _GRAB)


def _works(means: Means, command: int, number: int, value: int) -> bool:
    """Tell whether a command is the movement by which an action is done."""
    if isinstance(means, ByServo):
        return (command, number, value) == (mavlink.MAV_CMD_DO_SET_SERVO, means.channel, means.pwm_us)
    if isinstance(means, ByRelay):
        return (command, number, bool(value)) == (mavlink.MAV_CMD_DO_SET_RELAY, means.relay, True)
    if isinstance(means, ByGripper):
        move = _GRAB if means.move == "grab" else _RELEASE
        return (command, number, value) == (mavlink.MAV_CMD_DO_GRIPPER, means.gripper, move)
    return False
