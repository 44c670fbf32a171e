"""The first missions of a team, on all vehicles before any of them moves."""

from __future__ import annotations

from collections.abc import Mapping

from malipp_field.clock import Clock
from malipp_field.control.dispatch import Dispatch
from malipp_field.control.tracks import Track
from malipp_field.mission import Mission
from malipp_field.plan import Plan
from malipp_field.vehicle.check import check
from malipp_field.vehicle.check_fence import OF_FENCE
from malipp_field.vehicle.compile import compile_plan
from malipp_field.vehicle.steps import VehicleMission

_LOADING_S = 10.0  # from when gates are told mission time 0 to when all vehicles are verified


def busy(tracks: Mapping[str, Track]) -> dict[str, VehicleMission]:
    """Return the missions of all vehicles that have something to do."""
    return {robot: track.mission for robot, track in tracks.items() if track.mission.steps}


async def load_first(
    mission: Mission, plan: Plan, tracks: Mapping[str, Track], dispatch: Dispatch, clock: Clock
) -> tuple[float, dict[str, str]]:
    """Load the first missions; return when mission time 0 is (now, on the team's clock), and the refusals.

    What the check before an upload finds to be wrong is a refusal, before anything is sent.
    Gates that open by time must know mission time 0 beforehand. Where loading takes longer than foreseen,
    they are told anew: else they would open too early.
    """
    faults = _faults(mission, plan, clock.now_s())
    if faults:
        return clock.now_s(), faults
    if not any(step.not_before_s is not None for m in busy(tracks).values() for step in m.steps):
        refusals = await dispatch.load(busy(tracks))
        return clock.now_s(), refusals
    allowed_s = _LOADING_S
    while True:
        start_s = clock.now_s() + allowed_s
        run = max(track.mission.run for track in tracks.values())  # they have one and the same
        compiled = compile_plan(mission, plan, start_s=start_s, run=run)
        for robot, track in tracks.items():
            track.mission = compiled.missions[robot]
        refusals = await dispatch.load(busy(tracks))
        early_s = start_s - clock.now_s()
        if refusals or early_s >= 0.0:
            await clock.sleep(0.0 if refusals else early_s)
            return start_s, refusals
        allowed_s = 2.0 * (allowed_s - early_s)


def _faults(mission: Mission, plan: Plan, start_s: float) -> dict[str, str]:
    """Return what is wrong with the missions, the first fault of each vehicle (or of the team).

    How large the fence is does not matter: a launch sends none.
    """
    found: dict[str, str] = {}
    for finding in check(mission, plan, start_s):
        if finding.severity == "error" and finding.rule not in OF_FENCE:
            found.setdefault(
                finding.robot or "team", f"not to be uploaded: {finding.problem}; {finding.remedy}"
            )
    return found
