"""The payload script on a vehicle: carries out NAV_SCRIPT_TIME items and insists that the ground hears of it.

Param 1 is the action (`ACTION_CODES`), param 3 the number of the stop, param 4 the number of containers and x
the tag of the container. The actions of one stop share the service time beta evenly, however many they are,
so a stop takes exactly beta, as the paper's service window assumes. `WAIT` takes none of it. It ends when the
ground makes the next item current or, where y gives a time of day, by itself at that time. With an odd y any
other action that finds its container missing says so and lets the vehicle go on; half of y is the run.
"""

from __future__ import annotations

import math

from malipp_field.sim.motion import Position
from malipp_field.sim.world import World
from malipp_field.vehicle.items import MAV_CMD_NAV_SCRIPT_TIME, MissionItem
from malipp_field.vehicle.layout import ACTION_CODES, DAY_S, GATE_UNIT_S
from malipp_field.vehicle.payload_protocol import REPEAT_S, Result, format_confirmation
from malipp_field.vehicle.steps import Action

_ACTIONS = {code: action for action, code in ACTION_CODES.items()}


def action_of(item: MissionItem) -> Action | None:
    """Return the action an item asks for, or `None` when the script knows no such code."""
    return _ACTIONS.get(int(item.param1))


def goes_on_without(item: MissionItem) -> bool:
    """Tell whether a vehicle is to drive on where the container of an action is not there."""
    return item.y & 1 == 1


def gate_delay_s(code: int, now_s: float) -> float:
    """Return how long a gate stays shut unless the ground opens it; see `vehicle.layout.gate_code`.

    A time of day of the last twelve hours is past: unlike NAV_DELAY the script lets a vehicle pass that is
    late.
    """
    if code <= 0:
        return math.inf
    ahead_s = ((code - 1) * GATE_UNIT_S - now_s) % DAY_S
    return ahead_s if ahead_s <= DAY_S / 2 else 0.0


def actions_at_stop(items: list[MissionItem], seq: int) -> int:
    """Return how many payload actions share the stop of item ``seq``: its neighbours of the same number."""
    return 1 + _same_stop(items, seq, 1) + _same_stop(items, seq, -1)


def _same_stop(items: list[MissionItem], seq: int, direction: int) -> int:
    count, at = 0, seq + direction
    while 0 <= at < len(items) and items[at].command == MAV_CMD_NAV_SCRIPT_TIME:
        if items[at].param3 != items[seq].param3:
            break
        count += action_of(items[at]) is not Action.WAIT
        at += direction
    return count


class PayloadScript:
    """What is done to containers on one vehicle, and its confirmations not yet acknowledged.

    Parameters
    ----------
    robot_id
        Whose script it is.
    world
        Where containers really are.
    """

    def __init__(self, robot_id: str, world: World) -> None:
        self._robot_id = robot_id
        self._world = world
        self._number = 0
        self._unheard: dict[int, tuple[str, float | None]] = {}  # number: text, when it was last sent

    def duration_s(self, items: list[MissionItem], seq: int) -> float:
        """Return how long the action of item ``seq`` takes."""
        return self._world.mission.team.service_time_s / actions_at_stop(items, seq)

    def carry_out(self, action: Action, item: MissionItem, place: Position) -> Result:
        """Do the action of an item and put its confirmation on the list; return what came of it."""
        run = item.y >> 1
        self._world.begin_run(run)
        outcome = self._world.act(self._robot_id, action, item.x, place)
        self._number += 1
        text = format_confirmation(self._number, action, item.x, outcome.result, outcome.value, run)
        self._unheard[self._number] = text, None
        return outcome.result

    def acknowledge(self, number: int) -> None:
        """Strike off every confirmation up to that number; one never given is no acknowledgement."""
        if number <= self._number:
            self._unheard = {n: entry for n, entry in self._unheard.items() if n > number}

    def due(self, now_s: float) -> list[str]:
        """Return the texts to be sent now: those never sent, and those unheard for `REPEAT_S`."""
        texts = []
        for number, (text, sent_s) in self._unheard.items():
            if sent_s is None or now_s - sent_s >= REPEAT_S:
                self._unheard[number] = text, now_s
                texts.append(text)
        return texts
