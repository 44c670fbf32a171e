"""Read and write plan files, whole or not at all."""

from __future__ import annotations

import json
from pathlib import Path

from malipp_field.documents import ContentError, parse_document, read_document, whole_file
from malipp_field.mission import Mission
from malipp_field.plan.names import check_names
from malipp_field.plan.schema import Plan, Stop

_ALWAYS_WRITTEN_LATER = ("collect", "drop", "pick", "unload")


def read_plan(path: Path) -> Plan:
    """Read a plan file; raises `InputError` with file, line and key."""
    return read_document(path).validate(Plan)


def read_plan_of(mission: Mission, path: Path) -> Plan:
    """Read a plan file of that mission; raises `InputError` for a name the mission does not have, too."""
    document = read_document(path)
    plan = document.validate(Plan)
    try:
        check_names(plan, mission)
    except ContentError as fault:
        raise document.error(fault.location, fault.problem) from None
    return plan


def parse_plan(text: str, source: str = "plan") -> Plan:
    """Read a plan from text, as a recording carries it; raises like `read_plan`."""
    return parse_document(text, source).validate(Plan)


def plan_text(plan: Plan) -> str:
    """Return the plan as the JSON text of a plan file."""
    data = plan.model_dump(mode="json", exclude={"robots"})
    if plan.reason is None:
        del data["reason"]
    data["robots"] = [
        {"id": robot.id, "route": [_stop_data(stop, index == 0) for index, stop in enumerate(robot.route)]}
        for robot in plan.robots
    ]
    return json.dumps(data, indent=1) + "\n"


def write_plan(plan: Plan, path: Path) -> None:
    """Write a plan file; a reader never sees half of it.

    Raises
    ------
    InputError
        When the file cannot be written.
    """
    with whole_file(path) as partial:
        partial.write_text(plan_text(plan), encoding="utf-8")


def _stop_data(stop: Stop, first: bool) -> dict[str, object]:
    """Return a stop as the format writes it: the start has no leg, and operations only if it has any."""
    data = stop.model_dump(mode="json")
    if first:
        leg = ("path", "arrive_s", "leg_energy_j")
        data = {k: v for k, v in data.items() if k not in leg and (v or k not in _ALWAYS_WRITTEN_LATER)}
    return data
