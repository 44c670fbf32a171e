"""Results as CSV: all that is needed to read a figure, and to repeat it."""

from __future__ import annotations

import csv
from collections.abc import Iterator, Sequence
from dataclasses import asdict, fields
from pathlib import Path

from malipp_field.bench.campaign import Campaign
from malipp_field.bench.cases import Cases, gain
from malipp_field.bench.instances import Specification
from malipp_field.bench.studies import SEQ, Study
from malipp_field.bench.tasks import Row
from malipp_field.documents import whole_file

_SPECIFICATION = tuple(field.name for field in fields(Specification))
_FIGURES = (
    "method", "handoffs", "time_limit_s", "mip_gap", "threads", "planner_seed", "status", "reason", "time_s",
    "first_plan_s", "information", "bound", "root_bound", "gap", "energy_j", "makespan_s", "drops", "sampled",
    "peak_mib", "code", "versions", "machine", "date", "key",
)  # fmt: skip
COLUMNS = (
    "study",
    "instance",
    *_SPECIFICATION,
    "budgets",
    "carrier_budget_j",
    "arm",
    *_FIGURES,
    "gain_percent",
)
"""Of a study's table: the instance's specification and budget, how it was planned, and what came of it."""
TRAIL_COLUMNS = ("study", "instance", "arm", "time_s", "information", "bound")
"""Of a study's trails: every better plan and higher bound with its time."""


def write_tables(campaign: Campaign, study: Study) -> tuple[Path, Path]:
    """Write a study's table and trails into the campaign's folder and return their paths.

    Raises
    ------
    InputError
        When a file cannot be written.
    """
    cases = campaign.cases(study)
    table, trails = campaign.folder / f"{study.name}.csv", campaign.folder / f"{study.name}-trails.csv"
    _write(table, COLUMNS, _lines(campaign, cases))
    _write(trails, TRAIL_COLUMNS, _trail_lines(cases))
    return table, trails


def _lines(campaign: Campaign, cases: Cases) -> Iterator[Sequence[object]]:
    study = cases.study
    for (spec, label), row in cases.rows.items():
        base = cases.planned(spec, SEQ)
        yield (
            study.name, row.instance, *asdict(spec).values(), study.budgets, campaign.budget(study, spec),
            label, *(getattr(row, name) for name in _FIGURES), _gain(base, row),
        )  # fmt: skip


def _gain(base: Row | None, row: Row) -> float | None:
    if base is None or base.information is None or row.information is None:
        return None
    return gain(base.information, row.information)


def _trail_lines(cases: Cases) -> Iterator[Sequence[object]]:
    for (_, label), row in cases.rows.items():
        for moment in row.trail:
            yield cases.study.name, row.instance, label, *moment


def _write(path: Path, columns: Sequence[str], lines: Iterator[Sequence[object]]) -> None:
    with whole_file(path) as partial, partial.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(columns)
        writer.writerows(lines)
