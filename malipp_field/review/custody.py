"""Custody as it was at any moment: loads on board, caches at nodes, tallies of depots."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field

from malipp_field.bus.messages import Confirmation
from malipp_field.record import Run
from malipp_field.vehicle.steps import Action


@dataclass
class Custody:
    """Counts that follow from the confirmations so far."""

    on_board: Counter[str] = field(default_factory=Counter)
    """Samples by robot."""
    lying: Counter[tuple[str, str]] = field(default_factory=Counter)
    """Samples by node and the robot that left them."""
    fetched: Counter[tuple[str, str, str]] = field(default_factory=Counter)
    """Samples by node, the robot that left them and the one that fetched them."""
    delivered: Counter[str] = field(default_factory=Counter)
    """Samples by depot."""
    left_by: dict[int, str] = field(default_factory=dict)
    """By tag, the robot that last dropped it."""

    def take_in(self, said: Confirmation) -> None:
        """Follow one successful payload action."""
        if said.action is Action.COLLECT:
            self.on_board[said.robot] += 1
        elif said.action is Action.DROP:
            self.on_board[said.robot] -= 1
            self.lying[said.node, said.robot] += 1
            self.left_by[said.tag] = said.robot
        elif said.action is Action.PICK:
            sender = self.left_by.get(said.tag, "?")
            self.on_board[said.robot] += 1
            self.lying[said.node, sender] -= 1
            self.fetched[said.node, sender, said.robot] += 1
        elif said.action is Action.UNLOAD:
            self.on_board[said.robot] -= 1
            self.delivered[said.node] += 1


def custody_over_time(run: Run) -> Iterator[tuple[Confirmation, Custody]]:
    """Yield every successful payload action with the custody after it (one object, updated in place)."""
    custody = Custody()
    for said in run.confirmations:
        if said.ok and said.action not in (Action.DRIVE, Action.WAIT):
            custody.take_in(said)
            yield said, custody


def loads(run: Run, robot: str) -> list[tuple[float, int]]:
    """Return (seconds since the Unix epoch, samples on board) after every payload action of a robot."""
    return [
        (said.time_s, custody.on_board[robot])
        for said, custody in custody_over_time(run)
        if said.robot == robot
    ]
