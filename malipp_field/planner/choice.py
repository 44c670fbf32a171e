"""What "auto" plans a team by."""

from __future__ import annotations

from typing import Literal

from malipp_field.mission import Mission

_SMALL = 60
"""Robots times candidates that the exact search settles, more often than not, in a minute."""


def is_small(robots: int, candidates: int) -> bool:
    """Tell whether the exact search is likely to prove the best plan of such a team within a minute."""
    return robots * candidates <= _SMALL


def method_for(mission: Mission) -> tuple[Literal["exact", "fast"], str]:
    """Return the method that "auto" takes, and why, in words."""
    robots = len(mission.team.robots)
    candidates = sum(node.role == "candidate" for node in mission.site.nodes)
    size = f"{robots} robots times {candidates} candidates are {robots * candidates}"
    if is_small(robots, candidates):
        return "exact", f"{size}, and up to {_SMALL} the best plan is likely to be proven"
    return "fast", f"{size}, and beyond {_SMALL} a proof is unlikely: good plans first, then a bound"
