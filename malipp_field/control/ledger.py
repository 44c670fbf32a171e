"""The custody ledger: where every container is, whose sensor took it, and through which hands it went.

Custody is conserved: a record changes only by an action that its present state allows. A confirmation that
does not fit is refused with the reason and changes nothing. A sample that was taken although it was no longer
wanted is there all the same, and has to come home.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable

from malipp_field.bus import Confirmation, CustodyEvent, Ledger, SampleRecord
from malipp_field.vehicle.steps import Action, Sample


class CustodyLedger:
    """Records of all containers of a mission, by tag."""

    def __init__(self) -> None:
        self._records: dict[int, SampleRecord] = {}
        self._given_up: set[int] = set()
        self._early: dict[int, list[Confirmation]] = {}

    @property
    def records(self) -> dict[int, SampleRecord]:
        """All records by tag, in the order in which they were planned."""
        return dict(self._records)

    @property
    def next_tag(self) -> int:
        """The lowest tag no container of this mission has ever been promised."""
        return max(self._records, default=0) + 1

    @property
    def all_home(self) -> bool:
        """Whether every container that was taken is delivered."""
        return all(r.state in ("planned", "withdrawn", "delivered") for r in self._records.values())

    @property
    def given_up(self) -> list[int]:
        """Tags of samples that could not be taken where they were wanted."""
        return sorted(tag for tag in self._given_up if not self._records[tag].history)

    @property
    def barren(self) -> tuple[str, ...]:
        """Nodes at which a sample could not be taken."""
        return tuple(sorted({self._records[tag].sample.node for tag in self.given_up}))

    def gone(self, tags: Iterable[int]) -> list[int]:
        """Return those of ``tags`` that nobody is going to bring: missing, or not taken after all."""
        return [tag for tag in tags if tag in self._records and self._is_gone(self._records[tag])]

    @staticmethod
    def _is_gone(record: SampleRecord) -> bool:
        return record.state in ("lost", "withdrawn")

    def message(self, time_s: float) -> Ledger:
        """Return the ledger as it is published."""
        return Ledger(time_s=time_s, samples=tuple(self._records.values()))

    def expect(self, samples: Iterable[Sample]) -> None:
        """Promise ``samples`` and withdraw earlier promises that nobody is going to keep.

        A tag that was withdrawn stays known to `next_tag`: a container that carries it in the field must
        never be taken for another one.
        """
        promised = {sample.tag: sample for sample in samples}
        for tag, record in self._records.items():
            if record.state == "planned" and tag not in promised:
                self._records[tag] = record.model_copy(update={"state": "withdrawn"})
        for tag, sample in promised.items():
            known = self._records.get(tag)
            if known is None:
                self._records[tag] = SampleRecord(sample=sample, state="planned", holder=None)

    @property
    def unsettled(self) -> set[int]:
        """Tags that were picked by what one vehicle says, while another's drop has not been heard of yet."""
        return set(self._early)

    def confirm(self, confirmation: Confirmation) -> str | None:
        """Take in a payload action that was done; return why not, when it cannot have been.

        A vehicle that keeps its gate by time may be heard of before the one that left the container. What
        it says is kept until the drop is known.
        """
        tag = confirmation.tag
        record = self._records.get(tag)
        if record is None:
            return f"container {tag} is not known"
        refusal = _refusal(record, confirmation)
        if refusal is not None:
            carried = record.state == "on_board" and record.holder != confirmation.robot
            if tag in self._early or (carried and confirmation.action is Action.PICK):
                self._early.setdefault(tag, []).append(confirmation)
            return f"container {tag} {refusal}"
        self._enter(record, confirmation)
        for early in self._early.pop(tag, []):
            self.confirm(early)
        return None

    def _enter(self, record: SampleRecord, confirmation: Confirmation) -> None:
        state, holder = {
            Action.COLLECT: ("on_board", confirmation.robot),
            Action.DROP: ("cached", confirmation.node),
            Action.PICK: ("on_board", confirmation.robot),
            Action.UNLOAD: ("delivered", confirmation.node),
        }[confirmation.action]
        event = CustodyEvent(
            time_s=confirmation.time_s,
            action=confirmation.action,
            robot=confirmation.robot,
            node=confirmation.node,
        )
        changes: dict[str, object] = {"state": state, "holder": holder, "history": (*record.history, event)}
        if confirmation.action is Action.COLLECT:
            changes["value"] = confirmation.value
        self._records[confirmation.tag] = record.model_copy(update=changes)

    def miss(self, confirmation: Confirmation) -> None:
        """Take in an action that a vehicle went on without.

        What was to be taken is withdrawn. A container that should have been there, or on board, is missing,
        and stays where it was known last; one that is elsewhere by the ledger stays what it is.
        """
        record = self._records.get(confirmation.tag)
        if record is None or _refusal(record, confirmation) is not None:
            return
        collect = confirmation.action is Action.COLLECT
        if collect:
            self._given_up.add(confirmation.tag)
        state = "withdrawn" if collect else "lost"
        self._records[confirmation.tag] = record.model_copy(update={"state": state})

    def on_board(self, robot: str) -> tuple[int, ...]:
        """Return the tags on board a robot, in the order in which they came."""
        mine = [r for r in self._records.values() if r.state == "on_board" and r.holder == robot]
        return tuple(r.sample.tag for r in sorted(mine, key=lambda r: r.history[-1].time_s))

    def caches(self) -> dict[tuple[str, str], tuple[int, ...]]:
        """Return the tags lying at nodes, by (node, robot that left them)."""
        found: dict[tuple[str, str], list[int]] = defaultdict(list)
        for record in self._records.values():
            if record.state == "cached":
                last = record.history[-1]
                found[(last.node, last.robot)].append(record.sample.tag)
        return {place: tuple(tags) for place, tags in found.items()}

    def dropped_at(self, tag: int) -> CustodyEvent | None:
        """Return the drop after which a container lies at a node now; `None` when it does not."""
        record = self._records.get(tag)
        return record.history[-1] if record is not None and record.state == "cached" else None

    def collected_by(self, robot: str) -> dict[str, int]:
        """Return how many samples a robot's sensor has taken so far, by node."""
        counts: dict[str, int] = defaultdict(int)
        for record in self._records.values():
            if record.sample.sampler == robot and record.history:
                counts[record.sample.node] += 1
        return dict(counts)

    def promised_to(self, robot: str) -> dict[str, tuple[int, ...]]:
        """Return the tags that a robot is still to collect, by node."""
        found: dict[str, list[int]] = defaultdict(list)
        for record in self._records.values():
            if record.state == "planned" and record.sample.sampler == robot:
                found[record.sample.node].append(record.sample.tag)
        return {node: tuple(tags) for node, tags in found.items()}


def _refusal(record: SampleRecord, confirmation: Confirmation) -> str | None:
    """Return why an action cannot have been done to a container in its present state."""
    found = record.state == "lost" and confirmation.action is Action.PICK
    needed = {
        Action.COLLECT: ("withdrawn" if record.state == "withdrawn" else "planned", None),
        Action.DROP: ("on_board", confirmation.robot),
        Action.PICK: ("lost" if found else "cached", confirmation.node),
        Action.UNLOAD: ("on_board", confirmation.robot),
    }.get(confirmation.action)
    if needed is None:
        return f"cannot be {confirmation.action}ed"
    if (record.state, record.holder) != needed:
        held = f" by {record.holder}" if record.holder else ""
        return (
            f"is {record.state.replace('_', ' ')}{held}: {confirmation.robot} cannot "
            f"{confirmation.action} it at {confirmation.node}"
        )
    if confirmation.action is Action.COLLECT and record.sample.sampler != confirmation.robot:
        return f"was promised to {record.sample.sampler}, not to {confirmation.robot}"
    return None
