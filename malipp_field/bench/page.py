"""Pieces of the pages that benchmarks write: tables, and what a figure must be read with."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from malipp_field.bench.machine import machine, versions
from malipp_field.bench.tasks import Row, planner_fingerprint


def table(heads: Sequence[str], lines: Iterable[Sequence[str]]) -> list[str]:
    """Return a Markdown table; the first column is text, the others are figures."""
    rule = ["---"] + ["---:"] * (len(heads) - 1)
    return [f"| {' | '.join(cells)} |" for cells in (heads, rule, *lines)]


def provenance(rows: Sequence[Row]) -> list[str]:
    """Return the machines, the versions, the dates and the planner's code as a Markdown list.

    Rows that do not say where they were made are taken to be of this machine.
    """
    dates = sorted({row.date for row in rows})
    codes = sorted({row.code for row in rows})
    present = "this" if codes == [planner_fingerprint()] else "not only this"
    return [
        f"- machine: {'; '.join(sorted({row.machine or machine() for row in rows})) or machine()}",
        f"- versions: {'; '.join(sorted({row.versions or versions() for row in rows})) or versions()}",
        f"- runs: {len(rows)}, on {' to '.join(dict.fromkeys((dates[0], dates[-1]))) if dates else 'no day'}",
        f"- fingerprint of the planner's code: {', '.join(codes)} ({present} tree's)",
    ]
