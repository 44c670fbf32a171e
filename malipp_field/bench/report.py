"""The page of the studies: a table of the paper's figures and ours for each, and whether its claims hold."""

from __future__ import annotations

import itertools
import statistics
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

from malipp_field.bench import paper
from malipp_field.bench.cases import Cases, Mean, mean
from malipp_field.bench.instances import Specification
from malipp_field.bench.page import provenance, table
from malipp_field.bench.studies import SEQ
from malipp_field.bench.tasks import FAILED, Row

_SEEN_AT_S = (5.0, 30.0)
"""Times at which the study of scalability tells the gain, beside that at the end."""


_BUDGETS = {
    "tuned": "tuned for each instance, so that Seq-LIPP samples close to 54.5 % of the candidates",
    "tour": "half of the cost of a tour through all candidates with an empty robot, divided among the team",
    "fixed": "the same for every carrier at all sizes",
}
_HOW_READ = """\
Gains are the paper's G: by how many per cent J is below that of Seq-LIPP on the same instance. ± is half of
the 95 % confidence interval of the mean (1.96 s / sqrt(n)). Every plan passed the verifier: one that breaks a
rule never leaves the planner, and would be counted as failed. What the paper leaves open was chosen
(`malipp_field/bench/instances.py` and `studies.py` say how), so figures beside each other are not of the same
instances: shapes can be compared, single figures only with care.
"""


def report(found: Sequence[Cases], command: str, faults: Sequence[str], figures: dict[str, Path]) -> str:
    """Return the page.

    Parameters
    ----------
    found
        What is known of each study.
    command
        What made it.
    faults
        Instances that could not be made.
    figures
        The figure of each study, relative to the page.
    """
    rows = [row for cases in found for row in cases.rows.values()]
    lines = [
        "# Planning at scale, measured", "",
        f"Made by `{command}`;", "a run that was stopped goes on when it is given again.", "",
        *provenance(rows), "", _HOW_READ,
        *(["**Could not be made:**", "", *(f"- {fault}" for fault in faults), ""] if faults else []),
    ]  # fmt: skip
    for cases in found:
        lines += [f"## {cases.study.title}", "", *_setting(cases), ""]
        if cases.study.name in figures:
            lines += [f"![{cases.study.title}]({figures[cases.study.name].as_posix()})", ""]
        lines += [*_TABLES[cases.study.name](cases), ""]
        lines += [f"- {claim}" for claim in _CLAIMS[cases.study.name](cases)]
        lines += _failures(cases)
        lines.append("")
    return "\n".join(lines).rstrip() + "\n"


def _setting(cases: Cases) -> list[str]:
    study = cases.study
    arms = ", ".join(f"{arm.label} (`{arm.method}`, {arm.time_limit_s:g} s)" for arm in study.planned)
    points = " and ".join(sorted({cell.test_points for cell in study.cells}))
    threads = sorted({row.threads or 0 for row in cases.rows.values()})
    lines = [
        f"- {study.instances} of each kind of instance; test points: {points}",
        f"- budgets: {_BUDGETS[study.budgets]}",
        f"- methods and their limits: {arms}; threads for each plan: "
        + (", ".join(str(count or "all") for count in threads) or "-"),
    ]
    if study.missing:
        missing = ", ".join(f"{arm.label} (`{arm.method}`)" for arm in study.missing)
        lines.append(f"- not measured, since this planner does not have it: {missing}")
    return lines


def _failures(cases: Cases) -> list[str]:
    """Return a line for every plan that failed, and one that counts those without a plan."""
    lines = [
        f"- **{row.status}**: {row.instance}, {label}: {row.reason}"
        for (_, label), row in cases.rows.items()
        if row.status in FAILED
    ]
    none = sum(row.information is None and row.status not in FAILED for row in cases.rows.values())
    expected = len(cases.study.specifications) * len(cases.study.planned)
    if none:
        lines.append(f"- {none} of {len(cases.rows)} runs ended without a plan")
    if len(cases.rows) < expected:
        lines.append(f"- **{expected - len(cases.rows)} of {expected} runs are missing**")
    return lines


def _joint_table(cases: Cases) -> list[str]:
    lines = []
    for cell in cases.study.cells:
        for label in _others(cases):
            rows = cases.of(cell, label)
            drops = _show(mean([float(row.drops) for row in rows])) if label == "full" else ""
            told = paper.JOINT_DROPS.get(cell.robots)
            lines.append((
                _size(cell), label, str(len(cases.pairs(cell, label))),
                _number(paper.JOINT_GAINS.get(label, {}).get(cell.robots)),
                _show(mean(cases.gains(cell, label))),
                _number(told) if label == "full" else "", drops,
                _share(rows, lambda row: row.certified), _coverage(cases, cell),
            ))  # fmt: skip
    heads = (
        "R x n", "method", "instances", "gain %, paper", "gain %, here", "drops, paper", "drops, here",
        "J certified", "Seq-LIPP samples",
    )  # fmt: skip
    return table(heads, lines)


def _joint_claims(cases: Cases) -> list[str]:
    plain = [mean(cases.gains(cell, "no handoffs")) for cell in cases.study.cells]
    full = [mean(cases.gains(cell, "full")) for cell in cases.study.cells]
    pairs = [pair for cell in cases.study.cells for pair in cases.pairs(cell, "full", base="no handoffs")]
    worse = sum(_j(row) > _j(base) * (1.0 + base.mip_gap) for base, row in pairs)
    return [
        _claim("joint planning gains over Seq-LIPP at every size", _all_above(plain)),
        _claim("dead drops add to that at every size", _ordered(zip(plain, full, strict=True))),
        _claim("the gain with dead drops grows with the team", _rising(full)),
        _claim(
            "full is never worse than without handoffs"
            + (f" (worse in {worse} of {len(pairs)})" if worse else ""),
            None if not pairs else worse == 0,
        ),
    ]


def _sweep_table(cases: Cases) -> list[str]:
    ratios, masses = _axes(cases)
    lines = [(f"{ratio:g}", *(_show(_at(cases, ratio, mass)) for mass in masses)) for ratio in ratios]
    heads = ("noise ratio, gain %", *(f"{mass:g} kg" for mass in masses))
    return table(heads, lines)


def _sweep_claims(cases: Cases) -> list[str]:
    ratios, masses = _axes(cases)
    rising = [_rising([_at(cases, ratio, mass) for ratio in ratios]) for mass in masses]
    peaks = []
    for ratio in ratios:
        row = [_at(cases, ratio, mass) for mass in masses]
        values = [found.value for found in row if found is not None]
        peaks.append(None if len(values) < len(row) else 0 < values.index(max(values)) < len(values) - 1)
    words = ", ".join(f"{mass:g} kg" for mass, holds in zip(masses, rising, strict=True) if holds)
    peaked = ", ".join(f"{ratio:g}" for ratio, holds in zip(ratios, peaks, strict=True) if holds)
    return [
        _claim(
            f"the gain grows with the noise ratio at every mass (it does at: {words or 'none'})",
            _every(rising),
        ),
        _claim(
            f"the gain peaks at an intermediate mass (it does at the ratios: {peaked or 'none'})",
            _every(peaks),
        ),
    ]


def _optimality_table(cases: Cases) -> list[str]:
    lines = []
    sizes = sorted({cell.robots for cell in cases.study.cells})
    for label in _others(cases):
        groups = [(f"{robots} robots", [robots]) for robots in sizes] + [("all", sizes)]
        lines += [(name, label, *_optimality_line(cases, label, robots)) for name, robots in groups]
    lines.append((
        "all, paper", "LNS", "334", "100 %", f"{paper.MATCHED_PERCENT} %", f"{paper.NEAR_PERCENT} %", "", "",
    ))  # fmt: skip
    heads = (
        "", "method", "certified", "with a plan", "matched to 1e-5", "within 1 %", "worst %", "longest s",
    )  # fmt: skip
    return table(heads, lines)


def _optimality_line(cases: Cases, label: str, robots: Sequence[int]) -> Iterable[str]:
    certified = [
        (spec, exact)
        for spec in cases.study.specifications
        if spec.robots in robots and (exact := cases.planned(spec, "exact")) is not None and exact.certified
    ]
    pairs = [(exact, row) for spec, exact in certified if (row := cases.planned(spec, label)) is not None]
    above = [_j(row) / _j(exact) - 1.0 for exact, row in pairs]
    count = len(certified)
    return (
        str(count),
        _part(len(pairs), count),
        _part(sum(gap <= paper.MATCH for gap in above), count),
        _part(sum(gap <= paper.NEAR for gap in above), count),
        _number(100.0 * max([0.0, *above]) if above else None),
        f"{max(row.time_s for _, row in pairs):.1f}" if pairs else "",
    )


def _optimality_claims(cases: Cases) -> list[str]:
    exact = [row for cell in cases.study.cells for row in cases.of(cell, "exact")]
    done = sum(row.certified for row in exact)
    return [
        f"exact certified {done} of {len(cases.study.specifications)} instances; the others do not "
        "count. A plan below the certified J, by less than the gap of the certificate, counts as matched"
    ]


def _scalability_table(cases: Cases) -> list[str]:
    lines = []
    for cell in cases.study.cells:
        seq = [row.time_s for row in cases.of(cell, SEQ)]
        for label in _others(cases):
            at = [mean(cases.gains_at(cell, label, time_s) or []) for time_s in _SEEN_AT_S]
            rows = cases.of(cell, label)
            lines.append((
                _size(cell), label, str(len(cases.pairs(cell, label))),
                _number(paper.SCALABILITY_GAINS.get(cell.robots)), *map(_show, at),
                _show(mean(cases.gains(cell, label))), _show(mean(cases.most_gains(cell, label))),
                f"{statistics.fmean(row.time_s for row in rows):.0f}" if rows else "",
                f"{statistics.fmean(seq):.0f}" if seq else "", _coverage(cases, cell),
            ))  # fmt: skip
    heads = (
        "R x n", "method", "instances", "gain %, paper, 1800 s",
        *(f"gain % at {at_s:g} s" for at_s in _SEEN_AT_S),
        "at the end", "no plan gains more", "mean s", "Seq-LIPP, mean s", "Seq-LIPP samples",
    )  # fmt: skip
    return table(heads, lines)


def _scalability_claims(cases: Cases) -> list[str]:
    lines = []
    for label in _others(cases):
        ends = [mean(cases.gains(cell, label)) for cell in cases.study.cells]
        lines.append(_claim(f"{label} gains over Seq-LIPP at every size", _all_above(ends)))
    return lines


def _growth_table(cases: Cases) -> list[str]:
    lines = []
    for cell in cases.study.cells:
        for arm in cases.study.planned:
            rows = cases.of(cell, arm.label)
            firsts = [row.first_plan_s for row in rows if row.first_plan_s is not None]
            peaks = [row.peak_mib for row in rows if row.peak_mib is not None]
            lines.append((
                _size(cell), arm.label, f"{len(rows)} of {cases.study.instances}",
                f"{statistics.fmean(firsts):.1f}" if firsts else "",
                f"{statistics.fmean(row.time_s for row in rows):.1f}" if rows else "",
                f"{max(peaks):.0f}" if peaks else "",
                _show(mean(cases.gains(cell, arm.label))) if arm.label != SEQ else "",
                _show(mean([float(row.drops) for row in rows])),
            ))  # fmt: skip
    heads = ("R x n", "method", "plans", "first plan, s", "end, s", "peak MiB", "gain %", "drops")
    return table(heads, lines)


def _growth_claims(_: Cases) -> list[str]:
    return [
        "time is that of planning alone; memory is the peak of the process, Python and libraries included"
    ]


def _axes(cases: Cases) -> tuple[list[float], list[float]]:
    ratios = sorted({cell.noise_ratio for cell in cases.study.cells})
    return ratios, sorted({cell.sample_mass_kg for cell in cases.study.cells})


def _at(cases: Cases, ratio: float, mass_kg: float) -> Mean | None:
    for cell in cases.study.cells:
        if (cell.noise_ratio, cell.sample_mass_kg) == (ratio, mass_kg):
            return mean(cases.gains(cell, "full"))
    return None


def _others(cases: Cases) -> list[str]:
    """Return the labels of all arms but the one that the others are measured against."""
    return [arm.label for arm in cases.study.planned if arm.label not in {SEQ, "exact"}]


def _claim(words: str, holds: bool | None) -> str:
    verdict = {None: "cannot be told", True: "holds here", False: "**does not hold here**"}[holds]
    return f"{words}: {verdict}"


def _every(answers: Sequence[bool | None]) -> bool | None:
    return None if None in answers or not answers else all(answers)


def _all_above(gains: Sequence[Mean | None]) -> bool | None:
    return _every([None if found is None else found.value > 0.0 for found in gains])


def _ordered(pairs: Iterable[tuple[Mean | None, Mean | None]]) -> bool | None:
    return _every([None if a is None or b is None else b.value > a.value for a, b in pairs])


def _rising(gains: Sequence[Mean | None]) -> bool | None:
    return _ordered(itertools.pairwise(gains)) if len(gains) > 1 else None


def _coverage(cases: Cases, cell: Specification) -> str:
    shares = [100.0 * row.sampled / row.candidates for row in cases.of(cell, SEQ) if row.candidates]
    return f"{statistics.fmean(shares):.0f} %" if shares else ""


def _size(cell: Specification) -> str:
    return f"{cell.robots} x {cell.candidates}"


def _show(found: Mean | None) -> str:
    return "" if found is None else str(found)


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.2f}"


def _share(rows: Sequence[Row], holds: Callable[[Row], bool]) -> str:
    return _part(sum(map(holds, rows)), len(rows))


def _part(count: int, of: int) -> str:
    return f"{100.0 * count / of:.1f} %" if of else ""


def _j(row: Row) -> float:
    assert row.information is not None
    return row.information


_TABLES: dict[str, Callable[[Cases], list[str]]] = {
    "joint": _joint_table,
    "sweep": _sweep_table,
    "optimality": _optimality_table,
    "scalability": _scalability_table,
    "growth": _growth_table,
}
_CLAIMS: dict[str, Callable[[Cases], list[str]]] = {
    "joint": _joint_claims,
    "sweep": _sweep_claims,
    "optimality": _optimality_claims,
    "scalability": _scalability_claims,
    "growth": _growth_claims,
}
