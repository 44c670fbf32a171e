"""Plan the shipped missions by every method, side by side, and print the results page.

    make bench            prints what benchmarks/README.md shows; --write replaces that page

Times depend on the machine; J, gains and ratios within one run are what to compare.
"""

from __future__ import annotations

import argparse
import datetime
import os
import platform
import sys
from importlib.metadata import version
from pathlib import Path

from malipp_field.field import information_model
from malipp_field.mission import Mission, read_mission
from malipp_field.mission.schema import Method
from malipp_field.plan import Plan
from malipp_field.planner import solve

ROOT = Path(__file__).resolve().parent
MISSIONS = ("corridor", "quarry")
METHODS: tuple[Method, ...] = ("seq", "no-handoffs", "exact")


def main() -> None:
    """Run the benchmark and print or write the page."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--time-limit", type=float, default=60.0, help="seconds for each plan (default 60)")
    parser.add_argument("--write", action="store_true", help="replace benchmarks/README.md")
    options = parser.parse_args()
    page = results_page(options.time_limit)
    print(page)
    if options.write:
        (ROOT / "README.md").write_text(page + "\n", encoding="utf-8")


def results_page(time_limit_s: float) -> str:
    """Return the results as a Markdown page."""
    rows = [
        "| mission | method | J | less than Seq-LIPP | proven J >= | gap | drops | status | s | time / Seq |",
        "| --- | --- | ---: | ---: | ---: | ---: | ---: | --- | ---: | ---: |",
    ]
    for name in MISSIONS:
        mission = read_mission(ROOT.parent / "missions" / f"{name}.yaml")
        plans = {method: _solved(mission, method, time_limit_s) for method in METHODS}
        rows += [_row(mission, method, plan, plans["seq"]) for method, plan in plans.items()]
    return "\n".join((_heading(time_limit_s), *rows, "", _footnote()))


def _solved(mission: Mission, method: Method, time_limit_s: float) -> Plan:
    print(f"{mission.name}: {method}, at most {time_limit_s:.0f} s ...", file=sys.stderr)
    return solve(mission, method=method, time_limit_s=time_limit_s)


def _row(mission: Mission, method: str, plan: Plan, baseline: Plan) -> str:
    if plan.objective is None or baseline.objective is None:
        return f"| {mission.name} | {method} | | | | | | {plan.status} | {plan.solve_time_s:.1f} | |"
    j, j_seq = plan.objective.information, baseline.objective.information
    bound = "" if plan.bound.information is None else f"{plan.bound.information:.4f}"
    gap = "" if plan.gap is None else f"{100 * plan.gap:.2f} %"
    return (
        f"| {mission.name} (prior {information_model(mission).prior:.2f}) | {method} | {j:.4f} | "
        f"{100 * (j_seq - j) / j_seq:.2f} % | {bound} | {gap} | {plan.handoffs} | {plan.status} | "
        f"{plan.solve_time_s:.1f} | {plan.solve_time_s / baseline.solve_time_s:.1f} |"
    )


def _heading(time_limit_s: float) -> str:
    return (
        "# Measured\n\n"
        "Planning the shipped missions by every method, in one run: `make bench` repeats it\n"
        "(`.venv/bin/python benchmarks/planning.py --write` replaces this page). Other pages: the exact\n"
        "planner against the paper's literal model ([exact.md](exact.md)), and the agreement of all exact\n"
        "methods ([agreement.md](agreement.md)), what it takes to start a command\n"
        "([startup.md](startup.md)), replanning ([replanning.md](replanning.md)), and the link to the\n"
        "vehicles ([link.md](link.md)). The paper's experiments at scale are a command of their own,\n"
        "`malipp bench` (`--page benchmarks/scale.md` writes their page and figures here):\n"
        "[claims.md](claims.md) says what came of them; what it chooses where the paper leaves\n"
        "something open is in `malipp_field/bench/instances.py`, `studies.py` and `tours.py`.\n\n"
        f"- limit for each plan: {time_limit_s:.0f} s\n"
        f"- date: {datetime.datetime.now(tz=datetime.UTC).date()}\n"
        f"- machine: {os.cpu_count()} cores, {platform.machine()}, {platform.system()}\n"
        f"- versions: Python {platform.python_version()}, "
        f"HiGHS {version('highspy')}, NumPy {version('numpy')}, networkx {version('networkx')}\n"
    )


def _footnote() -> str:
    return (
        "J is the weighted posterior variance at the test points (lower is better); *less than Seq-LIPP* is\n"
        "the paper's gain G. A status of `feasible` says that the limit came before the proof: the gap is\n"
        "what is still open between the plan and the proven bound. All plans passed the verifier."
    )


if __name__ == "__main__":
    main()
