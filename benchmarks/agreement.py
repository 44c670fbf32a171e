"""Let every exact method plan the same small random missions, and report where they do not agree.

    python benchmarks/agreement.py --write

Missions of mixed generality (several depots, starts anywhere, one-way edges, limits above one, sample mass
0, part-way states) come from the tests; more from the benchmark's generator. What is done is kept in a file:
a run that is stopped goes on where it was. The exit code is 1 if anything disagrees.
"""

from __future__ import annotations

import argparse
import importlib
import shlex
import sys
import time
from dataclasses import dataclass
from pathlib import Path

from malipp_field.bench import Comparison, Results, Row, Specification, Task, Worker, build, compare, run_task
from malipp_field.bench.compare import SAME, TOLERANCE
from malipp_field.bench.page import provenance, table
from malipp_field.bench.script import ended
from malipp_field.bench.tasks import unfinished
from malipp_field.mission import Mission, TeamState

ROOT = Path(__file__).resolve().parent
sys.path.insert(0, str(ROOT.parent / "tests" / "planner"))
brute_force = importlib.import_module("brute_force")
random_missions = importlib.import_module("random_missions")

METHODS = ("exact", "arcs", "miqp", "brute")
GAP = 1e-6
"""Relative, asked of every method, so that all stages can be compared."""

_HOW_COMPARED = f"""\
Relative tolerance {TOLERANCE:g} in all three. Energy is compared where J is the same to {SAME:g}, makespan
where energy is the same to {SAME:g} as well; exhaustive search has no makespan. No bound and no proven
optimum may lie above any other method's plan, proven or not; two proofs that there is no plan agree.
"""
_HOW_RUN = """\
*brute* is the exhaustive search of the tests, on the tiniest missions only. All plans of the others passed
the verifier. *Confirms exact*: missions for which both have proven their result, and agree."""


@dataclass(frozen=True)
class Case:
    """A mission, where its team stands, and whether it may hand over."""

    kind: str
    mission: Mission
    state: TeamState | None = None
    handoffs: bool = True

    @property
    def tiny(self) -> bool:
        """Tell whether exhaustive search ends in seconds."""
        candidates = sum(node.role == "candidate" for node in self.mission.site.nodes)
        return candidates <= {1: 4, 2: 3 if self.state is None else 2}.get(len(self.mission.team.robots), 0)


def main() -> int:
    """Run what is missing, print the page, and tell whether all methods agree."""
    options = _options()
    results = Results(options.results)
    cases = tiny_cases(options.tiny) + generated_cases(options.generated)
    found: list[tuple[Case, list[Row]]] = []
    with Worker(run_or_search, grace_s=60.0) as worker:
        for number, case in enumerate(cases, 1):
            print(f"{number} of {len(cases)}: {case.mission.name}", file=sys.stderr)
            tasks = [
                _task(case, method, options) for method in options.methods if method != "brute" or case.tiny
            ]
            found.append((case, [_row(task, results, worker) for task in tasks]))
    agreements = [compare(rows) for _, rows in found]
    total = sum(agreements, Comparison())
    page = "\n".join(_page(options, found, agreements, total)) + "\n"
    print(page)
    if options.write:
        (ROOT / "agreement.md").write_text(page, encoding="utf-8")
    return 1 if total.faults else 0


def tiny_cases(count: int) -> list[Case]:
    """Return missions of mixed generality, one a seed: R = 1 to 3, n = 2 to 5, a quarter of them part-way."""
    cases = []
    for seed in range(1000, 1000 + count):
        mission = random_missions.tiny_mission(seed, robots=1 + seed % 3, candidates=2 + seed // 3 % 4)
        state = random_missions.part_way(mission, seed) if seed % 4 == 3 else None
        cases.append(Case("mixed, part-way" if state else "mixed", mission, state, handoffs=seed % 5 != 4))
    return cases


def generated_cases(count: int) -> list[Case]:
    """Return instances of the generator at R = 2 and 3, n = 6, with budgets from tight to loose."""
    return [
        Case("generated", build(Specification(2 + seed % 2, 6, seed), 30.0 + 10.0 * (seed // 2 % 4)))
        for seed in range(count)
    ]


def run_or_search(task: Task) -> Row:
    """Run a task; the method "brute" is the tests' exhaustive search."""
    if task.method != "brute":
        return run_task(task)
    started = time.monotonic()
    truth = brute_force.optimum(task.mission, task.state, handoffs=task.handoffs)
    time_s = time.monotonic() - started
    if truth is None:
        return unfinished(task, "infeasible", "by exhaustive search", time_s)
    found = {"information": truth[0], "energy_j": truth[1], "bound": truth[0]}
    return unfinished(task, "optimal", "by exhaustive search", time_s).model_copy(update=found)


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--tiny", type=int, default=200, help="missions of mixed generality (default 200)")
    parser.add_argument("--generated", type=int, default=40, help="instances of the generator (default 40)")
    parser.add_argument(
        "--methods", type=_methods, default=",".join(METHODS), help="with commas (default all)"
    )
    parser.add_argument("--time-limit", type=float, default=120.0, help="seconds for each plan (default 120)")
    parser.add_argument(
        "--results", type=Path, default=ROOT.parent / "runs" / "bench" / "agreement.jsonl",
        help="file of all runs",
    )  # fmt: skip
    parser.add_argument("--write", action="store_true", help="replace benchmarks/agreement.md")
    return parser.parse_args()


def _methods(text: str) -> tuple[str, ...]:
    wanted = tuple(text.split(","))
    unknown = set(wanted) - set(METHODS)
    if unknown:
        raise argparse.ArgumentTypeError(f"{', '.join(sorted(unknown))}: known are {', '.join(METHODS)}")
    return wanted


def _task(case: Case, method: str, options: argparse.Namespace) -> Task:
    return Task(
        case.mission, method, case.handoffs, time_limit_s=options.time_limit, mip_gap=GAP, state=case.state
    )


def _row(task: Task, results: Results, worker: Worker) -> Row:
    row = results.find(task)
    if row is None:
        row = worker.run(task)
        results.add(row)
    return row


def _page(
    options: argparse.Namespace,
    found: list[tuple[Case, list[Row]]],
    agreements: list[Comparison],
    total: Comparison,
) -> list[str]:
    rows = [row for _, case_rows in found for row in case_rows]
    faults = [f"- {fault}" for fault in total.faults]
    verdict = f"**{len(faults)} DISAGREEMENTS OR FAULTS**" if faults else "No disagreement."
    return [
        "# Agreement of the exact methods",
        "",
        f"{verdict} {len(found)} missions; {total.information} pairs of proven J compared, {total.energy} of "
        f"energy, {total.makespan} of makespan.",
        "",
        *([*faults, ""] if faults else []),
        f"Made by `python benchmarks/agreement.py {shlex.join(sys.argv[1:])}`;",
        "a run that was stopped goes on when it is given again.",
        "",
        *provenance(rows),
        f"- limit {options.time_limit:g} s and relative gap {GAP:g} for each plan",
        "",
        "## Comparisons",
        "",
        *_comparison_table(found, agreements),
        "",
        _HOW_COMPARED,
        "## Methods",
        "",
        *_method_table(options, found),
        "",
        _HOW_RUN,
    ]


def _comparison_table(found: list[tuple[Case, list[Row]]], agreements: list[Comparison]) -> list[str]:
    lines = []
    for kind in dict.fromkeys(case.kind for case, _ in found):
        own = [agreed for (case, _), agreed in zip(found, agreements, strict=True) if case.kind == kind]
        total = sum(own, Comparison())
        counts = (total.information, total.energy, total.makespan, len(total.faults))
        lines.append((kind, str(len(own)), *map(str, counts)))
    return table(("missions", "number", "J", "energy", "makespan", "disagreements"), lines)


def _method_table(options: argparse.Namespace, found: list[tuple[Case, list[Row]]]) -> list[str]:
    lines = []
    for method in options.methods:
        rows = [row for _, case_rows in found for row in case_rows if row.method == method]
        rows = [row for row in rows if row.status != "not available"]
        endings = (
            sum(row.status == "optimal" for row in rows),
            sum(row.status == "infeasible" for row in rows),
            sum(row.status in {"feasible", "no_plan"} for row in rows),
            sum(row.status in {"fault", "crashed", "killed", "out of memory"} for row in rows),
        )
        longest = f"{max(row.time_s for row in rows):.1f}" if rows else ""
        confirmed = (
            "" if method == "exact" else str(sum(_confirmed(found_rows, method) for _, found_rows in found))
        )
        lines.append((method, str(len(rows)), *map(str, endings), longest, confirmed))
    heads = (
        "method", "missions", "proven", "proven infeasible", "limit", "failed", "longest s", "confirms exact",
    )  # fmt: skip
    return table(heads, lines)


def _confirmed(rows: list[Row], method: str) -> bool:
    """Tell whether a method and exact have both proven their result for one mission, and agree."""
    pair = compare([row for row in rows if row.method in {"exact", method}])
    return pair.information == 1 and not pair.faults


if __name__ == "__main__":
    sys.exit(ended(main))
