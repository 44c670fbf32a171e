"""What an explanation of a plan consists of; made by `malipp_field.planner.explain`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from malipp_field.planner.bounds.relaxation import RelaxedValue

Kind = Literal["energy", "room", "slots"]
"""Joules of B_r, samples of K_r, samples of S_r^max at every node."""
Verdict = Literal["binds", "slack", "open"]


@dataclass(frozen=True)
class Usage:
    """What a robot has of something, and what the plan uses of it.

    Attributes
    ----------
    has, uses
        Energy: joules that may be used, and those of the route. Room: K_r, and the most samples on board at
        any moment. Slots: S_r^max, and the most samples taken at one node (before the plan as well).
    at_limit, nodes
        Slots only: at how many of the nodes it samples it takes all it may.
    """

    robot: str
    kind: Kind
    has: float
    uses: float
    at_limit: int = 0
    nodes: int = 0


@dataclass(frozen=True)
class Trial:
    """The mission planned again with one thing changed.

    Attributes
    ----------
    step
        How much more there was: joules, samples or slots; 0 where something was forbidden.
    fall
        J of the plan less J found: below zero where J rises.
    most
        Proven: J cannot fall by more than this (or rises at least by its opposite); None without a bound.
    proven
        Whether what was found is optimal within the gap asked for.
    energy_j
        Energy of the team, found less planned.
    """

    step: float
    fall: float
    most: float | None
    proven: bool
    energy_j: float


@dataclass(frozen=True)
class Resource:
    """Something a robot has, and what more of it would buy; ``trial`` is None where that was not asked."""

    use: Usage
    trial: Trial | None
    verdict: Verdict

    @property
    def value(self) -> float | None:
        """Fall in J per joule, sample or slot."""
        return None if self.trial is None else self.trial.fall / self.trial.step


@dataclass(frozen=True)
class Place:
    """A node at which the plan hands over.

    Attributes
    ----------
    drops : tuple of (sender, receiver, samples)
    left_out
        By how much J would rise if the samples that pass through here were left out and all else stayed: the
        most that these drops can be worth. None where one of them must come home (it was taken before).
    """

    node: str
    drops: tuple[tuple[str, str, int], ...]
    left_out: float | None


@dataclass(frozen=True)
class DropPlace:
    """What happens where nobody may hand over at one place; ``trial`` is None where that is not known."""

    place: Place
    trial: Trial | None


@dataclass(frozen=True)
class Explanation:
    """All that was found out about a plan.

    Attributes
    ----------
    information
        J of the plan.
    searched_j
        What J fell by when planning was only repeated, of a plan that is not proven; all other figures
        compare with the better plan of the two.
    proven, gap
        Whether that plan is optimal within the gap asked for, and the gap.
    relaxed
        Marginal values of the relaxation by robot, for plans that are not proven.
    asked
        How many times planning was repeated.
    """

    information: float
    searched_j: float
    proven: bool
    gap: float | None
    sample_mass_kg: float
    resources: tuple[Resource, ...]
    without_drops: Trial | None
    places: tuple[DropPlace, ...]
    relaxed: Mapping[str, RelaxedValue] | None
    asked: int
    time_s: float
