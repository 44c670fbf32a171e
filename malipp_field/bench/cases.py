"""The results of a study: gains over Seq-LIPP, their means, and how sure those are."""

from __future__ import annotations

import math
import statistics
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from malipp_field.bench.instances import Specification
from malipp_field.bench.studies import SEQ, Study
from malipp_field.bench.tasks import Row

_QUANTILE = 1.96
"""Of the normal distribution, for 95 %: the paper does not say how it made its intervals. With the 60 to 120
instances of the full studies Student's t would widen them by 1 to 2 %; with a few, by far more."""


@dataclass(frozen=True)
class Mean:
    """A mean, half of its 95 % confidence interval, and of how many values.

    The interval is mean +- 1.96 s / sqrt(n); there is none of a single value.
    """

    value: float
    half: float | None
    count: int

    @property
    def low(self) -> float:
        """Return the lower end of the interval; the mean itself where there is none."""
        return self.value - (self.half or 0.0)

    @property
    def high(self) -> float:
        """Return the upper end of the interval; the mean itself where there is none."""
        return self.value + (self.half or 0.0)

    def __str__(self) -> str:
        return f"{self.value:.2f}" + ("" if self.half is None else f" ± {self.half:.2f}")


def mean(values: Sequence[float]) -> Mean | None:
    """Return the mean with its interval; None of nothing."""
    if not values:
        return None
    half = _QUANTILE * statistics.stdev(values) / math.sqrt(len(values)) if len(values) > 1 else None
    return Mean(statistics.fmean(values), half, len(values))


def gain(base: float, information: float) -> float:
    """Return the paper's G: by how many per cent J is below that of Seq-LIPP."""
    return 100.0 * (base - information) / base if base > 0.0 else 0.0


@dataclass(frozen=True)
class Cases:
    """The rows of a study, by instance and arm; what has not run, or could not, is missing."""

    study: Study
    rows: Mapping[tuple[Specification, str], Row]

    def planned(self, specification: Specification, label: str) -> Row | None:
        """Return a row that has a plan."""
        row = self.rows.get((specification, label))
        return row if row is not None and row.information is not None else None

    def of(self, cell: Specification, label: str) -> list[Row]:
        """Return the rows with a plan of all instances of a cell."""
        rows = (self.planned(spec, label) for spec in self.seeds(cell))
        return [row for row in rows if row is not None]

    def pairs(self, cell: Specification, label: str, base: str = SEQ) -> list[tuple[Row, Row]]:
        """Return (base, row) of every instance of a cell that both have planned."""
        both = ((self.planned(spec, base), self.planned(spec, label)) for spec in self.seeds(cell))
        return [(first, second) for first, second in both if first is not None and second is not None]

    def gains(self, cell: Specification, label: str) -> list[float]:
        """Return the gains over Seq-LIPP of all instances of a cell, in per cent."""
        return [gain(_j(base), _j(row)) for base, row in self.pairs(cell, label)]

    def seeds(self, cell: Specification) -> Iterable[Specification]:
        """Return the instances of a cell."""
        return (spec for spec in self.study.specifications if _kind(spec) == _kind(cell))

    def gains_at(self, cell: Specification, label: str, time_s: float) -> list[float] | None:
        """Return the gains of the plans there were at a time; None while an instance has none."""
        found = []
        for base, row in self.pairs(cell, label):
            information = row.information_at(time_s)
            if information is None:
                return None
            found.append(gain(_j(base), information))
        return found or None

    def most_gains(self, cell: Specification, label: str) -> list[float]:
        """Return for every instance with a bound the gain that no plan can exceed."""
        return [gain(_j(base), row.bound) for base, row in self.pairs(cell, label) if row.bound is not None]


def _kind(specification: Specification) -> tuple[object, ...]:
    values = vars(specification)
    return tuple(values[name] for name in values if name != "seed")


def _j(row: Row) -> float:
    assert row.information is not None
    return row.information
