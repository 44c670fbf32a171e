"""Mission commands as ArduPilot Rover keeps them (4.7 development line, measured).

Acceptance of an item says nothing about its execution: the firmware stores commands it will skip, commands
that hang it, and what is left of params after they were cut to their storage type.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from typing import Literal, NamedTuple

from malipp_field.vehicle.items import (
    MAV_CMD_DO_GRIPPER,
    MAV_CMD_DO_SET_RELAY,
    MAV_CMD_DO_SET_SERVO,
    MAV_CMD_NAV_DELAY,
    MAV_CMD_NAV_LOITER_UNLIM,
    MAV_CMD_NAV_SCRIPT_TIME,
    MAV_CMD_NAV_WAYPOINT,
)

MAV_CMD_NAV_LOITER_TIME = 19
MAV_CMD_NAV_RETURN_TO_LAUNCH = 20
MAV_CMD_NAV_LAND = 21
MAV_CMD_NAV_PAYLOAD_PLACE = 94
MAV_CMD_NAV_LAST = 95
MAV_CMD_CONDITION_DELAY = 112
MAV_CMD_DO_CHANGE_SPEED = 178
MAV_CMD_DO_SEND_SCRIPT_MESSAGE = 217
MAV_CMD_DO_WINCH = 42600

FRAMES_WITH_PLACE = frozenset({0, 3, 5, 6, 10, 11})
"""Absolute, relative to home, above terrain, and their older names, which are still taken."""
MAX_ALTITUDE_M = 2.0**15
_HALF_MAX = 65504.0


class Storage(NamedTuple):
    """How a number is kept.

    Attributes
    ----------
    words
        What can be kept, for a person.
    keep
        What comes back of a finite number.
    rough
        Whether losing a fraction is its normal precision, and no change of what was asked for.
    """

    words: str
    keep: Callable[[float], float]
    rough: bool = False


def _half(value: float) -> float:
    clipped = max(-_HALF_MAX, min(_HALF_MAX, value))
    return float(struct.unpack("e", struct.pack("e", clipped))[0])


def _single(value: float) -> float:
    return float(struct.unpack("f", struct.pack("f", value))[0]) if abs(value) < 3.4e38 else math.inf


def _signed(value: float, bits: int) -> float:
    return float((int(value) + 2 ** (bits - 1)) % 2**bits - 2 ** (bits - 1))


NOTHING = Storage("0: it is not kept", lambda _: 0.0)
UINT8 = Storage("a whole number from 0 to 255", lambda value: float(int(value) % 2**8))
UINT16 = Storage("a whole number from 0 to 65535", lambda value: float(int(value) % 2**16))
SECONDS16 = Storage("whole seconds from 0 to 65535", UINT16.keep, rough=True)
INT8 = Storage("a whole number from -128 to 127", lambda value: _signed(value, 8))
INT16 = Storage("a whole number from -32768 to 32767", lambda value: _signed(value, 16))
HALF = Storage("a half float: whole numbers up to 2048", _half, rough=True)
SINGLE = Storage("a single-precision number", _single)


class Param(NamedTuple):
    """One of the first four params of a command."""

    name: str
    storage: Storage


_NONE = Param("", NOTHING)


class Command(NamedTuple):
    """A command that this firmware is known to keep, with its four params.

    ``place`` says what x and y are: degrees, raw int16 numbers, or nothing that is kept.
    """

    name: str
    params: tuple[Param, ...]
    place: Literal["degrees", "raw", "none"] = "none"


def _command(name: str, *params: Param, place: Literal["degrees", "raw", "none"] = "none") -> Command:
    return Command(name, (*params, *[_NONE] * (4 - len(params))), place)


COMMANDS: dict[int, Command] = {
    MAV_CMD_NAV_WAYPOINT: _command("NAV_WAYPOINT", Param("hold, s", SECONDS16), place="degrees"),
    MAV_CMD_NAV_LOITER_UNLIM: _command("NAV_LOITER_UNLIM", Param("", UINT16), place="degrees"),
    MAV_CMD_NAV_LOITER_TIME: _command("NAV_LOITER_TIME", Param("time, s", SECONDS16), place="degrees"),
    MAV_CMD_NAV_RETURN_TO_LAUNCH: _command("NAV_RETURN_TO_LAUNCH"),
    MAV_CMD_NAV_DELAY: _command(
        "NAV_DELAY", Param("seconds", SINGLE), Param("hour UTC", INT8), Param("minute UTC", INT8),
        Param("second UTC", INT8),
    ),
    MAV_CMD_CONDITION_DELAY: _command("CONDITION_DELAY", Param("seconds", SINGLE)),
    MAV_CMD_DO_CHANGE_SPEED: _command(
        "DO_CHANGE_SPEED", Param("type", UINT8), Param("speed, m/s", SINGLE), Param("throttle", SINGLE)
    ),
    MAV_CMD_DO_SET_RELAY: _command("DO_SET_RELAY", Param("relay", UINT8), Param("state", UINT8)),
    MAV_CMD_DO_SET_SERVO: _command("DO_SET_SERVO", Param("channel", UINT8), Param("pulse, us", UINT16)),
    MAV_CMD_DO_GRIPPER: _command("DO_GRIPPER", Param("gripper", UINT8), Param("action", UINT8)),
    MAV_CMD_DO_SEND_SCRIPT_MESSAGE: _command(
        "DO_SEND_SCRIPT_MESSAGE", Param("id", UINT16), Param("", SINGLE), Param("", SINGLE), Param("", SINGLE)
    ),
    MAV_CMD_NAV_SCRIPT_TIME: _command(
        "NAV_SCRIPT_TIME", Param("action", UINT8), Param("timeout, s", UINT8), Param("stop", HALF),
        Param("count", HALF), place="raw",
    ),
    MAV_CMD_DO_WINCH: _command(
        "DO_WINCH", Param("winch", UINT8), Param("action", UINT8), Param("length, m", SINGLE),
        Param("rate, m/s", SINGLE),
    ),
}  # fmt: skip
"""What was measured. Anything else may be refused, skipped or worse."""

HANGS = {MAV_CMD_NAV_LAND: "NAV_LAND", MAV_CMD_NAV_PAYLOAD_PLACE: "NAV_PAYLOAD_PLACE"}
"""Commands that can stop a Rover's mission for good."""


def command_name(command: int) -> str:
    """Return the name of a command, or its number where it is not known here."""
    known = COMMANDS.get(command)
    return known.name if known else HANGS.get(command, f"command {command}")
