"""What the commands show: progress while they work, tables when they are done."""

from __future__ import annotations

import math
import sys
import time
from types import TracebackType
from typing import TYPE_CHECKING

from rich.console import Console
from rich.live import Live
from rich.spinner import Spinner
from rich.table import Table
from rich.text import Text

from malipp_field.mission import Mission
from malipp_field.plan import Plan

if TYPE_CHECKING:  # what is shown, not what shows it: a plan needs no coordinator
    from malipp_field.control import Coordinator
    from malipp_field.planner import Progress

_LINE_EVERY_S = 5.0

out = Console(soft_wrap=False, highlight=False)
err = Console(stderr=True, soft_wrap=True, highlight=False)


class ProgressLine:
    """One line that keeps changing on a terminal; on anything else, a new line every few seconds."""

    def __init__(self, title: str) -> None:
        self._title = title
        self._spinner = Spinner("dots", Text(title))
        self._live = Live(self._spinner, console=err, transient=True, refresh_per_second=8)
        self._tty = sys.stderr.isatty()
        self._begun = time.monotonic()
        self._last_line = -_LINE_EVERY_S

    def __enter__(self) -> ProgressLine:
        if self._tty:
            self._live.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, fault: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._tty:
            self._live.stop()
        if fault is None:
            err.print(f"{self._title}: took {time.monotonic() - self._begun:.0f} s")

    def show(self, text: str) -> None:
        """Show where the work stands."""
        line = f"{self._title}: {text}"
        now = time.monotonic()
        if self._tty:
            self._spinner.update(text=Text(line, no_wrap=True, overflow="ellipsis"))
        elif now - self._last_line >= _LINE_EVERY_S:
            self._last_line = now
            err.print(line)

    def planning(self, progress: Progress) -> None:
        """Show how far the planner is: stage, time, J found and proven, gap, rounds."""
        parts = [progress.stage, f"{progress.elapsed_s:.0f} s"]
        if progress.incumbent is not None:
            parts.append(f"J = {progress.incumbent:.4f}")
        if progress.bound is not None and 0.0 < progress.bound < math.inf:
            parts.append(f"J >= {progress.bound:.4f}")
        if progress.gap is not None:
            parts.append(f"gap {100 * progress.gap:.2f} %")
        if progress.rounds:
            parts.append(f"round {progress.rounds}")
        self.show(", ".join(parts))

    def flying(self, coordinator: Coordinator) -> None:
        """Show where the team is."""
        records = coordinator.ledger.records.values()
        home = sum(record.state == "delivered" for record in records)
        wanted = sum(record.state != "withdrawn" for record in records)
        minutes, seconds = divmod(int(coordinator.mission_time_s), 60)
        doing = [f"{robot} {_doing(coordinator, robot)}" for robot in coordinator.tracks]
        self.show(
            f"{minutes}:{seconds:02d}, plan {coordinator.plan.version}, {home} of {wanted} samples home; "
            + "; ".join(doing)
        )


def _doing(coordinator: Coordinator, robot: str) -> str:
    track = coordinator.tracks[robot]
    if track.finished or track.step is None:
        return "done"
    if track.telemetry is not None and track.telemetry.awaits is not None:
        return f"waits for a person at {track.step.node}"
    verb = {"drive": "to", "wait": "waits at"}.get(track.step.action, f"{track.step.action}s at")
    return f"{verb} {track.step.node}"


def plan_table(mission: Mission, plan: Plan) -> Table:
    """Return a plan as a table, a robot a row."""
    title = f"{mission.name}: {plan.method}, {plan.status}"
    table = Table(title=title, title_justify="left", box=None, pad_edge=False)
    words = {"robot", "ends at"}
    columns = ("robot", "stops", "samples", "drops", "picks", "home", "kJ", "of budget", "ends at", "after s")
    for column in columns:
        table.add_column(column, justify="left" if column in words else "right")
    for route in plan.robots:
        budget_j = mission.robot(route.id).energy_budget_j
        stops = route.route
        table.add_row(
            route.id,
            str(len(stops) - 1),
            str(route.collected),
            str(sum(sum(stop.drop.values()) for stop in stops)),
            str(sum(sum(stop.pick.values()) for stop in stops)),
            str(sum(stop.unload for stop in stops)),
            f"{route.energy_j / 1000:.2f}",
            f"{100 * route.energy_j / budget_j:.0f} %" if budget_j else "-",
            stops[-1].node,
            f"{stops[-1].depart_s:.0f}",
        )
    return table


def plan_words(plan: Plan, prior: float) -> str:
    """Return what a plan achieves, in one line."""
    if plan.objective is None:
        return f"{plan.status}: {plan.reason or 'no plan within the limits'}"
    j = plan.objective.information
    words = f"J = {j:.4f} ({100 * (1 - j / prior):.1f} % less than the prior's {prior:.4f})"
    if plan.bound.information is not None:
        gap = "" if plan.gap is None else f" (gap {100 * plan.gap:.2f} %)"
        words += f", proven J >= {plan.bound.information:.4f}{gap}"
    return words + f"; {plan.handoffs} dead drops; planned in {plan.solve_time_s:.1f} s"
