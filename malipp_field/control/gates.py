"""When a vehicle that waits for a teammate's drop may pass."""

from __future__ import annotations

from collections.abc import Mapping

from malipp_field.bus import CustodyEvent
from malipp_field.control.ledger import CustodyLedger
from malipp_field.control.tracks import Track
from malipp_field.vehicle.steps import Action, Step


def may_pass(
    robot: str,
    gate: Step,
    ledger: CustodyLedger,
    tracks: Mapping[str, Track],
    now_s: float,
    clearance_s: float,
) -> bool:
    """Tell whether all containers lie ready at the gate, their senders have gone, and the clearance is over.

    One that goes through several hands may still lie where it was left first. Containers that the vehicle
    has on board already do not matter. This is the receiver's side of
    `eq:deaddrop_sync`, by what has happened and not by the plan's times.
    """
    on_board = ledger.on_board(robot)
    for tag in gate.tags:
        if tag in on_board:
            continue
        drop = ledger.dropped_at(tag)
        if drop is None or drop.node != gate.node or now_s < _clear_s(drop, tracks[drop.robot], clearance_s):
            return False
    return True


def _clear_s(drop: CustodyEvent, sender: Track, clearance_s: float) -> float:
    """Return when a container that lies at a node may be fetched, on the team's clock."""
    step = sender.step
    if step is not None and step.node == drop.node and step.action not in (Action.DRIVE, Action.WAIT):
        return float("inf")  # its service there is not over
    departed_s = sender.changed_s if sender.last_node == drop.node else drop.time_s
    return max(drop.time_s, departed_s) + clearance_s
