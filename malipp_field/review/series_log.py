"""Quantities over time, states, and the mission in words."""

from __future__ import annotations

from collections.abc import Sequence

import rerun as rr

from malipp_field.bus.messages import Confirmation, Telemetry
from malipp_field.record import Run
from malipp_field.review.custody import loads
from malipp_field.review.prediction import adoption_time, energy_used, predicted_energy
from malipp_field.review.site import INK, Color, robot_colors
from malipp_field.review.summary import information_over_time
from malipp_field.review.timeline import Timeline, clock
from malipp_field.vehicle.steps import Action

_PLANNED_ALPHA = 150
_LEVELS = {"info": "INFO", "warning": "WARN", "error": "ERROR"}
_STATES = {
    Action.DRIVE: "driving", Action.WAIT: "waiting", Action.COLLECT: "sampling", Action.DROP: "dropping",
    Action.PICK: "picking", Action.UNLOAD: "unloading",
}  # fmt: skip
_STATE_COLORS: dict[str, Color] = {
    "ready": (70, 78, 86), "driving": (80, 130, 200), "waiting": (215, 165, 40), "sampling": (90, 180, 110),
    "dropping": (200, 110, 60), "picking": (170, 110, 190), "unloading": (120, 190, 190),
    "finished": (50, 56, 62),
}  # fmt: skip
_VERBS = {
    Action.COLLECT: "took {tag} at {node}", Action.DROP: "left {tag} at {node}",
    Action.PICK: "fetched {tag} at {node}", Action.UNLOAD: "unloaded {tag} at {node}",
}  # fmt: skip


def log_series(timeline: Timeline, run: Run) -> None:
    """Log energy, load, J and states over time."""
    for robot, color in robot_colors(run.mission).items():
        _log_energy(timeline, run, robot, color)
        _log_payload(timeline, run, robot, color)
        _log_states(timeline, run, robot)
    _log_information(timeline, run)
    for adopted in run.plans:
        # A row of its own among the states: where it changes colour, there was a replan.
        timeline.log(adopted.time_s, "states/plan", rr.StateChange(state=f"plan {adopted.plan.version}"))


def _log_energy(timeline: Timeline, run: Run, robot: str, color: Color) -> None:
    """Log energy as a share of the budget, so that light and heavy robots can stand in one plot."""
    percent = 100.0 / max(run.mission.robot(robot).energy_budget_j, 1e-9)
    entity = f"series/energy/{robot}"
    times, used = energy_used(run, robot)
    if times.size:
        _line(timeline, f"{entity}/used", color, width=2.5, name=robot)
        timeline.send(times, f"{entity}/used", rr.Scalars.columns(scalars=used * percent))
    for adopted, (when, predicted) in zip(run.plans, predicted_energy(run, robot), strict=True):
        path = f"{entity}/plan_{adopted.plan.version}"
        name = f"{robot}, plan {adopted.plan.version}"
        _line(timeline, path, (*color, _PLANNED_ALPHA), width=1.0, name=name)
        timeline.send(when, path, rr.Scalars.columns(scalars=predicted * percent))


def _log_payload(timeline: Timeline, run: Run, robot: str, color: Color) -> None:
    entity = f"series/payload/{robot}"
    _line(timeline, entity, color, width=2.0, name=robot, steps=True)
    rows = [(run.start_s, 0)]
    rows += loads(run, robot)
    rows.append((max(run.end_s, rows[-1][0]), rows[-1][1]))
    _send_rows(timeline, entity, rows)


def _log_information(timeline: Timeline, run: Run) -> None:
    _line(timeline, "series/information/achieved", INK, width=2.5, name="achieved", steps=True)
    achieved = information_over_time(run)
    _send_rows(timeline, "series/information/achieved", [*achieved, (run.end_s, achieved[-1][1])])
    planned = [
        (run.start_s + adoption_time(run, adopted), adopted.plan.objective.information)
        for adopted in run.plans
        if adopted.plan.objective is not None
    ]
    if planned:
        _line(timeline, "series/information/planned", (*INK, _PLANNED_ALPHA), 1.0, "planned", steps=True)
        _send_rows(timeline, "series/information/planned", [*planned, (run.end_s, planned[-1][1])])


def _line(
    timeline: Timeline, entity: str, color: tuple[int, ...], width: float, name: str, steps: bool = False
) -> None:
    mode = "StepAfter" if steps else "Linear"
    timeline.log_static(
        entity, rr.SeriesLines(colors=color, widths=width, names=name, interpolation_mode=mode)
    )


def _send_rows(timeline: Timeline, entity: str, rows: Sequence[tuple[float, float]]) -> None:
    times = [time_s - timeline.start_s for time_s, _ in rows]
    timeline.send(times, entity, rr.Scalars.columns(scalars=[float(value) for _, value in rows]))


def _log_states(timeline: Timeline, run: Run, robot: str) -> None:
    entity = f"states/{robot}"
    timeline.log_static(
        entity,
        rr.StateConfiguration(values=list(_STATE_COLORS), colors=list(_STATE_COLORS.values())),
    )
    actions = {
        step.uid: step.action
        for adopted in run.plans
        for order in adopted.missions
        if order.robot == robot
        for step in order.steps
    }
    before = None
    for report in run.telemetry[robot]:
        state = _state(report, actions)
        if state != before:
            timeline.log(report.time_s, entity, rr.StateChange(state=state))
        before = state


def _state(report: Telemetry, actions: dict[str, Action]) -> str:
    if report.finished:
        return "finished"
    return "ready" if report.step_uid is None else _STATES[actions.get(report.step_uid, Action.DRIVE)]


def log_words(timeline: Timeline, run: Run) -> None:
    """Log events, plans and payload actions as text."""
    colors = robot_colors(run.mission)
    for event in run.events:
        text = event.text if event.robot is None else f"{event.robot}: {event.text}"
        _say(timeline, event.time_s, "log/events", text, _LEVELS[event.severity], INK)
    for adopted in run.plans:
        objective = adopted.plan.objective
        figures = "" if objective is None else f" (J {objective.information:.3f})"
        level = "INFO" if adopted.plan.version == 1 else "WARN"
        text = f"plan {adopted.plan.version}{figures}: {adopted.reason}"
        _say(timeline, adopted.time_s, "log/plans", text, level, INK)
    for said in run.confirmations:
        if said.action in _VERBS:
            level = "INFO" if said.ok else "ERROR"
            color = colors.get(said.robot, INK)
            _say(timeline, said.time_s, "log/custody", _in_words(said), level, color)


def _say(timeline: Timeline, time_s: float, entity: str, text: str, level: str, color: Color) -> None:
    when = clock(time_s - timeline.start_s)
    timeline.log(time_s, entity, rr.TextLog(f"{when}  {text}", level=level, color=color))


def _in_words(said: Confirmation) -> str:
    words = f"{said.robot} {_VERBS[said.action].format(tag=said.tag, node=said.node)}"
    value = "" if said.value is None else f", reading {said.value:.2f}"
    return f"{words}{value}" if said.ok else f"FAILED: {words} ({said.text or 'no reason given'})"
