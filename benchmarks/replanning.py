"""Replan missions of 12 robots part-way, after something went wrong, within a fraction of a second.

    python benchmarks/replanning.py --write

Each instance is planned, the plan goes well until a random moment, then one thing happens (`happenings`), and
the rest is planned anew with the plan in force as warm start. Whether anything can be planned at all is asked
of the arc model afterwards, with time to spare. All random choices come from seeds; times are this machine's.
"""

from __future__ import annotations

import argparse
import math
import os
import random
import shlex
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from malipp_field.bench import Specification, build
from malipp_field.bench.page import provenance, table
from malipp_field.bench.script import ended
from malipp_field.mission import Mission, TeamState
from malipp_field.plan import Plan, advance, rest_of
from malipp_field.planner import solve, verify
from malipp_field.planner.exact.stages import plan_of_precision
from malipp_field.planner.extract import Verdict, payloads, plan_file, routes_of, team_plan
from malipp_field.planner.linear import Effort
from malipp_field.planner.problem import build_problem
from malipp_field.planner.progress import Search

ROOT = Path(__file__).resolve().parent
CANDIDATES, BUDGET_J = 45, 30.0
EARLIEST, LATEST = 0.1, 0.8
"""Of the makespan, for the moment at which something happens."""
MOST_LOST = 0.05
"""Of the energy a robot has left."""
SAME = 1e-9
"""Relative difference of J that is rounding."""
_ANSWER_S = 120.0
_HEADS = (
    "what happened", "replans", "possible", "planned", "proven impossible", "s, median", "s, 95 %",
    "processor s, 95 %", "in force stands", "then worse", "then better", "J less, mean", "else J more, mean",
)  # fmt: skip
_HOW_READ = f"""\
*Possible*: the arc model has a plan, or one was found. *In force stands*: the old plan, stop by stop, keeps
every rule in the new state; *worse* and *better* count the replans with a higher and a lower J among these,
and *J less* is by how much on average. *Else J more*: where it does not stand, J of the new plan above the J
that the old one promised. All plans passed the verifier, which is part of the time.

- *nothing*: the plan is looked at again.
- *energy*: every robot has up to {MOST_LOST:.0%} less of what it had left.
- *kernel*: the field's length scale is 0.6 to 1.6 times what it was.
- *robot*: one robot is out, with all on board; it counts as being at its depot without energy. What it took
  still counts in J, for the old plan as for the new.
- *drop*: what lies in one drop is not there (moments at which nothing lies anywhere are left out)."""


@dataclass(frozen=True)
class Case:
    """What is to be planned anew: where the team stands after what happened, and the plan in force."""

    kind: str
    mission: Mission
    state: TeamState
    rest: Plan


@dataclass(frozen=True)
class Replan:
    """How one replan went; J of the plan in force is what it would come to if it could be carried out."""

    kind: str
    time_s: float
    processor_s: float
    status: str
    possible: bool
    stands: bool
    in_force: float
    information: float | None


def main() -> int:
    """Measure, print the page, and write it where that is asked for."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--robots", type=int, default=12)
    parser.add_argument("--instances", type=int, default=6, help="instances planned (default 6)")
    parser.add_argument("--moments", type=int, default=4, help="moments in each plan (default 4)")
    parser.add_argument(
        "--plan-limit", type=float, default=5.0, help="seconds for the first plans (default 5)"
    )
    parser.add_argument("--limit", type=float, default=0.3, help="seconds for a replan (default 0.3)")
    parser.add_argument("--write", action="store_true", help="replace benchmarks/replanning.md")
    options = parser.parse_args()
    replans = []
    for number, case in enumerate(cases(options)):
        if number == 0:
            replan(case, options.limit)  # compiled code is loaded before anything is measured
        replans.append(replan(case, options.limit))
        print(f"{number + 1}: {case.mission.name}, {replans[-1]}", file=sys.stderr)
    page = "\n".join(_page(replans, options)) + "\n"
    print(page)
    if options.write:
        (ROOT / "replanning.md").write_text(page, encoding="utf-8")
    return int(any(r.possible and r.information is None for r in replans) or any(map(is_worse, replans)))


def cases(options: argparse.Namespace) -> Iterator[Case]:
    """Yield all that is to be planned anew."""
    for seed in range(options.instances):
        mission = build(Specification(options.robots, CANDIDATES, seed=seed), BUDGET_J)
        plan = solve(mission, method="auto", time_limit_s=options.plan_limit, seed=seed)
        assert plan.objective is not None, "nothing must come home yet, so that there is a plan"
        for moment in range(options.moments):
            rng = random.Random(1000 * seed + moment)  # noqa: S311 (choices that can be repeated)
            time_s = rng.uniform(EARLIEST, LATEST) * plan.objective.makespan_s
            yield from happenings(mission, advance(mission, plan, time_s), rest_of(plan, time_s), rng)


def happenings(mission: Mission, state: TeamState, rest: Plan, rng: random.Random) -> Iterator[Case]:
    """Yield what may happen at one moment, each on its own."""
    yield Case("nothing", mission, state, rest)
    shares = [1.0 - MOST_LOST * rng.random() for _ in state.robots]
    less = [
        robot.model_copy(update={"energy_left_j": share * robot.energy_left_j})
        for robot, share in zip(state.robots, shares, strict=True)
    ]
    yield Case("energy", mission, state.model_copy(update={"robots": tuple(less)}), rest)
    scale_m = mission.field.kernel.length_scale_m * rng.uniform(0.6, 1.6)
    kernel = mission.field.kernel.model_copy(update={"length_scale_m": scale_m})
    field = mission.field.model_copy(update={"kernel": kernel})
    yield Case("kernel", mission.model_copy(update={"field": field}), state, rest)
    robots, lost = list(state.robots), rng.randrange(len(state.robots))
    depot = mission.robot(robots[lost].id).depots[0]
    robots[lost] = robots[lost].model_copy(update={"node": depot, "energy_left_j": 0.0, "on_board": 0})
    yield Case("robot", mission, state.model_copy(update={"robots": tuple(robots)}), rest)
    if state.caches:
        gone = rng.randrange(len(state.caches))
        caches = tuple(cache for k, cache in enumerate(state.caches) if k != gone)
        yield Case("drop", mission, state.model_copy(update={"caches": caches}), rest)


def replan(case: Case, limit_s: float) -> Replan:
    """Plan a case anew, and judge the result."""
    began_s, used_s = time.perf_counter(), time.process_time()
    plan = solve(
        case.mission, state=case.state, method="auto", warm_start=case.rest, time_limit_s=limit_s, seed=0
    )
    time_s, processor_s = time.perf_counter() - began_s, time.process_time() - used_s
    information = None if plan.objective is None else plan.objective.information
    stands, in_force = judged(case)
    possible = information is not None or is_possible(case)
    return Replan(case.kind, time_s, processor_s, plan.status, possible, stands, in_force, information)


def judged(case: Case) -> tuple[bool, float]:
    """Return whether the plan in force still keeps every rule, and J of all that it samples."""
    problem = build_problem(case.mission, case.state)
    precision, position = problem.gained.copy(), {v: i for i, v in enumerate(problem.candidates)}
    routes = routes_of(problem, case.rest)
    for robot, route in zip(problem.robots, routes, strict=True):
        for visit in route:
            if visit.collect:
                precision[position[visit.node]] += visit.collect * robot.precision
    in_force = problem.information.value(precision)
    team = team_plan(problem, routes)
    sound = all(min(payloads(*one)) >= 0 for one in zip(problem.robots, routes, strict=True))
    if team is None or not sound:  # what is not on board cannot even be written down
        return False, in_force
    plan = plan_file(case.mission.name, problem, team, Verdict("old", "feasible", None, None, 0.0, 0, 1))
    return not verify(case.mission, plan, case.state), in_force


def is_possible(case: Case) -> bool:
    """Ask the arc model for a plan in which nobody samples and all that must come home does."""
    problem = build_problem(case.mission, case.state)
    if any(not robot.depots for robot in problem.robots):
        return False
    search = Search(Effort(time.monotonic() + _ANSWER_S), gap=1e-4)
    team, impossible = plan_of_precision(problem, search, problem.gained)
    if team is None and not impossible:
        print(f"not settled within {_ANSWER_S:.0f} s: {case.mission.name}, {case.kind}", file=sys.stderr)
    return not impossible


def is_worse(one: Replan) -> bool:
    """Tell whether a replan ends with more than a plan in force that could have been kept."""
    return one.stands and (one.information is None or one.information > one.in_force * (1.0 + SAME))


def is_better(one: Replan) -> bool:
    """Tell whether a replan ends with less than a plan in force that could have been kept."""
    return one.stands and one.information is not None and one.information < one.in_force * (1.0 - SAME)


def _page(replans: list[Replan], options: argparse.Namespace) -> list[str]:
    kinds = list(dict.fromkeys(one.kind for one in replans))
    lines = [_line(kind, [one for one in replans if one.kind == kind]) for kind in kinds]
    return [
        "# Replanning, measured",
        "",
        f"Made by `python benchmarks/replanning.py {shlex.join(sys.argv[1:])}`.",
        "",
        *provenance([])[:2],
        f"- {options.instances} instances of {options.robots} robots and {CANDIDATES} candidates"
        f" (carriers {BUDGET_J:g} J), {options.moments} moments in each",
        f"- limit for a replan: {options.limit:g} s; for the first plans {options.plan_limit:g} s",
        f"- load average at the end, other work included: {os.getloadavg()[0]:.1f}",
        "",
        *table(_HEADS, [*lines, _line("all", replans)]),
        "",
        _HOW_READ,
    ]


def _line(kind: str, replans: list[Replan]) -> tuple[str, ...]:
    times_s = [one.time_s for one in replans]
    standing = [one for one in replans if one.stands]
    changes = [
        (one.stands, one.information / one.in_force - 1.0) for one in replans if one.information is not None
    ]
    return (
        kind,
        str(len(replans)),
        str(sum(one.possible for one in replans)),
        str(sum(one.information is not None for one in replans)),
        str(sum(one.status == "infeasible" for one in replans)),
        f"{np.percentile(times_s, 50):.2f}",
        f"{np.percentile(times_s, 95):.2f}",
        f"{np.percentile([one.processor_s for one in replans], 95):.2f}",
        str(len(standing)),
        str(sum(map(is_worse, replans))),
        str(sum(map(is_better, replans))),
        _percent([-change for stands, change in changes if stands]),
        _percent([change for stands, change in changes if not stands]),
    )


def _percent(shares: list[float]) -> str:
    return f"{100.0 * math.fsum(shares) / len(shares):.2f} %" if shares else ""


if __name__ == "__main__":
    sys.exit(ended(main))
