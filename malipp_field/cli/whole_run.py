"""`malipp run` after the plan: export, fly, review, and a closing table with the paths of what was made."""

from __future__ import annotations

import asyncio
from pathlib import Path

from malipp_field.cli.display import ProgressLine, out
from malipp_field.errors import InputError
from malipp_field.mission import Mission
from malipp_field.plan import Plan
from malipp_field.review import Summary, review
from malipp_field.review.tables import print_summary
from malipp_field.run import any_free_port, fly
from malipp_field.vehicle.export import ExportFormat, export
from malipp_field.vehicle.layout import held_for_operator

PLAN, RECORDING, REVIEW = RESULTS = ("plan.json", "run.mcap", "review.rrd")
"""The files of a run, beside the folder `export`."""
_FORMATS: tuple[ExportFormat, ...] = ("wpl", "plan")  # the steps map, written with each, names the last


def whole_run(
    mission: Mission,
    mission_file: Path,
    plan: Plan,
    output: Path,
    speed: float | None,
    listen: str | None = None,
) -> bool:
    """Export and fly a verified plan, review the recording; return whether every sample came home."""
    made = [output / PLAN]
    if mission.site.origin is not None:
        for file_format in _FORMATS:
            made += export(mission, plan, file_format, output / "export")
    recording, reviewed = output / RECORDING, output / REVIEW
    # One of an earlier run would pass for the review of this one, were this one cut off.
    reviewed.unlink(missing_ok=True)
    text = _text(mission_file)
    address = listen or any_free_port()
    if any(_asks_a_person(mission, robot.id) for robot in mission.team.robots):
        out.print(f"To confirm by hand: malipp confirm {mission_file} --connect {address}", soft_wrap=True)
    with ProgressLine("flying") as line:
        outcome = asyncio.run(
            fly(mission, text, plan, recording, speed=speed, on_tick=line.flying, listen=address)
        )
    review_recording(recording, reviewed)
    out.print(f"\n{outcome.reason[0].upper()}{outcome.reason[1:]}.", soft_wrap=True)
    for path in (*dict.fromkeys(made), recording, reviewed):
        out.print(f"  {path}", soft_wrap=True)
    out.print(f"Look at it with: .venv/bin/rerun {reviewed}", soft_wrap=True)
    return outcome.complete


def review_recording(recording: Path, target: Path) -> Summary:
    """Write the Rerun recording of a mission and print its summary."""
    with ProgressLine("reviewing"):
        summary = review(recording, target)
    print_summary(summary, out)
    return summary


def _asks_a_person(mission: Mission, robot_id: str) -> bool:
    profile = mission.vehicle(robot_id).payload
    return any(map(held_for_operator, (profile.collect, profile.drop, profile.pick, profile.unload)))


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except OSError as fault:
        raise InputError(str(path), None, "", fault.strerror or str(fault)) from None
