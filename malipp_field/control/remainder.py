"""What is left of a plan: the warm start for planning the rest of a mission anew."""

from __future__ import annotations

from collections.abc import Mapping

from malipp_field.control.lookahead import Outlook
from malipp_field.control.tracks import Track
from malipp_field.plan import Plan, RobotPlan, Stop
from malipp_field.vehicle.steps import Action


def remainder(plan: Plan, tracks: Mapping[str, Track], outlook: Outlook) -> Plan:
    """Return the stops in force that are not committed, from the nodes where the free parts begin.

    A vehicle that the last plan left alone still follows the route of an earlier one. Stops and operations
    are as planned; times and energies are those of old and no longer right, so this is advice to a solver,
    not a plan to be carried out.
    """
    return plan.model_copy(
        update={"robots": tuple(_rest(track.route, track, outlook) for track in tracks.values())}
    )


def _rest(route: RobotPlan, track: Track, outlook: Outlook) -> RobotPlan:
    state = outlook.state.robot(route.id)
    diverges_at = outlook.diverges_at[route.id]
    here = Stop(node=state.node, depart_s=state.ready_s, payload=state.on_board)
    if diverges_at is None:
        return RobotPlan(id=route.id, route=(here,))
    index = track.mission.index_of(diverges_at)
    assert index is not None, "the outlook was taken of the mission in force"
    if index < track.committed:  # not yet where the route in force begins
        begin = route.route[0]
        if begin.node == state.node:
            here = begin
        elif begin.collect or begin.drop or begin.pick or begin.unload:
            return RobotPlan(id=route.id, route=(here, *route.route))
        return RobotPlan(id=route.id, route=(here, *route.route[1:]))
    first = track.mission.steps[index]
    later = route.route[first.stop :]
    if first.action is Action.DRIVE:
        return RobotPlan(id=route.id, route=(here, *later))
    # The free part begins within a stop: what is left to do there is done at the new start.
    done = [
        step
        for step in track.mission.steps[track.committed : index]
        if step.stop == first.stop and step.action is not Action.DRIVE
    ]
    stop = later[0]
    here = stop.model_copy(
        update={
            "path": None,
            "arrive_s": None,
            "leg_energy_j": None,
            "collect": stop.collect - sum(s.action is Action.COLLECT for s in done),
            "unload": stop.unload - sum(s.action is Action.UNLOAD for s in done),
            "drop": _without(stop.drop, [s.peer for s in done if s.action is Action.DROP]),
            "pick": _without(stop.pick, [s.peer for s in done if s.action is Action.PICK]),
        }
    )
    return RobotPlan(id=route.id, route=(here, *later[1:]))


def _without(transfers: dict[str, int], done: list[str | None]) -> dict[str, int]:
    left = {peer: count - done.count(peer) for peer, count in transfers.items()}
    return {peer: count for peer, count in left.items() if count > 0}
