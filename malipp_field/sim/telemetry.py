"""What a rover says of itself unasked, how often, and how each message is made."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from malipp_field.sim.autopilot import Autopilot, mission_state
from malipp_field.sim.world import World
from malipp_field.vehicle.items import degrees_e7
from malipp_field.vehicle.payload_protocol import ENERGY_NAME, JOULES_PER_WATT_HOUR

NOMINAL_V = 12.0
"""Battery voltage; it does not sag."""

_ALL_SENSORS = (
    mavlink.MAV_SYS_STATUS_SENSOR_3D_GYRO
    | mavlink.MAV_SYS_STATUS_SENSOR_3D_ACCEL
    | mavlink.MAV_SYS_STATUS_SENSOR_3D_MAG
    | mavlink.MAV_SYS_STATUS_SENSOR_GPS
    | mavlink.MAV_SYS_STATUS_SENSOR_MOTOR_OUTPUTS
    | mavlink.MAV_SYS_STATUS_SENSOR_BATTERY
    | mavlink.MAV_SYS_STATUS_PREARM_CHECK
)
_HEALTHY = _ALL_SENSORS | mavlink.MAV_SYS_STATUS_GEOFENCE
"""A fence that is not breached is healthy, even where there is none; ground stations report a breach else."""
_EKF_FROM_BOOT = (
    mavlink.EKF_ATTITUDE | mavlink.EKF_VELOCITY_HORIZ | mavlink.EKF_VELOCITY_VERT | mavlink.EKF_POS_VERT_ABS
)
_EKF_WITH_POSITION = (
    mavlink.EKF_POS_HORIZ_REL
    | mavlink.EKF_POS_HORIZ_ABS
    | mavlink.EKF_PRED_POS_HORIZ_REL
    | mavlink.EKF_PRED_POS_HORIZ_ABS
)
_CAPABILITIES = (
    mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_FLOAT
    | mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_FLOAT
    | mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_INT
    | mavlink.MAV_PROTOCOL_CAPABILITY_COMMAND_INT
    | mavlink.MAV_PROTOCOL_CAPABILITY_MAVLINK2
    | mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_FENCE
    | mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_RALLY
)
_FIRMWARE = 4 << 24 | 7 << 16  # 4.7.0, development


class Telemetry:
    """Messages about one autopilot, each when it is due.

    Parameters
    ----------
    autopilot, world
        What they report.
    system_id
        Goes into the unique id of AUTOPILOT_VERSION.
    """

    def __init__(self, autopilot: Autopilot, world: World, system_id: int) -> None:
        self._autopilot = autopilot
        self._world = world
        self._system_id = system_id
        self._builders: dict[int, Callable[[float], Any]] = {
            mavlink.MAVLINK_MSG_ID_HEARTBEAT: self._heartbeat,
            mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: self._global_position,
            mavlink.MAVLINK_MSG_ID_ATTITUDE: self._attitude,
            mavlink.MAVLINK_MSG_ID_VFR_HUD: self._hud,
            mavlink.MAVLINK_MSG_ID_SYS_STATUS: self._sys_status,
            mavlink.MAVLINK_MSG_ID_BATTERY_STATUS: self._battery_status,
            mavlink.MAVLINK_MSG_ID_MISSION_CURRENT: self._mission_current,
            mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT: self._ekf_status,
            mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: self._gps_raw,
            mavlink.MAVLINK_MSG_ID_SYSTEM_TIME: self._system_time,
            mavlink.MAVLINK_MSG_ID_NAMED_VALUE_FLOAT: self._energy,
            mavlink.MAVLINK_MSG_ID_HOME_POSITION: self._home_position,
            mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: self._global_origin,
            mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION: self._version,
        }
        self._intervals_s = dict(_DEFAULT_INTERVALS_S)
        self._due_s: dict[int, float] = dict.fromkeys(self._intervals_s, 0.0)
        self._said_mission: tuple[int, int, int] | None = None

    def due(self, now_s: float) -> list[Any]:
        """Return the messages due; MISSION_CURRENT also as soon as it has something new to say."""
        run = (self._autopilot.run.seq, len(self._autopilot.store.items), mission_state(self._autopilot))
        if run != self._said_mission:
            self._said_mission = run
            self._due_s[mavlink.MAVLINK_MSG_ID_MISSION_CURRENT] = now_s
        messages = []
        for message_id, due_s in self._due_s.items():
            if due_s <= now_s:
                interval_s = self._intervals_s[message_id]
                # On its beat, so that coarse steps do not slow the rate; after a gap it begins anew.
                self._due_s[message_id] = (due_s if now_s - due_s < interval_s else now_s) + interval_s
                messages.append(self._builders[message_id](now_s))
        return messages

    def message(self, message_id: int, now_s: float) -> Any | None:
        """Return one message on request, or `None` when the rover has no such message."""
        builder = self._builders.get(message_id)
        return None if builder is None else builder(now_s)

    def set_interval(self, message_id: int, interval_us: float) -> bool:
        """Send a message every so often; 0 asks for the default rate, -1 for none."""
        if message_id not in self._builders:
            return False
        interval_s = interval_us / 1e6 if interval_us > 0 else math.inf
        if interval_us == 0:
            interval_s = _DEFAULT_INTERVALS_S.get(message_id, math.inf)
        self._intervals_s[message_id] = interval_s
        self._due_s[message_id] = 0.0 if math.isfinite(interval_s) else math.inf
        return True

    def _boot_ms(self, now_s: float) -> int:
        return int((now_s - self._autopilot.boot_s) * 1000.0) % 2**32

    def _heartbeat(self, _: float) -> Any:
        autopilot = self._autopilot
        base_mode = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
        if autopilot.armed:
            base_mode |= mavlink.MAV_MODE_FLAG_SAFETY_ARMED
        if autopilot.mode in (mavlink.ROVER_MODE_AUTO, mavlink.ROVER_MODE_GUIDED):
            base_mode |= mavlink.MAV_MODE_FLAG_GUIDED_ENABLED
        state = mavlink.MAV_STATE_ACTIVE if autopilot.armed else mavlink.MAV_STATE_STANDBY
        return mavlink.MAVLink_heartbeat_message(
            mavlink.MAV_TYPE_GROUND_ROVER,
            mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA,
            base_mode,
            autopilot.mode,
            mavlink.MAV_STATE_CRITICAL if autopilot.stranded else state,
            3,
        )

    def _place_e7(self) -> tuple[int, int]:
        lat_deg, lon_deg = self._world.globe(self._autopilot.position)
        return degrees_e7(lat_deg), degrees_e7(lon_deg)

    def _global_position(self, now_s: float) -> Any:
        heading = math.radians(self._autopilot.heading_deg)
        speed_cm_s = self._speed_cm_s()
        return mavlink.MAVLink_global_position_int_message(
            self._boot_ms(now_s), *self._place_e7(), self._alt_mm(), 0,
            round(speed_cm_s * math.cos(heading)), round(speed_cm_s * math.sin(heading)), 0,
            round(self._autopilot.heading_deg * 100.0) % 36000,
        )  # fmt: skip

    def _gps_raw(self, now_s: float) -> Any:
        fix = mavlink.GPS_FIX_TYPE_RTK_FIXED
        return mavlink.MAVLink_gps_raw_int_message(
            int(now_s * 1e6), fix, *self._place_e7(), self._alt_mm(), 60, 90,
            round(self._speed_cm_s()), round(self._autopilot.heading_deg * 100.0) % 36000, 18,
        )  # fmt: skip

    def _speed_cm_s(self) -> float:
        return min(self._autopilot.speed_m_s * 100.0, 2.0**15 - 1.0)

    def _alt_mm(self) -> int:
        return round(self._world.origin.alt_m * 1000.0)

    def _attitude(self, now_s: float) -> Any:
        yaw = math.remainder(math.radians(self._autopilot.heading_deg), math.tau)
        return mavlink.MAVLink_attitude_message(self._boot_ms(now_s), 0.0, 0.0, yaw, 0.0, 0.0, 0.0)

    def _hud(self, _: float) -> Any:
        speed_m_s = self._autopilot.speed_m_s
        return mavlink.MAVLink_vfr_hud_message(
            speed_m_s, speed_m_s, round(self._autopilot.heading_deg) % 360, 50 if speed_m_s > 0.0 else 0,
            self._world.origin.alt_m, 0.0,
        )  # fmt: skip

    def _sys_status(self, _: float) -> Any:
        # PREARM_CHECK is healthy before the position estimate is: not to be relied upon, as on a real one.
        return mavlink.MAVLink_sys_status_message(
            _ALL_SENSORS, _ALL_SENSORS, _HEALTHY, 100, round(NOMINAL_V * 1000.0), -1,
            self._percent(), 0, 0, 0, 0, 0, 0,
        )  # fmt: skip

    def _battery_status(self, _: float) -> Any:
        energy_j = self._autopilot.energy_since_boot_j
        return mavlink.MAVLink_battery_status_message(
            0, mavlink.MAV_BATTERY_FUNCTION_ALL, mavlink.MAV_BATTERY_TYPE_LION, 2500,
            [round(NOMINAL_V * 1000.0), *[2**16 - 1] * 9], -1,
            current_consumed=round(energy_j / NOMINAL_V / 3.6),
            energy_consumed=round(energy_j / 100.0),
            battery_remaining=self._percent(),
        )  # fmt: skip

    def _percent(self) -> int:
        return round(self._autopilot.battery_share * 100.0)

    def _mission_current(self, _: float) -> Any:
        autopilot = self._autopilot
        in_mission = autopilot.mode == mavlink.ROVER_MODE_AUTO
        return mavlink.MAVLink_mission_current_message(
            autopilot.run.seq, max(0, len(autopilot.store.items) - 1), mission_state(autopilot),
            1 if in_mission else 2,
        )  # fmt: skip

    def _ekf_status(self, _: float) -> Any:
        flags = _EKF_FROM_BOOT
        flags |= _EKF_WITH_POSITION if self._autopilot.ready_to_arm() else mavlink.EKF_CONST_POS_MODE
        return mavlink.MAVLink_ekf_status_report_message(flags, 0.1, 0.1, 0.1, 0.1, 0.0)

    def _system_time(self, now_s: float) -> Any:
        return mavlink.MAVLink_system_time_message(int(now_s * 1e6), self._boot_ms(now_s))

    def _energy(self, now_s: float) -> Any:
        return mavlink.MAVLink_named_value_float_message(
            self._boot_ms(now_s), ENERGY_NAME.encode(),
            self._autopilot.energy_since_boot_j / JOULES_PER_WATT_HOUR,
        )  # fmt: skip

    def _home_position(self, now_s: float) -> Any:
        home = self._autopilot.home_item()
        return mavlink.MAVLink_home_position_message(
            home.x, home.y, self._alt_mm(), 0.0, 0.0, 0.0, [1.0, 0.0, 0.0, 0.0], 0.0, 0.0, 0.0,
            int(now_s * 1e6),
        )  # fmt: skip

    def _global_origin(self, now_s: float) -> Any:
        origin = self._world.origin
        return mavlink.MAVLink_gps_global_origin_message(
            degrees_e7(origin.lat_deg), degrees_e7(origin.lon_deg), self._alt_mm(), int(now_s * 1e6)
        )

    def _version(self, _: float) -> Any:
        nothing = [0] * 8
        return mavlink.MAVLink_autopilot_version_message(
            _CAPABILITIES, _FIRMWARE, 0, 0, 0, nothing, nothing, nothing, 0, 0, self._system_id
        )


_DEFAULT_INTERVALS_S = {
    mavlink.MAVLINK_MSG_ID_HEARTBEAT: 1.0,
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 0.25,
    mavlink.MAVLINK_MSG_ID_ATTITUDE: 1.0,
    mavlink.MAVLINK_MSG_ID_VFR_HUD: 1.0,
    mavlink.MAVLINK_MSG_ID_SYS_STATUS: 1.0,
    mavlink.MAVLINK_MSG_ID_BATTERY_STATUS: 1.0,
    mavlink.MAVLINK_MSG_ID_MISSION_CURRENT: 1.0,
    mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT: 1.0,
    mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: 1.0,
    mavlink.MAVLINK_MSG_ID_SYSTEM_TIME: 2.0,
    mavlink.MAVLINK_MSG_ID_NAMED_VALUE_FLOAT: 0.5,
}
"""In seconds of the vehicle's own time, whatever the pace of the simulation."""
