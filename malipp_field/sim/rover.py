"""One simulated rover as the ground meets it: MAVLink messages and the time in, MAVLink messages out."""

from __future__ import annotations

import math
from collections.abc import Hashable
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from malipp_field.sim.autopilot import Autopilot, RoverConfig
from malipp_field.sim.failsafe import GcsFailsafe
from malipp_field.sim.mission_store import FenceStore, MissionStore, Sender
from malipp_field.sim.params import Parameters
from malipp_field.sim.telemetry import Telemetry
from malipp_field.sim.world import World
from malipp_field.vehicle.fence import MAX_RALLY_POINTS
from malipp_field.vehicle.payload_protocol import ack_name

Peer = Hashable
"""Where a message came from and an answer goes to: a UDP address, or whatever carries the messages."""

_FORCE_ARM = 2989.0  # param 2 of MAV_CMD_COMPONENT_ARM_DISARM; ArduPilot takes MAVLink's 21196 to disarm only
_ON, _OFF = 1.0, 0.0


class Rover:
    """A rover and its radio, without the wires.

    It has no file transfer, like ArduPilot on boards without room for it (AUTOPILOT_VERSION says so): ground
    stations fall back to the protocols for missions and parameters.

    Parameters
    ----------
    robot_id
        Which robot of ``world.mission`` it is.
    world
        The truth it moves in, shared with the other rovers.
    system_id
        MAVLink system id, 1 to 255.
    now_s
        When it is switched on.
    config
        See `RoverConfig`.

    Attributes
    ----------
    outbox : list of (peer or None, message)
        What it wants sent, in order; `None` is for everybody who was heard of late. Whoever carries the
        messages takes them out.
    autopilot : Autopilot
        Where it is and what it does.
    peers : dict of Sender to peer
        Where each system that was heard is to be reached.
    """

    def __init__(
        self,
        robot_id: str,
        world: World,
        system_id: int,
        now_s: float,
        config: RoverConfig | None = None,
    ) -> None:
        self.robot_id, self.world = robot_id, world
        self.system_id = system_id
        speed_m_s = world.mission.robot(robot_id).speed_m_s
        changed = {"WP_SPEED": speed_m_s, **world.mission.simulation.parameters, "MAV_SYSID": system_id}
        self.parameters = Parameters(**changed)
        self._failsafe = GcsFailsafe(self.parameters)
        self.autopilot = Autopilot(robot_id, world, self.parameters, config or RoverConfig(), now_s)
        self.outbox: list[tuple[Peer | None, Any]] = []
        self._telemetry = Telemetry(self.autopilot, world, system_id)
        self._stores = {
            mavlink.MAV_MISSION_TYPE_MISSION: self.autopilot.store,
            mavlink.MAV_MISSION_TYPE_FENCE: FenceStore(),
            mavlink.MAV_MISSION_TYPE_RALLY: MissionStore(
                mavlink.MAV_MISSION_TYPE_RALLY, max_items=MAX_RALLY_POINTS
            ),
        }
        self.peers: dict[Sender, Peer] = {}

    def reboot(self, now_s: float) -> None:
        """Restart the autopilot; stored missions and parameters survive."""
        for store in self._stores.values():
            store.abort()
        self._failsafe.forget()
        self.autopilot.reboot(now_s)

    def step(self, now_s: float) -> None:
        """Live until ``now_s`` and put what is to be said by then into the outbox."""
        due_s = self._failsafe.due_s()
        if due_s is not None and due_s <= now_s:
            self.autopilot.advance(due_s)
            self._lost_ground()
        self.autopilot.advance(now_s)
        if self.autopilot.hung:
            return
        for store in self._stores.values():
            for message in store.poll(now_s):
                to = Sender(message.target_system, message.target_component)
                self.outbox.append((self.peers[to], message))
        self._broadcast(self.autopilot.said)
        self.autopilot.said = []
        for text in self.autopilot.script.due(now_s):
            self._broadcast([mavlink.MAVLink_statustext_message(mavlink.MAV_SEVERITY_INFO, text.encode())])
        self._broadcast(self._telemetry.due(now_s))

    def _lost_ground(self) -> None:
        """Act as the failsafe says; in HOLD there is nothing to do, until that mode is left."""
        autopilot = self.autopilot
        if autopilot.mode == mavlink.ROVER_MODE_HOLD:
            return
        self._failsafe.triggered = True
        autopilot.say(mavlink.MAV_SEVERITY_WARNING, "GCS Failsafe")
        in_auto = autopilot.mode == mavlink.ROVER_MODE_AUTO
        if self._failsafe.holds(in_auto):
            autopilot.set_mode(mavlink.ROVER_MODE_HOLD)
        elif in_auto:
            autopilot.say(mavlink.MAV_SEVERITY_WARNING, "Failsafe - Continuing Auto Mode")

    def receive(self, message: Any, peer: Peer, now_s: float) -> None:
        """Handle one message that arrived; what is addressed to another system is ignored."""
        if self.autopilot.hung or getattr(message, "target_system", 0) not in (0, self.system_id):
            return
        self.step(now_s)
        sender = Sender(message.get_srcSystem(), message.get_srcComponent())
        self.peers[sender] = peer
        for answer in self._answers(message, sender, now_s):
            self.outbox.append((peer, answer))
        self.step(now_s)

    def _broadcast(self, messages: list[Any]) -> None:
        self.outbox.extend((None, message) for message in messages)

    def _answers(self, message: Any, sender: Sender, now_s: float) -> list[Any]:
        kind = message.get_type()
        if kind in {"COMMAND_LONG", "COMMAND_INT"}:
            answers = self._command(message, sender, now_s)
        elif kind == "MISSION_SET_CURRENT":
            answers = self._set_current(message.seq, now_s)
        elif kind.startswith("MISSION_"):
            answers = self._mission(message, sender, now_s)
        elif kind.startswith("PARAM_"):
            answers = self.parameters.receive(message)
        elif kind == "TIMESYNC" and message.tc1 == 0:
            answers = [mavlink.MAVLink_timesync_message(int(now_s * 1e9), message.ts1)]
        else:
            answers = []
            self._note(message, kind, now_s)
        return answers

    def _note(self, message: Any, kind: str, now_s: float) -> None:
        """Handle what gets no answer; REQUEST_DATA_STREAM is heard, but all streams flow anyway."""
        if kind == "HEARTBEAT" and self._failsafe.heard(message.get_srcSystem(), now_s):
            self.autopilot.say(mavlink.MAV_SEVERITY_INFO, "GCS Failsafe Cleared")
        elif kind == "SET_MODE" and message.base_mode & mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED:
            self.autopilot.set_mode(message.custom_mode)
        elif kind == "NAMED_VALUE_INT" and message.name == ack_name(self.system_id):
            self.autopilot.script.acknowledge(message.value)

    def _mission(self, message: Any, sender: Sender, now_s: float) -> list[Any]:
        if message.get_type() == "MISSION_CLEAR_ALL" and message.mission_type == mavlink.MAV_MISSION_TYPE_ALL:
            answers = [store.receive(message, sender, now_s)[0] for store in self._stores.values()]
            return [max(answers, key=lambda ack: ack.type)]
        store = self._stores.get(getattr(message, "mission_type", mavlink.MAV_MISSION_TYPE_MISSION))
        return [] if store is None else store.receive(message, sender, now_s)

    def _set_current(self, seq: int, now_s: float) -> list[Any]:
        """Make an item current; the answer names just that one, even where another is current now."""
        if not self.autopilot.set_current(seq, reset=False):
            return []
        answer: Any = self._telemetry.message(mavlink.MAVLINK_MSG_ID_MISSION_CURRENT, now_s)
        answer.seq = seq
        return [answer]

    def _command(self, message: Any, sender: Sender, now_s: float) -> list[Any]:
        result, more = self._carry_out(message, now_s)
        ack = mavlink.MAVLink_command_ack_message(
            message.command,
            result,
            target_system=sender.system,
            target_component=sender.component,
        )
        return [ack, *more]

    def _carry_out(self, message: Any, now_s: float) -> tuple[int, list[Any]]:
        """Return MAV_RESULT, and what was asked for."""
        autopilot = self.autopilot
        # NaN is MAVLink's way of leaving a param out.
        p1, p2 = (p if math.isfinite(p) else 0.0 for p in (message.param1, message.param2))
        more: list[Any] = []
        done = True
        match message.command:
            case mavlink.MAV_CMD_COMPONENT_ARM_DISARM:
                done = self._arm_or_disarm(p1, force=p2 == _FORCE_ARM)
            case mavlink.MAV_CMD_DO_SET_MODE:
                custom = int(p1) & mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
                done = bool(custom) and autopilot.set_mode(int(p2))
            case mavlink.MAV_CMD_MISSION_START:
                done = autopilot.set_mode(mavlink.ROVER_MODE_AUTO)
            case mavlink.MAV_CMD_DO_SET_MISSION_CURRENT:
                done = autopilot.set_current(int(p1), reset=p2 == _ON)
            case mavlink.MAV_CMD_SET_MESSAGE_INTERVAL:
                done = self._telemetry.set_interval(int(p1), p2)
            case mavlink.MAV_CMD_REQUEST_MESSAGE:
                asked = self._telemetry.message(int(p1), now_s)
                done, more = asked is not None, [] if asked is None else [asked]
            case mavlink.MAV_CMD_GET_HOME_POSITION:
                asked_for = (mavlink.MAVLINK_MSG_ID_HOME_POSITION, mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN)
                more = [self._telemetry.message(message_id, now_s) for message_id in asked_for]
            case mavlink.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES:
                more = [self._telemetry.message(mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION, now_s)]
            case mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN if p1 == _ON:
                done = not autopilot.armed
                if done:
                    self.reboot(now_s)
            case _:
                return mavlink.MAV_RESULT_UNSUPPORTED, []
        return mavlink.MAV_RESULT_ACCEPTED if done else mavlink.MAV_RESULT_FAILED, more

    def _arm_or_disarm(self, wanted: float, force: bool) -> bool:
        if wanted == _ON:
            return self.autopilot.arm(force)
        if wanted == _OFF:
            self.autopilot.disarm()
            return True
        return False
