"""Whether the outputs that a mission works are set up on the vehicle: one that is not does nothing.

Nor does a mission learn of it: a Rover says so in a text at best, and goes on to the next item.
Source: ArduPilot, AP_ServoRelayEvents, AP_Relay, AP_Gripper.
"""

from __future__ import annotations

import asyncio
import re
from collections.abc import Iterable, Sequence
from typing import NamedTuple

from malipp_field.errors import LinkError
from malipp_field.link.driver import Driver
from malipp_field.link.parameters import ParameterRead
from malipp_field.vehicle.items import (
    MAV_CMD_DO_GRIPPER,
    MAV_CMD_DO_SET_RELAY,
    MAV_CMD_DO_SET_SERVO,
    MissionItem,
)

ANSWER_LIMIT_S = 5.0
"""So long is waited for parameters: a firmware that does not have one gives no answer."""
FREE_FUNCTIONS = frozenset({0, 1, 22, 23, 28, *range(51, 67)})
"""SERVOn_FUNCTION with which a channel obeys DO_SET_SERVO: disabled, passed through, sprayer, gripper."""

_REFUSED = re.compile(r"ServoRelayEvent: Channel (\d+) is already in use")


class Need(NamedTuple):
    """What a parameter must be for an output to work."""

    parameter: str
    values: frozenset[int]
    right: str


def needs(items: Iterable[MissionItem]) -> list[Need]:
    """Return what the outputs that a mission works need, each once."""
    found = {need: None for item in items for need in _of(item)}
    return list(found)


def _of(item: MissionItem) -> list[Need]:
    number = int(item.param1)
    if item.command == MAV_CMD_DO_SET_SERVO:
        return [Need(f"SERVO{number}_FUNCTION", FREE_FUNCTIONS, "0 (no function of its own)")]
    if item.command == MAV_CMD_DO_SET_RELAY:
        return [Need(f"RELAY{number + 1}_FUNCTION", frozenset({1}), f"1 (relay {number})")]
    if item.command == MAV_CMD_DO_GRIPPER:
        return [Need("GRIP_ENABLE", frozenset({1}), "1")]
    return []


async def check_outputs(driver: Driver, wanted: Sequence[Need]) -> str | None:
    """Read the parameters of outputs, and see that they are as they must be.

    Returns
    -------
    str or None
        A warning that names the parameters that the vehicle did not tell: older firmware has others.

    Raises
    ------
    LinkError
        When one is not as it must be: an action would do nothing, and count as done.
    """
    values = await _read(driver, [need.parameter for need in wanted])
    wrong = [
        f"{need.parameter} is {value:g} and must be {need.right}"
        for need, value in zip(wanted, values, strict=True)
        if value is not None and value not in need.values
    ]
    if wrong:
        raise LinkError(f"outputs of its payload would do nothing: {'; '.join(wrong)}")
    untold = [need.parameter for need, value in zip(wanted, values, strict=True) if value is None]
    return f"it does not tell {', '.join(untold)}: try its payload on the bench" if untold else None


async def _read(driver: Driver, names: Sequence[str]) -> list[float | None]:
    """Read parameters at once; None for what is not answered in time."""
    reads = [ParameterRead([name], *driver.vehicle.address, *driver.own) for name in names]
    tasks = [asyncio.create_task(driver.run(read)) for read in reads]
    try:
        await driver.until(lambda: all(read.ended for read in reads), ANSWER_LIMIT_S)
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
    return [read.value if read.done else None for read in reads]


def refused_channel(text: str) -> int | None:
    """Return the servo channel that a text of the autopilot says it did not set; `None` in any other."""
    match = _REFUSED.search(text)
    return None if match is None else int(match[1])
