"""What a pre-upload check says: one finding, with where it is and what to change."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Severity = Literal["error", "warning", "note"]
"""An error stops an upload; a warning is for a person to weigh; a note says what the mission needs of one."""


@dataclass(frozen=True)
class Finding:
    """One thing a person should know before a mission is sent.

    Attributes
    ----------
    severity
        How bad it is.
    rule
        Name of what was checked, the same in every release (``fence-crossing``).
    problem, remedy
        What is wrong, and what to change: one line each.
    robot
        Whose mission; None for the whole team.
    item
        Sequence number on the vehicle, home is 0; None where no item is meant.
    where
        Stop, node or step in words; may be empty.
    """

    severity: Severity
    rule: str
    problem: str
    remedy: str
    robot: str | None = None
    item: int | None = None
    where: str = ""

    def __str__(self) -> str:
        item = None if self.item is None else f"item {self.item}"
        place = ", ".join(part for part in (self.robot, item, self.where) if part)
        return f"{self.severity}: {place}: {self.problem}; {self.remedy}"


@dataclass(frozen=True)
class Spot:
    """Where something is looked at; makes the findings about it."""

    robot: str | None = None
    item: int | None = None
    where: str = ""

    def error(self, rule: str, problem: str, remedy: str) -> Finding:
        """Return an error found here."""
        return Finding("error", rule, problem, remedy, self.robot, self.item, self.where)

    def warning(self, rule: str, problem: str, remedy: str) -> Finding:
        """Return a warning found here."""
        return Finding("warning", rule, problem, remedy, self.robot, self.item, self.where)

    def note(self, rule: str, problem: str, remedy: str) -> Finding:
        """Return a note about this."""
        return Finding("note", rule, problem, remedy, self.robot, self.item, self.where)
