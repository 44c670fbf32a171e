"""Whether ArduPilot Rover keeps and carries out mission items as they are meant, item by item.

The rules are those of the firmware, measured on its 4.7 development line; `malipp_field.vehicle.firmware` has
what it keeps of each command. Errors are what the vehicle refuses, hangs on, skips or does otherwise.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence

from malipp_field.mission.vehicles import ByScript, VehicleSettings
from malipp_field.vehicle import firmware
from malipp_field.vehicle import items as codes
from malipp_field.vehicle.finding import Finding, Spot
from malipp_field.vehicle.firmware import COMMANDS, INT16, Storage, command_name
from malipp_field.vehicle.items import MissionItem
from malipp_field.vehicle.layout import ACTION_CODES
from malipp_field.vehicle.steps import MAX_TAG

_SINGLE_PRECISION = 2.0**-22
_CENTIMETRE = 0.01
_NAN_AS_ZERO = {codes.MAV_CMD_NAV_WAYPOINT, codes.MAV_CMD_NAV_LOITER_UNLIM}
"""Commands whose param 4 may be NaN."""
_PULSE_US = (500, 2500)
_SERVOS, _RELAYS = 32, 16
_DRIVEN_BY = {1: "the steering", 3: "the throttle"}
_LONG_DELAY_S = 3600.0


def item_findings(
    items: Sequence[MissionItem],
    settings: VehicleSettings,
    robot: str | None = None,
    where: Mapping[int, str] | None = None,
) -> list[Finding]:
    """Return what this firmware would refuse, change, skip or hang on.

    Parameters
    ----------
    items
        A whole mission, home first.
    settings
        The vehicle: whether its payload script is on board, how many items it stores.
    robot, where
        Whose mission it is, and what items are for in words, by sequence number.
    """
    where = where or {}
    found = [*_whole(items, settings, Spot(robot))]
    script = has_script(settings)
    for index, item in enumerate(items):
        spot = Spot(robot, index, ", ".join(filter(None, (where.get(index), command_name(item.command)))))
        found += _numbering(index, item, spot)
        found += _refused(item, spot)
        if index:  # whatever item 0 says, home takes its place
            found += _kept(item, spot)
            found += _carried_out(item, spot, script=script)
    return found


def time_of_day(item: MissionItem) -> str | None:
    """Return until when (UTC) a NAV_DELAY waits; `None` for anything else, or where it says no such time."""
    hour, minute, second = item.param2, item.param3, item.param4
    if item.command != codes.MAV_CMD_NAV_DELAY or item.param1 > 0 or not _clock_time(item):
        return None
    return f"{max(hour, 0):02.0f}:{max(minute, 0):02.0f}:{max(second, 0):02.0f}"


def has_script(settings: VehicleSettings) -> bool:
    """Tell whether the payload script is on board."""
    profile = settings.payload
    return any(isinstance(m, ByScript) for m in (profile.collect, profile.drop, profile.pick, profile.unload))


def _whole(items: Sequence[MissionItem], settings: VehicleSettings, spot: Spot) -> Iterator[Finding]:
    surplus = len(items) - settings.max_items
    if surplus > 0:
        yield spot.error(
            "too-many-items",
            f"{len(items)} items with home, the vehicle stores {settings.max_items}: it refuses all of them",
            f"plan fewer stops (or actions of fewer items): {surplus} too many",
        )
    if not items or items[0].command != codes.MAV_CMD_NAV_WAYPOINT:
        yield Spot(spot.robot, 0, command_name(items[0].command) if items else "").error(
            "no-home",
            "home always takes the place of item 0: what is there now would be lost",
            "put home (NAV_WAYPOINT) before the first item",
        )
    marked = [item.seq for item in items if item.current]
    if len(marked) > 1:
        yield spot.warning(
            "current",
            f"{len(marked)} items are marked as current, some tools refuse that",
            "mark item 0 alone, or none",
        )


def _numbering(index: int, item: MissionItem, spot: Spot) -> Iterator[Finding]:
    if item.seq != index:
        yield spot.error(
            "sequence",
            f"its sequence number is {item.seq}, its place in the mission {index}",
            "number the items from 0 on without gaps",
        )
    if index and item.autocontinue != 1:
        yield spot.error(
            "autocontinue",
            "autocontinue 0 has no effect: the vehicle goes on by itself",
            "hold it by a NAV_LOITER_UNLIM after the item",
        )


def _refused(item: MissionItem, spot: Spot) -> Iterator[Finding]:
    """Yield what earns a refusal on upload, which leaves a mixed mission on the vehicle."""
    for number, value in enumerate(_params(item), start=1):
        nan_allowed = number == 4 and item.command in _NAN_AS_ZERO
        if math.isinf(value) or (math.isnan(value) and not nan_allowed):
            yield spot.error(
                "not-a-number",
                f"param{number} is {value}: refused with INVALID_PARAM{number}",
                "give a number",
            )
    if not abs(item.z) < firmware.MAX_ALTITUDE_M:
        yield spot.error("altitude", f"altitude {item.z:g} m is refused", "give metres above home, such as 0")
    command = COMMANDS.get(item.command)
    if command is None or command.place != "degrees":
        return
    if item.frame not in firmware.FRAMES_WITH_PLACE:
        yield spot.error(
            "frame", f"frame {item.frame} is refused for a place", "use frame 3 (relative to home), 0 or 10"
        )
    if abs(item.x) > 90e7 or abs(item.y) > 180e7:
        yield spot.error(
            "place",
            f"{item.x / 1e7:g}, {item.y / 1e7:g} is no place on earth",
            "give degrees times 1e7, latitude first",
        )


def _kept(item: MissionItem, spot: Spot) -> Iterator[Finding]:
    """Yield what would come back from the vehicle other than it was sent."""
    command = COMMANDS.get(item.command)
    if command is None:
        return
    for number, (param, value) in enumerate(zip(command.params, _params(item), strict=True), start=1):
        if math.isfinite(value):
            name = f"param{number}" + (f" ({param.name})" if param.name else "")
            yield from _loss(name, value, param.storage, spot)
    if command.place == "degrees":
        yield from _place(item, spot)
        return
    stored = INT16 if command.place == "raw" else firmware.NOTHING
    yield from _loss("x", item.x, stored, spot)
    yield from _loss("y", item.y, stored, spot)
    if math.isfinite(item.z):
        yield from _loss("z", item.z, firmware.NOTHING, spot)
    if item.frame != codes.MAV_FRAME_MISSION:
        yield spot.warning(
            "frame-without-place",
            f"frame {item.frame} for an item without a place: some tools take x and y for degrees",
            "use frame 2",
        )


def _loss(name: str, value: float, storage: Storage, spot: Spot) -> Iterator[Finding]:
    kept = storage.keep(value)
    if math.isclose(value, kept, rel_tol=_SINGLE_PRECISION):
        return
    problem, remedy = f"{name} {value:g} is kept as {kept:g}", f"give {storage.words}"
    if storage.rough and abs(kept - value) < 1.0 and not float(value).is_integer():
        yield spot.warning("rounded", problem, remedy)
    else:
        yield spot.error("truncated", problem, remedy)


def _place(item: MissionItem, spot: Spot) -> Iterator[Finding]:
    if item.x == item.y == 0:
        yield spot.warning(
            "zero-place",
            "latitude 0, longitude 0 means 'where the vehicle is': it does not go anywhere",
            "give the place, or leave the item out",
        )
    if abs(item.z) < firmware.MAX_ALTITUDE_M:
        kept_m = round(item.z / _CENTIMETRE) * _CENTIMETRE
        if not math.isclose(item.z, kept_m, abs_tol=1e-3):
            yield spot.warning(
                "rounded", f"altitude {item.z:g} m is kept as {kept_m:g} m", "give centimetres"
            )


def _carried_out(item: MissionItem, spot: Spot, *, script: bool) -> Iterator[Finding]:
    """Yield what the vehicle would not do, or not get past."""
    match item.command:
        case firmware.MAV_CMD_NAV_LAND | firmware.MAV_CMD_NAV_PAYLOAD_PLACE:
            yield spot.error("hangs", "can hang a Rover's mission for good", "take the item out")
        case firmware.MAV_CMD_DO_WINCH:
            yield spot.error(
                "skipped",
                "is skipped, and reported as reached all the same",
                "work the winch by a servo, a relay or the payload script",
            )
        case command if command not in COMMANDS:
            yield from _not_known(command, spot)
        case codes.MAV_CMD_NAV_DELAY:
            yield from _delay(item, spot)
        case codes.MAV_CMD_NAV_SCRIPT_TIME:
            yield from _script(item, spot, script=script)
        case _:
            yield from _output(item, spot)


def _not_known(command: int, spot: Spot) -> Iterator[Finding]:
    if command <= firmware.MAV_CMD_NAV_LAST:
        yield spot.error(
            "unknown-command",
            "is not known to work on a Rover, and the mission would wait for it",
            "take the item out, or drive by NAV_WAYPOINT",
        )
    else:
        yield spot.warning(
            "unknown-command",
            "is not known to work on a Rover: it may be refused or skipped",
            "take the item out, or try it on this vehicle first",
        )


def _delay(item: MissionItem, spot: Spot) -> Iterator[Finding]:
    if item.param1 == item.param2 == item.param3 == item.param4 == 0:
        yield spot.error(
            "delay-zero",
            "all zeros waits until 00:00:00 UTC",
            "give seconds in param1; no delay is 0, -1, -1, -1",
        )
        return
    seconds, clock = item.param1, (item.param2, item.param3, item.param4)
    if seconds > 0:
        if seconds > _LONG_DELAY_S:
            yield spot.warning("delay-long", f"waits {seconds:g} s", "check the seconds in param1")
        if clock not in {(-1, -1, -1), (0, 0, 0)}:
            yield spot.warning(
                "delay-conflict",
                "has seconds and a time of day: the time is ignored",
                "give -1 for hour, minute and second, or 0 for the seconds",
            )
    elif clock == (-1, -1, -1):
        if seconds:
            yield spot.error("delay-time", f"{seconds:g} s is no delay", "give seconds above 0")
    elif not _clock_time(item):
        hour, minute, second = clock
        yield spot.error(
            "delay-time",
            f"{hour:g}:{minute:g}:{second:g} is no time of day",
            "give hour (0 to 23), minute and second (0 to 59) in UTC",
        )


def _clock_time(item: MissionItem) -> bool:
    hour, minute, second = item.param2, item.param3, item.param4
    within = -1 <= hour <= 23 and -1 <= minute <= 59 and -1 <= second <= 59
    return within and max(hour, minute, second) >= 0


def _script(item: MissionItem, spot: Spot, *, script: bool) -> Iterator[Finding]:
    if not script and item.param2 == 0:
        yield spot.error(
            "no-script",
            "without a script on board it never ends",
            "say `payload: script` for this vehicle if it has the script, or take the item out",
        )
    elif not script:
        yield spot.error(
            "no-script",
            f"without a script on board it waits {item.param2:g} s and counts as done, with nothing done",
            "say `payload: script` for this vehicle if it has the script, or take the item out",
        )
    elif item.param2 != 0:
        yield spot.warning(
            "script-timeout",
            f"after {item.param2:g} s the vehicle goes on, done or not",
            "use timeout 0: the vehicle waits for the script",
        )
    if script and item.param1 not in ACTION_CODES.values():
        codes = ", ".join(f"{code} {action}" for action, code in ACTION_CODES.items())
        yield spot.error(
            "script-action", f"the payload script does not know action {item.param1:g}", f"use {codes}"
        )
    if script and not 0 <= item.x <= MAX_TAG:
        yield spot.error("script-tag", f"{item.x} is no container's tag", f"use 1 to {MAX_TAG}, 0 for none")


def _output(item: MissionItem, spot: Spot) -> Iterator[Finding]:
    """Yield outputs that are not there, or set to what they cannot do."""
    first, second = item.param1, item.param2
    if item.command == codes.MAV_CMD_DO_GRIPPER and second not in {0, 1}:
        yield spot.error(
            "hangs",
            f"gripper action {second:g} is taken and then hangs the autopilot",
            "use 0 (release) or 1 (grab)",
        )
    if item.command == codes.MAV_CMD_DO_SET_SERVO:
        if not _PULSE_US[0] <= second <= _PULSE_US[1]:
            yield spot.error(
                "servo-pulse",
                f"a pulse of {second:g} us goes out unchecked",
                f"use {_PULSE_US[0]} to {_PULSE_US[1]} us",
            )
        if not 1 <= first <= _SERVOS:
            yield spot.error("no-output", f"there is no servo output {first:g}", f"use 1 to {_SERVOS}")
        elif first in _DRIVEN_BY:
            yield spot.warning(
                "output-in-use",
                f"servo channel {first:g} is {_DRIVEN_BY[int(first)]} by default, and then not moved",
                f"use a free channel, or set SERVO{first:g}_FUNCTION to 0 where nothing is driven by it",
            )
    if item.command == codes.MAV_CMD_DO_SET_RELAY:
        if second not in {0, 1}:
            yield spot.error("relay-state", f"{second:g} is no state of a relay", "use 0 (off) or 1 (on)")
        if not 0 <= first < _RELAYS:
            yield spot.error("no-output", f"there is no relay {first:g}", f"use 0 to {_RELAYS - 1}")


def _params(item: MissionItem) -> tuple[float, float, float, float]:
    return item.param1, item.param2, item.param3, item.param4
