"""Pieces of the pages that benchmarks write: tables, and what a figure must be read with."""

from __future__ import annotations

import os
import platform
from collections.abc import Iterable, Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from malipp_field.bench.tasks import Row, planner_fingerprint

_PACKAGES = ("highspy", "pyscipopt", "cvxpy", "numba", "numpy", "scipy")


def table(heads: Sequence[str], lines: Iterable[Sequence[str]]) -> list[str]:
    """Return a Markdown table; the first column is text, the others are figures."""
    rule = ["---"] + ["---:"] * (len(heads) - 1)
    return [f"| {' | '.join(cells)} |" for cells in (heads, rule, *lines)]


def provenance(rows: Sequence[Row]) -> list[str]:
    """Return the machine, the versions, the dates and the planner's code as a Markdown list."""
    dates = sorted({row.date for row in rows})
    codes = sorted({row.code for row in rows})
    present = "this" if codes == [planner_fingerprint()] else "not only this"
    return [
        *machine(_PACKAGES),
        f"- runs: {len(rows)}, on {' to '.join(dict.fromkeys((dates[0], dates[-1]))) if dates else 'no day'}",
        f"- fingerprint of the planner's code: {', '.join(codes)} ({present} tree's)",
    ]


def machine(packages: Iterable[str]) -> list[str]:
    """Return the machine, and the versions of Python and these packages, as a Markdown list."""
    versions = ", ".join(f"{name} {_version(name)}" for name in packages)
    return [
        f"- machine: {_processor()}, {os.cpu_count()} cores, {_memory_gib():.0f} GiB, {platform.system()}",
        f"- versions: Python {platform.python_version()}, {versions}",
    ]


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "absent"


def _processor() -> str:
    info = Path("/proc/cpuinfo")
    if info.exists():
        for line in info.read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.machine()


def _memory_gib() -> float:
    return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30
