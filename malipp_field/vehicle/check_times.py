"""Whether a vehicle keeps its times: what actions take, gates by the clock, and people it waits for."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping
from datetime import UTC, datetime

from malipp_field.mission import Mission
from malipp_field.mission.vehicles import ByGripper, ByRelay, ByScript, ByServo
from malipp_field.vehicle.finding import Finding, Spot
from malipp_field.vehicle.gate_times import GateTime
from malipp_field.vehicle.layout import Layout, held_for_operator, means_of
from malipp_field.vehicle.steps import Action, Step, VehicleMission
from malipp_field.vehicle.stops import Place


def service_findings(mission: Mission, vehicle: VehicleMission) -> Iterator[Finding]:
    """Yield the stop whose outputs take longest, where that is longer than the plan's service time."""
    taken_s: dict[tuple[int, str], float] = defaultdict(float)
    for step in vehicle.steps:
        means = means_of(vehicle, step)
        if isinstance(means, ByServo | ByRelay | ByGripper):
            taken_s[step.stop, step.node] += means.duration_s
    service_s = mission.team.service_time_s
    late = {stop: seconds for stop, seconds in taken_s.items() if seconds > service_s}
    if not late:
        return
    (stop, node), longest_s = max(late.items(), key=lambda entry: entry[1])
    total_s = sum(seconds - service_s for seconds in late.values())
    yield Spot(vehicle.robot, None, f"stop {stop} at {node}").warning(
        "service-time",
        f"its actions take {longest_s:g} s, the plan gives a stop {service_s:g} s; in all the robot "
        f"loses {total_s:g} s",
        f"set team.service_time_s to {longest_s:g} and plan again",
    )


def gate_findings(
    mission: Mission,
    vehicle: VehicleMission,
    layout: Layout,
    start_s: float | None,
    times: Mapping[Place, GateTime],
) -> Iterator[Finding]:
    """Yield time gates that are in the past, or late for a vehicle alone.

    Those too far ahead to be told from past ones do not compile.

    Parameters
    ----------
    start_s
        When mission time 0 is, in seconds since the Unix epoch; `None` where it is not known yet.
    times
        Those of `gate_times`, of the same plan.
    """
    gates = [(i, step) for i, step in enumerate(vehicle.steps) if step.action is Action.WAIT]
    settings = mission.vehicle(vehicle.robot)
    if gates and settings.gate == "time" and start_s is None:
        yield Spot(vehicle.robot).warning(
            "gates-unknown",
            "no gate opens by time, the ground must open them all: when the mission starts is not known",
            "give --start",
        )
    if start_s is None:
        return
    by_script = isinstance(vehicle.payload.pick, ByScript)
    for index, step in gates:
        spot = Spot(vehicle.robot, layout.last_item(index), f"gate at {step.node}")
        if step.not_before_s is not None:
            comes_s = start_s + times[vehicle.robot, step.stop].comes_s
            yield from _gate(spot, step.not_before_s, start_s, comes_s, by_script=by_script)


def _gate(
    spot: Spot, opens_s: float, start_s: float, comes_s: float, *, by_script: bool
) -> Iterator[Finding]:
    ahead_s = opens_s - comes_s
    if opens_s < start_s:
        yield spot.error(
            "gate-past",
            f"opens at {utc(opens_s)}, before the mission starts: "
            + ("it does not wait at all" if by_script else "it waits until the next day"),
            "start later, or plan again",
        )
    elif not by_script:
        yield spot.warning(
            "gate-late",
            f"opens at {utc(opens_s)}; coming later (by the plan it is {max(0.0, ahead_s):.0f} s early), the "
            "vehicle waits until the next day",
            "raise gate_margin_s, use the payload script, or gate: custody",
        )


def hold_findings(vehicle: VehicleMission, *, gates_open_by_time: bool) -> Iterator[Finding]:
    """Yield notes about who is needed for the vehicle to go on."""
    held = [step for step in vehicle.steps if held_for_operator(means_of(vehicle, step))]
    if held:
        yield Spot(vehicle.robot, None, _nodes(held)).note(
            "operator",
            f"until a person confirms, the vehicle holds after {_count(len(held), 'action')}",
            "have somebody at the stop, and confirm by malipp confirm",
        )
    custody = [step for step in vehicle.steps if step.action is Action.WAIT]
    if custody and not gates_open_by_time:
        yield Spot(vehicle.robot, None, _nodes(custody)).note(
            "custody-gates",
            f"only the ground opens {_count(len(custody), 'gate')}, when the drop has been confirmed",
            "keep the link up there, or use gate: time",
        )


def utc(time_s: float) -> str:
    """Return a time since the Unix epoch as a person reads it."""
    return f"{datetime.fromtimestamp(time_s, UTC):%Y-%m-%d %H:%M:%S} UTC"


def _nodes(steps: list[Step]) -> str:
    return ", ".join(dict.fromkeys(step.node for step in steps))


def _count(number: int, word: str) -> str:
    return f"{number} {word}{'' if number == 1 else 's'}"
