"""Missions with vehicles of every kind, and what tests of the check ask of findings."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from vehicle_cases import small_mission

from malipp_field.mission import Mission
from malipp_field.vehicle.finding import Finding

SERVO = {"by": "servo", "channel": 9, "pwm_us": 1900, "rest_us": 1100, "duration_s": 20.0}
GRIPPER = {"by": "gripper", "move": "release", "duration_s": 3.0}
RELAY = {"by": "relay", "relay": 0, "duration_s": 4.0}
BY_OUTPUTS = {"collect": SERVO, "drop": GRIPPER, "pick": RELAY, "unload": {"by": "manual"}}


def changed(mission: Mission, **sections: Any) -> Mission:
    """Return a mission with entries of its sections replaced; a section that is not a mapping as a whole."""
    record = mission.model_dump(mode="json", by_alias=True, exclude_none=True)
    for section, entries in sections.items():
        old = record.get(section)
        record[section] = (
            {**old, **entries} if isinstance(old, dict) and isinstance(entries, dict) else entries
        )
    return Mission.model_validate(record)


def with_vehicles(**vehicles: dict[str, Any]) -> Mission:
    """Return the small mission with these entries under ``vehicles``."""
    return changed(small_mission(), vehicles=vehicles)


def rules(findings: Iterable[Finding], *severities: str) -> set[str]:
    """Return the names of the rules that found something, of these severities if any are named."""
    return {finding.rule for finding in findings if not severities or finding.severity in severities}


def of_rule(findings: Iterable[Finding], rule: str) -> list[Finding]:
    return [finding for finding in findings if finding.rule == rule]
