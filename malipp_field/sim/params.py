"""The parameters a ground station expects of a Rover, and ArduPilot's parameter protocol.

They are kept and survive a restart, as on a vehicle. Of them MIS_RESTART, MAV_GCS_SYSID, those of the
ground station failsafe (FS_GCS_ENABLE, FS_GCS_TIMEOUT, FS_TIMEOUT, FS_ACTION) and those of the outputs
(SERVOn_FUNCTION, RELAYn_FUNCTION, GRIP_ENABLE) change what this rover does.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from malipp_field.errors import MalippError

_INT8, _INT16, _INT32, _REAL32 = (
    mavlink.MAV_PARAM_TYPE_INT8,
    mavlink.MAV_PARAM_TYPE_INT16,
    mavlink.MAV_PARAM_TYPE_INT32,
    mavlink.MAV_PARAM_TYPE_REAL32,
)
_RANGES = {_INT8: (-(2**7), 2**7 - 1), _INT16: (-(2**15), 2**15 - 1), _INT32: (-(2**31), 2**31 - 1)}

_ROVER: dict[str, tuple[float, int]] = {
    "ARMING_CHECK": (1, _INT32),
    "ARMING_REQUIRE": (1, _INT8),
    "BATT_CAPACITY": (3300, _INT32),
    "BATT_MONITOR": (4, _INT8),
    "CRUISE_SPEED": (2.0, _REAL32),
    "CRUISE_THROTTLE": (50, _INT8),
    "FENCE_ENABLE": (0, _INT8),
    "FRAME_CLASS": (1, _INT8),
    "FRAME_TYPE": (0, _INT8),
    "FS_ACTION": (2, _INT8),
    "FS_EKF_ACTION": (1, _INT8),
    "FS_GCS_ENABLE": (0, _INT8),
    "FS_GCS_TIMEOUT": (5.0, _REAL32),
    "FS_THR_ENABLE": (1, _INT8),
    "FS_TIMEOUT": (1.5, _REAL32),
    "INITIAL_MODE": (0, _INT8),
    "MAV_GCS_SYSID": (255, _INT16),
    "MAV_SYSID": (1, _INT16),
    "MIS_DONE_BEHAVE": (0, _INT8),
    "MIS_OPTIONS": (0, _INT16),
    "MIS_RESTART": (0, _INT8),
    "RTL_SPEED": (0.0, _REAL32),
    "SCR_ENABLE": (1, _INT8),
    "SCR_HEAP_SIZE": (204800, _INT32),
    "TURN_RADIUS": (0.9, _REAL32),
    "WP_RADIUS": (2.0, _REAL32),
    "WP_SPEED": (2.0, _REAL32),
    "GRIP_ENABLE": (1, _INT8),
    **{f"SERVO{n}_FUNCTION": ({1: 26, 3: 70}.get(n, 0), _INT16) for n in range(1, 17)},
    **{f"RELAY{n}_FUNCTION": (1, _INT8) for n in range(1, 17)},
}
"""Defaults of a Rover that is set up for any payload: a gripper, relays, and servo outputs but 1 and 3."""


class Parameters:
    """The parameter table of one vehicle.

    Parameters
    ----------
    changed
        Values that differ from the defaults, by name.

    Raises
    ------
    MalippError
        For a name it does not have.
    """

    def __init__(self, **changed: float) -> None:
        for name in changed.keys() - _ROVER.keys():
            raise MalippError(
                f"simulation.parameters: a simulated rover has no '{name}'; it has {', '.join(_ROVER)}"
            )
        self._values = {name: float(value) for name, (value, _) in _ROVER.items()} | changed
        self._names = list(self._values)

    def get(self, name: str, otherwise: float) -> float:
        """Return a value, or ``otherwise`` for a name it does not have."""
        return self._values.get(name, otherwise)

    def __getitem__(self, name: str) -> float:
        return self._values[name]

    def receive(self, message: Any) -> list[Any]:
        """Handle one message of the parameter protocol; a name or index unknown gets no answer."""
        match message.get_type():
            case "PARAM_REQUEST_LIST":
                return [self._value(name) for name in self._names]
            case "PARAM_REQUEST_READ" if 0 <= message.param_index < len(self._names):
                return [self._value(self._names[message.param_index])]
            case "PARAM_REQUEST_READ" if message.param_id in self._values:
                return [self._value(message.param_id)]
            case "PARAM_SET" if message.param_id in self._values:
                return self._set(message.param_id, message.param_value)
        return []

    def _set(self, name: str, value: float) -> list[Any]:
        if np.isfinite(value):
            self._values[name] = _as_stored(value, _ROVER[name][1])
        return [self._value(name)]

    def _value(self, name: str) -> Any:
        """Return PARAM_VALUE; ArduPilot sends whole numbers as floats of that value, not as their bits."""
        return mavlink.MAVLink_param_value_message(
            name.encode(), self._values[name], _ROVER[name][1], len(self._names), self._names.index(name)
        )


def _as_stored(value: float, kind: int) -> float:
    if kind not in _RANGES:
        return float(np.float32(value))
    low, high = _RANGES[kind]
    return float(np.clip(round(value), low, high))
