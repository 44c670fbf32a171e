"""The summary as a few short tables for the terminal."""

from __future__ import annotations

from datetime import UTC, datetime

from rich import box
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from malipp_field.review.summary import Hand, RobotSummary, SampleSummary, Summary
from malipp_field.review.timeline import clock
from malipp_field.vehicle.steps import Action

_WIDTH = 100
"""Of what is written to a file or a pipe; a terminal has its own."""
_LARGE_J = 10_000.0
"""Budgets from this on are told in kilojoules."""
_NOTHING = "-"


def print_summary(summary: Summary, console: Console | None = None) -> None:
    """Print the tables of a summary, on standard output unless told otherwise."""
    console = console or Console()
    if not console.is_terminal:
        console = Console(file=console.file, width=_WIDTH, no_color=True)
    console.print(f"\n[bold]{escape(summary.mission)}[/bold], {_when(summary)}", highlight=False)
    if not summary.complete:
        console.print("[yellow]The recording was cut off: these figures end where it does.[/yellow]")
    for table in (_outcome(summary), _robots(summary), _replans(summary), _custody(summary)):
        if table.row_count:
            console.print(table)
            console.print()


def _when(summary: Summary) -> str:
    began = datetime.fromtimestamp(summary.start_s, UTC)
    return f"{began:%Y-%m-%d %H:%M} UTC, {_clock(summary.duration_s)} recorded"


def _outcome(summary: Summary) -> Table:
    table = _table("Information", "J: weighted posterior variance at the test points, less is better")
    for name in ("prior", "planned", "last plan", "achieved", "samples taken", "samples delivered"):
        table.add_column(name, justify="right")
    j = summary.information
    table.add_row(
        *(_number(value, ".3f") for value in (j.prior, j.planned, j.last_planned, j.achieved)),
        str(len(summary.samples)),
        str(summary.delivered),
    )
    return table


def _robots(summary: Summary) -> Table:
    table = _table("Robots", "planned: the first plan; expected: the last plan, from what was measured then")
    table.add_column("robot")
    large = any(robot.energy_budget_j >= _LARGE_J for robot in summary.robots)
    unit, unit_j = ("kJ", 1000.0) if large else ("J", 1.0)
    for name in (
        f"{unit} used",
        "planned",
        "expected",
        "budget",
        "time",
        "planned",
        "metres",
        "taken",
        "home",
    ):
        table.add_column(name, justify="right")
    for robot in summary.robots:
        table.add_row(escape(robot.robot), *_robot_row(robot, unit_j))
    return table


def _robot_row(robot: RobotSummary, unit_j: float) -> list[str]:
    energies = (robot.energy_used_j, robot.energy_planned_j, robot.energy_expected_j, robot.energy_budget_j)
    return [
        *(_number(None if energy is None else energy / unit_j, ",.1f") for energy in energies),
        _clock(robot.time_taken_s),
        _clock(robot.time_planned_s),
        f"{robot.distance_m:,.0f}",
        str(robot.collected),
        str(robot.delivered),
    ]


def _replans(summary: Summary) -> Table:
    table = _table("Replans")
    table.add_column("at", justify="right")
    table.add_column("plan", justify="right")
    table.add_column("J planned", justify="right")
    table.add_column("new missions for")
    table.add_column("reason", overflow="fold")
    for replan in summary.replans:
        table.add_row(
            _clock(replan.time_s),
            str(replan.version),
            _number(replan.information, ".3f"),
            escape(", ".join(replan.vehicles)) or _NOTHING,
            escape(replan.reason),
        )
    return table


def _custody(summary: Summary) -> Table:
    table = _table("Samples", "every hand each container went through")
    table.add_column("tag", justify="right")
    table.add_column("taken")
    table.add_column("value", justify="right")
    table.add_column("way", overflow="fold")
    table.add_column("now")
    for sample in summary.samples:
        table.add_row(
            str(sample.tag),
            escape(f"{sample.node} by {sample.sampler}, {_clock(sample.taken_s)}"),
            _number(sample.value, ".2f"),
            escape("\n".join(_hand(hand) for hand in _between(sample))),
            escape(_whereabouts(sample)),
        )
    return table


def _between(sample: SampleSummary) -> tuple[Hand, ...]:
    """Return the hands between the collection and the delivery; those have columns of their own."""
    return sample.hands[1:-1] if sample.state == "delivered" else sample.hands[1:]


def _hand(hand: Hand) -> str:
    verb = {Action.DROP: "left", Action.PICK: "fetched", Action.UNLOAD: "unloaded"}.get(hand.action, "taken")
    return f"{verb} at {hand.node} by {hand.robot}, {_clock(hand.time_s)}"


def _whereabouts(sample: SampleSummary) -> str:
    if sample.delivered_s is not None:
        return f"{sample.holder} by {sample.hands[-1].robot}, {_clock(sample.delivered_s)}"
    place = {"on_board": "on board", "cached": "lying at", "lost": "lost"}.get(sample.state, sample.state)
    return f"{place} {sample.holder}" if sample.holder else place


def _table(title: str, caption: str | None = None) -> Table:
    return Table(
        title=title,
        caption=caption,
        title_justify="left",
        caption_justify="left",
        box=box.SIMPLE_HEAD,
        pad_edge=False,
        collapse_padding=True,
        show_edge=False,
    )


def _number(value: float | None, form: str) -> str:
    return _NOTHING if value is None else f"{value:{form}}"


def _clock(time_s: float | None) -> str:
    return _NOTHING if time_s is None else clock(time_s)
