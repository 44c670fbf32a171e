"""When a vehicle that waits for a teammate's drop may pass, and letting it pass."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Mapping

from malipp_field.bus import CustodyEvent
from malipp_field.clock import Clock
from malipp_field.control.dispatch import Dispatch
from malipp_field.control.ledger import CustodyLedger
from malipp_field.control.strays import Say
from malipp_field.control.tracks import Track
from malipp_field.vehicle.steps import Action, Step

_AGAIN_S = 5.0  # a gate that is still shut so long after it was to open is tried again


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


class GateKeeper:
    """Lets vehicles pass the gates they stand at.

    Each is let pass on its own: one that is slow to answer keeps no other waiting, nor the coordinator.

    Parameters
    ----------
    clearance_s
        From the departure of whom brought a container until another may fetch it.
    """

    def __init__(
        self,
        tracks: Mapping[str, Track],
        ledger: CustodyLedger,
        dispatch: Dispatch,
        clock: Clock,
        clearance_s: float,
        say: Say,
    ) -> None:
        self._tracks, self._ledger, self._dispatch = tracks, ledger, dispatch
        self._clock, self._clearance_s, self._say = clock, clearance_s, say
        self._due_s: dict[str, float] = {}  # from when on each gate may be told to open again
        self._opening: dict[str, asyncio.Task[None]] = {}

    @property
    def busy(self) -> bool:
        """Whether a vehicle has been told to pass and its answer is not there yet."""
        return any(not task.done() for task in self._opening.values())

    def open_all(self) -> None:
        """Tell all to pass whose containers lie ready; call it often."""
        now_s = self._clock.now_s()
        for robot, track in self._tracks.items():
            before, step = self._opening.get(robot), self._free_gate(robot, track)
            if before is not None:
                if not before.done():
                    continue
                before.result()  # a fault of ours is not to pass unseen
            if step is not None and now_s >= self._due_s.get(step.uid, -math.inf):
                self._opening[robot] = asyncio.create_task(self._open(robot, step))

    def _free_gate(self, robot: str, track: Track) -> Step | None:
        """Return the gate at which a vehicle stands and which it may pass; without its mission it cannot."""
        step = track.step
        if (
            step is None
            or step.action is not Action.WAIT
            or not track.reports(step)
            or track.lost_s is not None
        ):
            return None
        now_s = self._clock.now_s()
        return step if may_pass(robot, step, self._ledger, self._tracks, now_s, self._clearance_s) else None

    async def _open(self, robot: str, step: Step) -> None:
        refusal = await self._dispatch.release(robot, step.uid)
        self._due_s[step.uid] = self._clock.now_s() + _AGAIN_S
        if refusal is None:
            self._tracks[robot].confirm(step.uid)
        else:
            self._say("warning", f"gate at {step.node} does not open: {refusal}", robot)

    async def close(self) -> None:
        """Wait for no answer any more."""
        for task in self._opening.values():
            task.cancel()
        await asyncio.gather(*self._opening.values(), return_exceptions=True)
