"""What the payload script on a vehicle and the agent say to each other, inside ordinary MAVLink messages.

"Reached" is no proof that an action was done, and messages get lost. So the script numbers what it has to
say from 1, without gaps since it was started, as STATUSTEXT (severity INFO) ::

    MLP <number> <action> <tag> ok [k=<run>] [v=<reading>]
    MLP <number> <action> <tag> missing|full|unknown [k=<run>]

and repeats each text every `REPEAT_S` seconds until the agent has acknowledged it by a NAMED_VALUE_INT called
`ack_name`, whose value is the highest number that has arrived in order; while many are unheard it may repeat
only the first of them. The run is that of the item that asked: what was left unheard in the morning confirms
nothing of the afternoon's mission, which has the same tags. It reports the energy drawn since it was started
(watt-hours) as NAMED_VALUE_FLOAT called `ENERGY_NAME`.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import Literal, cast

from malipp_field.vehicle.steps import Action

ENERGY_NAME = "MLP_WH"
REPEAT_S = 1.0
JOULES_PER_WATT_HOUR = 3600.0

MAX_TEXT = 50
"""Characters of one STATUSTEXT; every confirmation fits into one."""

_MOST_DIGITS = 9  # of a reading: as many as a single-precision number has

Result = Literal["ok", "missing", "full", "unknown"]

_PATTERN = re.compile(
    r"MLP (?P<number>[1-9][0-9]{0,9}) (?P<action>[a-z]+) (?P<tag>[0-9]{1,5})"
    r" (?P<result>ok|missing|full|unknown)"
    r"(?: k=(?P<run>[1-9][0-9]{0,4}))?(?: v=(?P<value>\S+))?"
)


@dataclass(frozen=True)
class PayloadReport:
    """One confirmation of the payload script.

    Attributes
    ----------
    number
        Counts the confirmations since the script was started, from 1 and without gaps.
    result
        ``ok``; ``missing``: the container is not where it should be; ``full``: no room for another;
        ``unknown``: an action or container the script knows nothing of.
    value
        In-situ reading of a collected sample, in the field's unit; to as many digits as there is room for.
    run
        Of the mission that asked for the action (`VehicleMission.run`); 0 where it told none.
    """

    number: int
    action: Action
    tag: int
    result: Result
    value: float | None = None
    run: int = 0

    @property
    def ok(self) -> bool:
        """Whether the action is done."""
        return self.result == "ok"


def format_confirmation(
    number: int, action: Action, tag: int, result: Result, value: float | None = None, run: int = 0
) -> str:
    """Return the text of a confirmation, at most `MAX_TEXT` characters: a reading is rounded to fit."""
    text = f"MLP {number} {action} {tag} {result}" + (f" k={run}" if run else "")
    if value is None:
        return text
    roundings = (f"{text} v={value:.{digits}g}" for digits in range(_MOST_DIGITS, 0, -1))
    return next(rounded for rounded in roundings if len(rounded) <= MAX_TEXT)


def parse_confirmation(text: str) -> PayloadReport | None:
    """Return what a STATUSTEXT confirms, or `None` when it is not a well-formed confirmation."""
    match = _PATTERN.fullmatch(text.rstrip("\0 "))
    if match is None or match["action"] not in set(Action):
        return None
    value = _finite(match["value"])
    if match["value"] is not None and value is None:
        return None
    return PayloadReport(
        int(match["number"]),
        Action(match["action"]),
        int(match["tag"]),
        cast(Result, match["result"]),
        value,
        int(match["run"] or 0),
    )


def ack_name(system_id: int) -> str:
    """Return the name under which a vehicle is told what of it has arrived.

    NAMED_VALUE_INT is addressed to nobody in particular, and vehicles share radios. A name has 10 characters.
    """
    return f"MLP_ACK{system_id}"


def _finite(text: str | None) -> float | None:
    """Return the number that ``text`` says, or `None` where it says none."""
    try:
        value = float(text) if text is not None else math.nan
    except ValueError:
        return None
    return value if math.isfinite(value) else None
