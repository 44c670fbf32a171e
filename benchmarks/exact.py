"""Measure the exact planner against the paper's literal model on tuned random instances, and write the table.

    python benchmarks/exact.py --sizes 2x10,3x12,4x14,6x18,8x20 --seeds 4 --time-limit 900 --write

Every plan is made in a process of its own, and kept in a file as soon as it is there: a run that is stopped
goes on where it was. Tuned instances are mission files beside it. The exit code is 1 if methods disagree.
"""

from __future__ import annotations

import argparse
import math
import shlex
import statistics
import sys
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

from malipp_field.bench import Comparison, Results, Row, Specification, Task, Worker, compare, tuned_mission
from malipp_field.bench.compare import TOLERANCE
from malipp_field.bench.page import provenance, table
from malipp_field.bench.script import ended
from malipp_field.mission import Mission

ROOT = Path(__file__).resolve().parent
RUNS = ROOT.parent / "runs" / "bench"
SIZES = "2x10,3x12,4x14,6x18,8x20"
EARLY_S = 60.0
SEQUENTIAL_LIMIT_S = 600.0
METHODS = {
    ("exact", True): "exact",
    ("exact", False): "exact, no handoffs",
    ("miqp", True): "literal MIQP",
}
Cases = dict[Specification, list[Row]]

_HOW_MEASURED = """\
Time is that of `solve` alone, in a process of its own that has planned a tiny mission before (imports and
compiled code loaded); memory is the peak of that process, all included. *Certified*: J proven to the relative
gap; *all stages*: energy and makespan as well. *Root gap*: between the first bound reported and the plan at
the end; 100 % where the first report came before any bound was known. Every plan passed the verifier.
"""
_HOW_COMPARED = """\
Time of the literal MIQP over that of exact, both with handoffs, geometric mean, where exact certified J.
Where the literal model did not end, its time so far is a lower bound: the last column counts it.
"""


def main() -> int:
    """Run what is missing, print the page, and tell whether all methods agree."""
    options = _options()
    tuned: dict[Specification, Mission] = {}
    for spec in _specifications(options):
        print(f"{spec.name}: instance", file=sys.stderr)
        tuned[spec] = tuned_mission(spec, options.instances)
    results = Results(options.results)
    cases: Cases = {}
    with Worker(memory_limit_mib=options.memory_limit) as worker:
        for spec, mission in tuned.items():
            cases[spec] = [_row(task, results, worker) for task in _tasks(mission, options)]
    agreement = sum((_agreement(rows) for rows in cases.values()), Comparison())
    page = "\n".join(_page(options, cases, agreement)) + "\n"
    print(page)
    if options.write:
        (ROOT / "exact.md").write_text(page, encoding="utf-8")
    return 1 if agreement.faults else 0


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--sizes", type=_sizes, default=SIZES, help=f"R x n, with commas (default {SIZES})")
    parser.add_argument("--seeds", type=int, default=4, help="instances of each size (default 4)")
    parser.add_argument("--time-limit", type=float, default=60.0, help="seconds for exact (default 60)")
    parser.add_argument(
        "--literal-limit", type=float, default=900.0,
        help="seconds for the literal model (default 900); 0 leaves it out",
    )  # fmt: skip
    parser.add_argument(
        "--test-points", choices=("random", "candidates"), default="random", help="where they lie"
    )
    parser.add_argument("--memory-limit", type=float, default=8192.0, help="MiB for each plan (default 8192)")
    parser.add_argument("--results", type=Path, default=RUNS / "exact.jsonl", help="file of all runs")
    parser.add_argument("--instances", type=Path, default=RUNS / "instances", help="folder of mission files")
    parser.add_argument("--write", action="store_true", help="replace benchmarks/exact.md")
    return parser.parse_args()


def _sizes(text: str) -> list[tuple[int, int]]:
    try:
        pairs = [tuple(map(int, part.split("x"))) for part in text.split(",")]
        return [(robots, candidates) for robots, candidates in pairs]
    except ValueError:
        raise argparse.ArgumentTypeError(f"'{text}' is not a list such as 2x10,3x12") from None


def _specifications(options: argparse.Namespace) -> list[Specification]:
    return [
        Specification(robots, candidates, seed, test_points=options.test_points)
        for robots, candidates in options.sizes
        for seed in range(options.seeds)
    ]


def _tasks(mission: Mission, options: argparse.Namespace) -> list[Task]:
    """Return the plans to be made of one instance, in the order of the run."""
    tasks = [
        Task(mission, "seq", handoffs=False, time_limit_s=SEQUENTIAL_LIMIT_S),
        Task(mission, "exact", handoffs=True, time_limit_s=options.time_limit),
        Task(mission, "exact", handoffs=False, time_limit_s=options.time_limit),
    ]
    if options.literal_limit > 0:
        tasks.append(Task(mission, "miqp", handoffs=True, time_limit_s=options.literal_limit))
    return tasks


def _row(task: Task, results: Results, worker: Worker) -> Row:
    row = results.find(task)
    if row is None:
        print(
            f"{task.mission.name}: {task.method}{'' if task.handoffs else ' without handoffs'}, "
            f"at most {task.time_limit_s:.0f} s ...",
            end=" ", file=sys.stderr, flush=True,
        )  # fmt: skip
        row = worker.fresh(task)
        results.add(row)
        print(f"{row.status} after {row.time_s:.1f} s", file=sys.stderr)
    return row


def _agreement(rows: Sequence[Row]) -> Comparison:
    """Compare the methods of one instance, and the plan with handoffs to the one without."""
    solved = [row for row in rows if row.method != "seq"]
    total = compare([row for row in solved if row.handoffs])
    total += compare([row for row in solved if not row.handoffs])
    plain = [row.information for row in rows if not row.handoffs and row.information is not None]
    faults = tuple(
        f"{row.instance}: bound {row.bound:.6f} of {row.method} lies above a plan without handoffs"
        for row in solved
        if row.handoffs and row.bound is not None and plain and row.bound > min(plain) * (1.0 + TOLERANCE)
    )
    return total + Comparison(faults=faults)


def _page(options: argparse.Namespace, cases: Cases, agreement: Comparison) -> list[str]:
    rows = [row for found in cases.values() for row in found]
    return [
        "# The exact planner, measured",
        "",
        *_verdict(agreement),
        "",
        f"Made by `python benchmarks/exact.py {shlex.join(sys.argv[1:])}`;",
        "a run that was stopped goes on when it is given again.",
        "",
        *provenance(rows),
        f"- limits: {options.time_limit:g} s for exact, {options.literal_limit:g} s for the literal MIQP; "
        "relative gap 1e-4",
        f"- instances: `malipp_field.bench.instances`, test points: {options.test_points}; "
        "budgets tuned for each, so that Seq-LIPP samples close to 54.5 % of the candidates",
        "",
        "## Certified, and how fast",
        "",
        *_certified_table(options, cases),
        "",
        _HOW_MEASURED,
        *_literal_section(cases),
        "## The instances",
        "",
        *_instance_table(cases),
        "",
        "Gains are over Seq-LIPP's J (the paper's G), of the plans at hand, proven or not.",
    ]


def _verdict(agreement: Comparison) -> list[str]:
    if not agreement.faults:
        return [
            f"Methods agree: {agreement.information} comparisons of proven J (to 1e-4), "
            f"{agreement.energy} of energy, {agreement.makespan} of makespan; no bound above any plan."
        ]
    return [f"**{len(agreement.faults)} DISAGREEMENTS OR FAULTS**", "", *(f"- {f}" for f in agreement.faults)]


def _certified_table(options: argparse.Namespace, cases: Cases) -> list[str]:
    heads = (
        "R x n", "method", "instances", f"certified in {EARLY_S:g} s", "at the limit", "all stages",
        "median s", "max s", "root gap, mean", "gap, mean", "gap, max", "peak MiB",
    )  # fmt: skip
    lines = []
    for key, method in METHODS.items():
        groups = [(f"{r} x {n}", _of(cases, (r, n), key)) for r, n in options.sizes]
        groups.append(("all", [row for _, rows in groups for row in rows]))
        lines += [(size, method, *_certified_line(rows)) for size, rows in groups if rows]
    return table(heads, lines)


def _certified_line(rows: Sequence[Row]) -> Iterable[str]:
    times = [row.time_s for row in rows]
    gaps = [row.gap for row in rows if row.gap is not None]
    roots = [row.root_gap for row in rows if row.root_gap is not None]
    peaks = [row.peak_mib for row in rows if row.peak_mib is not None]
    return (
        str(len(rows)),
        _share(rows, lambda row: row.certified and row.time_s <= EARLY_S),
        _share(rows, lambda row: row.certified),
        _share(rows, lambda row: row.status in {"optimal", "infeasible"}),
        f"{statistics.median(times):.1f}",
        f"{max(times):.1f}",
        _percent(roots, statistics.fmean),
        _percent(gaps, statistics.fmean),
        _percent(gaps, max),
        f"{max(peaks):.0f}" if peaks else "",
    )


def _literal_section(cases: Cases) -> list[str]:
    """Return the table of time ratios; nothing where the literal model was left out."""
    groups = sorted({(spec.robots, spec.candidates) for spec in cases})
    pairs = {size: _pairs(cases, size) for size in groups}
    if not any(pairs.values()):
        return []
    everything = [pair for found in pairs.values() for pair in found]
    named = [(f"{r} x {n}", found) for (r, n), found in pairs.items()] + [("all", everything)]
    heads = (
        "R x n", "pairs", "solved by the literal MIQP", "ratio where it ended", "ratio at least, over all",
    )  # fmt: skip
    return [
        "## Against the literal MIQP",
        "",
        *table(heads, [(size, *_ratio_line(found)) for size, found in named if found]),
        "",
        _HOW_COMPARED,
    ]


def _pairs(cases: Cases, size: tuple[int, int]) -> list[tuple[Row, Row]]:
    """Return (exact, literal) with handoffs of every instance of a size that has both and exact certified."""
    by_key = [
        {(row.method, row.handoffs): row for row in rows}
        for spec, rows in cases.items()
        if (spec.robots, spec.candidates) == size
    ]
    both = [(rows["exact", True], rows["miqp", True]) for rows in by_key if ("miqp", True) in rows]
    return [
        (exact, literal)
        for exact, literal in both
        if exact.certified and literal.status not in {"not available", "fault"}
    ]


def _ratio_line(pairs: Sequence[tuple[Row, Row]]) -> Iterable[str]:
    ended = [(exact, literal) for exact, literal in pairs if literal.certified]
    return (
        str(len(pairs)),
        f"{len(ended)} ({100 * len(ended) / len(pairs):.0f} %)",
        _mean_ratio(ended),
        _mean_ratio(pairs),
    )


def _mean_ratio(pairs: Sequence[tuple[Row, Row]]) -> str:
    if not pairs:
        return ""
    logs = [math.log(max(literal.time_s, 1e-3) / max(exact.time_s, 1e-3)) for exact, literal in pairs]
    return f"{math.exp(statistics.fmean(logs)):.1f}"


def _instance_table(cases: Cases) -> list[str]:
    lines = []
    for size in sorted({(spec.robots, spec.candidates) for spec in cases}):
        seq = _of(cases, size, ("seq", False))
        covered = [100 * row.sampled / row.candidates for row in seq if row.candidates]
        gains = [_gains(cases, size, handoffs) for handoffs in (False, True)]
        drops = [row.drops for row in _of(cases, size, ("exact", True)) if row.information is not None]
        coverage = f"{statistics.fmean(covered):.0f} % ({min(covered):.0f} to {max(covered):.0f})"
        lines.append((
            f"{size[0]} x {size[1]}", str(len(seq)), coverage if covered else "", *gains,
            f"{statistics.fmean(drops):.1f}" if drops else "",
        ))  # fmt: skip
    return table(
        ("R x n", "instances", "Seq-LIPP samples", "gain, no handoffs", "gain", "drops, mean"), lines
    )


def _gains(cases: Cases, size: tuple[int, int], handoffs: bool) -> str:
    gains = []
    for spec, rows in cases.items():
        j = {(row.method, row.handoffs): row.information for row in rows}
        base, now = j.get(("seq", False)), j.get(("exact", handoffs))
        if (spec.robots, spec.candidates) == size and base and now is not None:
            gains.append((base - now) / base)
    return _percent(gains, statistics.fmean)


def _of(cases: Cases, size: tuple[int, int], key: tuple[str, bool]) -> list[Row]:
    return [
        row
        for spec, rows in cases.items()
        for row in rows
        if (spec.robots, spec.candidates) == size
        and (row.method, row.handoffs) == key
        and row.status != "not available"
    ]


def _share(rows: Sequence[Row], holds: Callable[[Row], bool]) -> str:
    return f"{100 * sum(map(holds, rows)) / len(rows):.0f} %"


def _percent(values: Sequence[float], summary: Callable[[Sequence[float]], float]) -> str:
    return f"{100 * summary(values):.2f} %" if values else ""


if __name__ == "__main__":
    sys.exit(ended(main))
