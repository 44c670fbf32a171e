"""What one autopilot says about itself, gathered from its messages; no I/O."""

from __future__ import annotations

import math

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from malipp_field.link.exchange import AUTOPILOT_COMPONENT, MavMessage
from malipp_field.vehicle.payload_protocol import ENERGY_NAME, JOULES_PER_WATT_HOUR

HEARTBEAT_LOST_S = 5.0
JOULES_PER_HECTOJOULE = 100.0
_POSITION_GOOD = mavlink.EKF_POS_HORIZ_REL | mavlink.EKF_POS_HORIZ_ABS  # flags 8 and 16
_HEADING_UNKNOWN = 65535

MODE_NUMBERS: dict[str, int] = {
    entry.name.removeprefix("ROVER_MODE_"): number
    for number, entry in mavlink.enums["ROVER_MODE"].items()
    if not entry.name.endswith("ENUM_END")
}
"""Rover's custom modes by name: MANUAL, HOLD, AUTO and so on."""
_MODE_NAMES = {number: name for name, number in MODE_NUMBERS.items()}


STREAM_MESSAGES = frozenset(
    {
        mavlink.MAVLINK_MSG_ID_SYS_STATUS, mavlink.MAVLINK_MSG_ID_SYSTEM_TIME,
        mavlink.MAVLINK_MSG_ID_GPS_RAW_INT, mavlink.MAVLINK_MSG_ID_GPS2_RAW, mavlink.MAVLINK_MSG_ID_RAW_IMU,
        mavlink.MAVLINK_MSG_ID_SCALED_IMU2, mavlink.MAVLINK_MSG_ID_SCALED_IMU3,
        mavlink.MAVLINK_MSG_ID_SCALED_PRESSURE, mavlink.MAVLINK_MSG_ID_SCALED_PRESSURE2,
        mavlink.MAVLINK_MSG_ID_ATTITUDE, mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED,
        mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT, mavlink.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW,
        mavlink.MAVLINK_MSG_ID_RC_CHANNELS, mavlink.MAVLINK_MSG_ID_NAV_CONTROLLER_OUTPUT,
        mavlink.MAVLINK_MSG_ID_VFR_HUD, mavlink.MAVLINK_MSG_ID_AHRS, mavlink.MAVLINK_MSG_ID_AHRS2,
        mavlink.MAVLINK_MSG_ID_HWSTATUS, mavlink.MAVLINK_MSG_ID_MEMINFO, mavlink.MAVLINK_MSG_ID_POWER_STATUS,
        mavlink.MAVLINK_MSG_ID_VIBRATION, mavlink.MAVLINK_MSG_ID_TERRAIN_REPORT,
        mavlink.MAVLINK_MSG_ID_BATTERY_STATUS, mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT,
    }
)  # fmt: skip
"""What an ArduPilot sends again and again, of its own accord: most of the traffic of a link."""


class Vehicle:
    """The state of one autopilot as far as it has been heard.

    Attributes
    ----------
    mode : str
        Rover's name of the mode, empty before the first heartbeat.
    heard_since_s : float or None
        When it was first heard, or heard again after `HEARTBEAT_LOST_S` of silence.
    lat_deg, lon_deg : float or None
        None before the first position.
    position_s : float or None
        When the last position arrived.
    heading_deg, speed_m_s : float
        Clockwise from north; over ground.
    ready_to_arm : bool
        The position estimate is good; SYS_STATUS says so too early (measured on ArduPilot Rover 4.7).
    energy_used_j : float
        What the payload script measures, else what the battery monitor does.
    current_seq : int or None
        MISSION_CURRENT: the item being carried out.
    mission_complete : bool
        MISSION_CURRENT: all items are done.
    clock_ahead_s : float or None
        The vehicle's clock (UTC) less ours, as of its last report and no more exact than the link is quick;
        None while it does not know the time.
    heartbeats, mission_reports : int
        How many HEARTBEAT and MISSION_CURRENT have arrived, to tell fresh news from old.
    """

    def __init__(self, system_id: int, component_id: int = AUTOPILOT_COMPONENT) -> None:
        self.address = (system_id, component_id)
        self.mode = ""
        self.armed = False
        self.auto_entered = False
        self.lat_deg: float | None = None
        self.lon_deg: float | None = None
        self.position_s: float | None = None
        self.heading_deg = 0.0
        self.speed_m_s = 0.0
        self.ready_to_arm = False
        self.energy_used_j = 0.0
        self.current_seq: int | None = None
        self.mission_complete = False
        self.clock_ahead_s: float | None = None
        self.heartbeats = 0
        self.mission_reports = 0
        self.last_heartbeat_s: float | None = None
        self.heard_since_s: float | None = None
        self._script_measures_energy = False
        self._handlers = {
            mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: self._position,
            mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT: self._ekf_status,
            mavlink.MAVLINK_MSG_ID_BATTERY_STATUS: self._battery,
            mavlink.MAVLINK_MSG_ID_NAMED_VALUE_FLOAT: self._named_value,
            mavlink.MAVLINK_MSG_ID_MISSION_CURRENT: self._mission_current,
        }

    @property
    def heeded(self) -> frozenset[int]:
        """Ids of the messages that this state is made of; all of them must be decoded."""
        return frozenset(self._handlers) | {
            mavlink.MAVLINK_MSG_ID_HEARTBEAT, mavlink.MAVLINK_MSG_ID_SYSTEM_TIME,
        }  # fmt: skip

    def link_ok(self, now_s: float) -> bool:
        """Return whether a heartbeat arrived within the last `HEARTBEAT_LOST_S` seconds."""
        return self.last_heartbeat_s is not None and now_s - self.last_heartbeat_s < HEARTBEAT_LOST_S

    def receive(self, message: MavMessage, now_s: float) -> bool:
        """Take in a message of the link; return whether this vehicle sent it."""
        if (message.get_srcSystem(), message.get_srcComponent()) != self.address:
            return False
        if message.get_msgId() == mavlink.MAVLINK_MSG_ID_HEARTBEAT:
            self._heartbeat(message, now_s)
        if message.get_msgId() == mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT:
            self.position_s = now_s
        if message.get_msgId() == mavlink.MAVLINK_MSG_ID_SYSTEM_TIME:
            unix_s = message.time_unix_usec / 1e6
            self.clock_ahead_s = unix_s - now_s if unix_s > 0.0 else None
        handler = self._handlers.get(message.get_msgId())
        if handler is not None:
            handler(message)
        return True

    def _heartbeat(self, message: MavMessage, now_s: float) -> None:
        if not self.link_ok(now_s):
            self.heard_since_s = now_s
        self.heartbeats += 1
        self.last_heartbeat_s = now_s
        self.mode = _MODE_NAMES.get(message.custom_mode, f"mode {message.custom_mode}")
        self.armed = bool(message.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
        self.auto_entered = self.auto_entered or self.mode == "AUTO"

    def _position(self, message: MavMessage) -> None:
        self.lat_deg, self.lon_deg = message.lat / 1e7, message.lon / 1e7
        self.speed_m_s = math.hypot(message.vx, message.vy) / 100.0
        if message.hdg != _HEADING_UNKNOWN:
            self.heading_deg = message.hdg / 100.0

    def _ekf_status(self, message: MavMessage) -> None:
        self.ready_to_arm = message.flags & _POSITION_GOOD == _POSITION_GOOD

    def _battery(self, message: MavMessage) -> None:
        if not self._script_measures_energy and message.energy_consumed >= 0:
            self.energy_used_j = message.energy_consumed * JOULES_PER_HECTOJOULE

    def _named_value(self, message: MavMessage) -> None:
        if message.name == ENERGY_NAME and math.isfinite(message.value):
            self._script_measures_energy = True
            self.energy_used_j = message.value * JOULES_PER_WATT_HOUR

    def _mission_current(self, message: MavMessage) -> None:
        self.mission_reports += 1
        self.current_seq = message.seq
        self.mission_complete = message.mission_state == mavlink.MISSION_STATE_COMPLETE
