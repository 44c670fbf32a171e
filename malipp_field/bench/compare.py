"""Whether methods agree on the same mission: J, energy and makespan, infeasibility, and bounds."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

from malipp_field.bench.tasks import Row

TOLERANCE = 1e-4
"""Relative: what differs by more than this disagrees."""
SAME = 1e-6
"""Relative: a later stage is compared only between plans that are the same to this in the stages before,
since a J within the solver's gap of the optimum may come with any energy."""


@dataclass(frozen=True)
class Comparison:
    """How many pairs of proven results were compared in each stage, and what did not fit, in words."""

    information: int = 0
    energy: int = 0
    makespan: int = 0
    faults: tuple[str, ...] = ()

    def __add__(self, other: Comparison) -> Comparison:
        return Comparison(
            self.information + other.information,
            self.energy + other.energy,
            self.makespan + other.makespan,
            self.faults + other.faults,
        )


def compare(rows: Sequence[Row], tolerance: float = TOLERANCE) -> Comparison:
    """Compare all results for one mission, state and choice of handoffs.

    Unproven plans take part as well: no bound, and no proven optimum, may lie above any plan's J, and where
    one method has a plan no other may prove that there is none.
    """
    faults = [f"{_who(row)}: {row.reason}" for row in rows if row.status == "fault"]
    total = Comparison(faults=tuple(faults))
    for first, second in itertools.combinations(rows, 2):
        total += _pair(first, second, tolerance)
    return total


def _pair(a: Row, b: Row, tolerance: float) -> Comparison:
    contradictions = [fault for x, y in ((a, b), (b, a)) for fault in _contradictions(x, y, tolerance)]
    if contradictions:
        return Comparison(faults=tuple(contradictions))
    if not (a.certified and b.certified):
        return Comparison()
    if a.status == "infeasible" or b.status == "infeasible":  # both are: anything else is a contradiction
        return Comparison(information=1)
    return _stages(a, b, tolerance)


def _contradictions(a: Row, b: Row, tolerance: float) -> list[str]:
    """Return what ``a`` claims that a plan of ``b`` refutes."""
    if b.information is None:
        return []
    if a.status == "infeasible":
        return [f"{_who(a)} says infeasible, {_who(b)} has a plan of J = {b.information:.6f}"]
    claims = [("bound", a.bound)] + ([("proven optimum", a.information)] if a.certified else [])
    return [
        f"{what} {value:.6f} of {_who(a)} lies above J = {b.information:.6f} of {_who(b)}"
        for what, value in claims
        if value is not None and value > b.information + tolerance * abs(value)
    ]


def _stages(a: Row, b: Row, tolerance: float) -> Comparison:
    """Compare energy, then makespan, as far as the stages before are the same; J is known to agree."""
    proven = a.status == b.status == "optimal"
    if not proven or _apart(a.information, b.information, SAME):
        return Comparison(information=1)
    if _apart(a.energy_j, b.energy_j, tolerance):
        fault = f"energy {a.energy_j} J of {_who(a)}, {b.energy_j} J of {_who(b)}"
        return Comparison(information=1, energy=1, faults=(fault,))
    if _apart(a.energy_j, b.energy_j, SAME) or a.makespan_s is None or b.makespan_s is None:
        return Comparison(information=1, energy=1)
    fault = f"makespan {a.makespan_s} s of {_who(a)}, {b.makespan_s} s of {_who(b)}"
    apart = _apart(a.makespan_s, b.makespan_s, tolerance)
    return Comparison(information=1, energy=1, makespan=1, faults=(fault,) if apart else ())


def _apart(x: float | None, y: float | None, tolerance: float) -> bool:
    return x is None or y is None or abs(x - y) > tolerance * max(abs(x), abs(y), 1e-9)


def _who(row: Row) -> str:
    return f"{row.instance} {row.method}{'' if row.handoffs else ' without handoffs'}"
