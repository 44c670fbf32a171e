"""The files that commands are given."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

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
    from malipp_field.plan import read_plan
    from malipp_field.planner import check

    mission, found = read_mission(mission_file), read_plan(plan_file)
    try:
        check(mission, found)
    except PlanError as fault:
        raise InputError(str(plan_file), None, "", str(fault)) from None
    return mission, found
