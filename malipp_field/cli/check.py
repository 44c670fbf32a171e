"""`malipp check`: what would go wrong with the missions of a plan, before anything is sent."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.text import Text

from malipp_field.cli.files import MissionFile, PlanFile, known_robot, verified
from malipp_field.cli.status import INPUT_ERROR
from malipp_field.cli.times import StartTime

if TYPE_CHECKING:
    from malipp_field.mission import Mission
    from malipp_field.plan import Plan
    from malipp_field.vehicle.finding import Finding, Severity

_STYLES: dict[Severity, str] = {"error": "bold red", "warning": "yellow", "note": "cyan"}
_OF_LINKS = {"no-link", "unsigned"}
_INDENT = 10
"""Columns of a severity and what is beneath it."""


def check(
    mission_file: MissionFile,
    plan_file: PlanFile,
    robot: Annotated[
        list[str] | None,
        typer.Option("--robot", metavar="R", help="Only this robot; may be given again. All if not given."),
    ] = None,
    start: StartTime = None,
) -> None:
    """Check the missions of a plan for these vehicles and their firmware, before anything is sent.

    Errors stop an upload; warnings are for you to weigh; notes say what the mission needs of people.
    Exit status: 0 without errors, 2 with any.
    """
    from malipp_field.cli.display import out
    from malipp_field.vehicle.check import check as find

    mission, plan = verified(mission_file, plan_file)
    for name in robot or ():
        known_robot(mission_file, mission, name)
    wanted = [None, *(robot or [route.id for route in plan.robots])]
    findings = [*_keys(mission, mission_file.parent), *find(mission, plan, start)]
    findings = sorted((f for f in findings if f.robot in wanted), key=lambda f: wanted.index(f.robot))
    print_findings(findings, out)
    out.print(Text(f"{plan_file}: ").append_text(_verdict(findings)), soft_wrap=True)
    if has_errors(findings):
        raise typer.Exit(INPUT_ERROR)


def show_faults(mission: Mission, plan: Plan, start_s: float | None = None, *, fence: bool = True) -> bool:
    """Say on stderr what is wrong with the missions of a plan; return whether they must not be uploaded.

    What only concerns a link is left out: nothing is sent to a vehicle of the user's; and where no fence is
    sent, how large it is.
    """
    from malipp_field.cli.display import err
    from malipp_field.vehicle.check import check as find
    from malipp_field.vehicle.check_fence import OF_FENCE

    unsaid = _OF_LINKS if fence else _OF_LINKS | OF_FENCE

    findings = [
        finding
        for finding in find(mission, plan, start_s)
        if finding.severity != "note" and finding.rule not in unsaid
    ]
    print_findings(findings, err)
    return has_errors(findings)


def has_errors(findings: Iterable[Finding]) -> bool:
    """Tell whether an upload is out of the question."""
    return any(finding.severity == "error" for finding in findings)


def print_findings(findings: Sequence[Finding], console: Console) -> None:
    """Print findings robot by robot, the worst first; what is found at many places only once."""
    for robot in dict.fromkeys(finding.robot for finding in findings):
        console.print(Text(robot or "team", style="bold"))
        for severity in _STYLES:
            alike: dict[tuple[str, str], list[Finding]] = {}
            for finding in findings:
                if (finding.robot, finding.severity) == (robot, severity):
                    alike.setdefault((finding.problem, finding.remedy), []).append(finding)
            for group in alike.values():
                _print_group(group, console)


def _print_group(group: Sequence[Finding], console: Console) -> None:
    first = group[0]
    place = "; ".join(dict.fromkeys(filter(None, map(_place, group))))
    severity = Text(f"  {first.severity}".ljust(_INDENT), style=_STYLES[first.severity])
    _print_beneath(severity, Text.assemble((f"{place}: " if place else "", "bold"), first.problem), console)
    _print_beneath(Text(" " * _INDENT), Text(f"-> {first.remedy}", style="dim"), console)


def _print_beneath(head: Text, text: Text, console: Console) -> None:
    """Print a text after a head; on a terminal its further lines begin where the first one does."""
    lines = text.wrap(console, console.width - _INDENT) if console.is_terminal else [text]
    for line in lines:
        console.print(head + line, soft_wrap=True)
        head = Text(" " * _INDENT)


def _place(finding: Finding) -> str:
    if finding.item is None:
        return finding.where
    return f"item {finding.item}" + (f" ({finding.where})" if finding.where else "")


def _verdict(findings: Sequence[Finding]) -> Text:
    counts = {
        severity: sum(finding.severity == severity for finding in findings)
        for severity in ("error", "warning")
    }
    words = [f"{number} {name}{'' if number == 1 else 's'}" for name, number in counts.items() if number]
    if counts["error"]:
        return Text(f"{', '.join(words)}: not to be uploaded", style=_STYLES["error"])
    return Text(f"ready, with {', '.join(words)}" if words else "ready", style="green")


def _keys(mission: Mission, folder: Path) -> Iterator[Finding]:
    """Yield signing keys that are not there, or not their owner's alone."""
    from malipp_field.vehicle.finding import Spot

    for robot in (robot.id for robot in mission.team.robots):
        key = mission.vehicle(robot).signing_key
        if key is None:
            continue
        path = folder / key
        if not path.is_file():
            yield Spot(robot).error(
                "key", f"its signing key {path} is not there", "copy it there from where it was made"
            )
        elif path.stat().st_mode & 0o077:
            yield Spot(robot).error("key", f"others may read its signing key {path}", f"chmod 600 {path}")
