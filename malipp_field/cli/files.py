"""The files that commands are given."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from malipp_field.documents import suggest
from malipp_field.errors import InputError, PlanError

if TYPE_CHECKING:
    from malipp_field.mission import Mission
    from malipp_field.plan import Plan

MissionFile = Annotated[
    Path, typer.Argument(metavar="MISSION", help="Mission file (malipp-mission/1, YAML).")
]
PlanFile = Annotated[Path, typer.Argument(metavar="PLAN", help="Plan file (malipp-plan/1, JSON).")]


def verified(mission_file: Path, plan_file: Path) -> tuple[Mission, Plan]:
    """Read a mission and a plan of it, and let no plan pass that breaks a rule; raises `InputError`."""
    from malipp_field.mission import read_mission
    from malipp_field.plan import read_plan_of
    from malipp_field.planner import check

    mission = read_mission(mission_file)
    found = read_plan_of(mission, plan_file)
    try:
        check(mission, found)
    except PlanError as fault:
        raise InputError(str(plan_file), None, "", str(fault)) from None
    return mission, found


def known_robot(mission_file: Path, mission: Mission, name: str) -> None:
    """Refuse a robot that the mission does not have; raises `InputError`."""
    robots = [robot.id for robot in mission.team.robots]
    if name not in robots:
        hint = suggest(name, robots) or f"; there are {', '.join(robots)}"
        raise InputError(str(mission_file), None, "", f"has no robot '{name}'{hint}")


def folder(path: Path) -> None:
    """Refuse a folder for results that is something else already."""
    if path.exists() and not path.is_dir():
        raise InputError(str(path), None, "", "is not a folder")


def writable(path: Path, source: Path) -> None:
    """Find out before the work, not after it, that its result cannot be written, or not over ``source``."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as fault:
        raise InputError(str(path.parent), None, "", f"cannot be made: {fault.strerror}") from None
    if path.exists() and not path.is_file():
        # Results are moved into place whole, which would replace a device or a pipe by a file.
        raise InputError(str(path), None, "", "cannot be written: it is not an ordinary file")
    if path.exists() and source.exists() and path.samefile(source):
        raise InputError(str(path), None, "", "cannot be written: it is what is to be read")
    if not os.access(path if path.exists() else path.parent, os.W_OK):
        raise InputError(str(path), None, "", "cannot be written")
