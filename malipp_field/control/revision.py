"""From a new plan for the rest of a mission to new missions for exactly those vehicles it concerns."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from malipp_field.control.ledger import CustodyLedger
from malipp_field.control.lookahead import Outlook
from malipp_field.mission import Mission
from malipp_field.plan import Plan
from malipp_field.vehicle.compile import Custody, compile_plan
from malipp_field.vehicle.layout import lay_out
from malipp_field.vehicle.steps import Action, Sample, Step, VehicleMission

_SAME_TIME_S = 1.0


@dataclass(frozen=True)
class Revision:
    """A new plan and what it means for the fleet.

    Attributes
    ----------
    compiled
        The free part of each robot's mission, from the new plan alone.
    missions
        The missions that vehicles concerned are to carry out: committed steps, then the free part. One
        vehicle alone keeps what it has done before them: so the leg it drives keeps its item number, which it
        must to be given its mission under way.
    kept
        How many steps of each of these missions come before the free part.
    samples
        Every container that the new plan still wants collected.
    """

    plan: Plan
    outlook: Outlook
    compiled: dict[str, VehicleMission]
    missions: dict[str, VehicleMission]
    kept: dict[str, int]
    samples: dict[int, Sample]


def revise(
    mission: Mission,
    plan: Plan,
    outlook: Outlook,
    ledger: CustodyLedger,
    in_force: Mapping[str, VehicleMission],
    start_s: float | None = None,
) -> Revision:
    """Compile ``plan`` and compare it with the missions in force.

    Containers that were promised already keep their tags, so that a vehicle whose part of the plan is what
    it was is not touched. ``start_s`` is when mission time 0 was.
    """
    custody = Custody(
        on_board=outlook.on_board,
        caches=outlook.caches,
        promised=outlook.promised,
        next_tag=ledger.next_tag,
    )
    run = max(old.run for old in in_force.values())  # they have one and the same
    compiled = compile_plan(mission, plan, custody, start_s, run)
    missions, past = {}, {}
    for robot_id, part in compiled.missions.items():
        old = in_force[robot_id]
        diverges_at = outlook.diverges_at[robot_id]
        first_free = len(old.steps) if diverges_at is None else old.index_of(diverges_at)
        assert first_free is not None
        if not same_work(old.steps[first_free:], part.steps):
            committed = outlook.committed[robot_id]
            past[robot_id] = old.steps[: first_free - len(committed)]
            steps = (*committed, *part.steps) or (_stay(robot_id, old, diverges_at, plan),)
            missions[robot_id] = part.model_copy(update={"steps": steps})
    committed_tags = {tag for steps in outlook.committed.values() for step in steps for tag in step.tags}
    still_to_collect = {
        tag: record.sample
        for tag, record in ledger.records.items()
        if tag in committed_tags and record.state == "planned"
    }
    kept = {robot_id: len(outlook.committed[robot_id]) for robot_id in missions}
    if len(missions) == 1:
        (robot_id,) = missions
        whole = missions[robot_id].model_copy(update={"steps": (*past[robot_id], *missions[robot_id].steps)})
        if len(lay_out(whole).items) <= mission.vehicle(robot_id).max_items:
            missions[robot_id] = whole
            kept[robot_id] += len(past[robot_id])
    samples = {**still_to_collect, **compiled.samples}
    return Revision(plan, outlook, compiled.missions, missions, kept, samples)


def same_work(old: Sequence[Step], new: Sequence[Step]) -> bool:
    """Whether two sequences of steps make a vehicle do the same, and nothing of it too early.

    A gate that is now to stay shut for longer than the vehicle knows of is another one; one that may open
    sooner is not: the coordinator opens it.
    """

    def work(steps: Sequence[Step]) -> list[tuple[object, ...]]:
        return [(step.action, step.node, step.tags, step.peer, step.if_missing) for step in steps]

    return work(old) == work(new) and not any(map(_opens_too_early, old, new))


def _opens_too_early(old: Step, new: Step) -> bool:
    if old.not_before_s is None:
        return False
    return new.not_before_s is None or new.not_before_s > old.not_before_s + _SAME_TIME_S


def _stay(robot_id: str, old: VehicleMission, diverges_at: str | None, plan: Plan) -> Step:
    """Return the only step of a vehicle that is to stay at its gate: autopilots refuse an empty mission."""
    here = next(step for step in old.steps if step.uid == diverges_at)
    return here.model_copy(
        update={"uid": f"v{plan.version}/{robot_id}/0/stay", "action": Action.DRIVE, "tags": (), "peer": None}
    )
