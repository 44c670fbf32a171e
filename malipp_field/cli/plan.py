"""`malipp plan` and `malipp verify`, and what `malipp run` shares with them."""

from __future__ import annotations

from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from malipp_field.cli.files import MissionFile, PlanFile, writable
from malipp_field.cli.status import INFEASIBLE, INPUT_ERROR, LIMIT_REACHED

if TYPE_CHECKING:
    from malipp_field.mission import Mission
    from malipp_field.plan import Plan


class Method(StrEnum):
    """How to plan."""

    AUTO = "auto"
    EXACT = "exact"
    NO_HANDOFFS = "no-handoffs"
    SEQ = "seq"
    MIQP = "miqp"
    ARCS = "arcs"
    LNS = "lns"
    FAST = "fast"


Seconds = Annotated[
    float | None, typer.Option("--time-limit", min=0.001, metavar="S", help="Seconds to plan.")
]


def plan(
    mission_file: MissionFile,
    output: Annotated[Path, typer.Option("--output", "-o", metavar="PLAN", help="Where to write the plan.")],
    method: Annotated[
        Method | None,
        typer.Option(
            help="How to plan; the mission file's where not given. exact proves its plan, no-handoffs the "
            "same without drops; fast finds good plans in seconds, for teams of any size, and then a bound, "
            "or the proof where a team is small; auto does the same and says which of the two it took. seq "
            "plans robot by robot, lns is the paper's search over pairs of robots (both prove nothing), miqp "
            "solves the paper's model to the letter, arcs an arc model by outer approximation."
        ),
    ] = None,
    handoffs: Annotated[
        bool | None,
        typer.Option("--handoffs/--no-handoffs", help="Allow dead drops, or not; seq never makes any."),
    ] = None,
    time_limit: Seconds = None,
    gap: Annotated[
        float | None,
        typer.Option(
            min=0.0, metavar="G", help="Relative gap (J less its bound, by J) at which a method may stop."
        ),
    ] = None,
    seed: Annotated[
        int | None, typer.Option(min=0, metavar="N", help="Seed of every random choice, of all methods.")
    ] = None,
    threads: Annotated[
        int | None,
        typer.Option(
            min=1, metavar="N", help="Cores for all methods that can use more than one; all where not given."
        ),
    ] = None,
    work: Annotated[
        int | None,
        typer.Option(
            min=1,
            metavar="N",
            help="Stop after so many rounds of the exact engine and of fast (pairs of lns): unlike a time "
            "limit, the same plan on every machine with as many cores (miqp passes over it).",
        ),
    ] = None,
    explain: Annotated[
        bool,
        typer.Option(
            "--explain", help="Say what holds the plan back and what its drops save, by planning again."
        ),
    ] = False,
    explain_limit: Annotated[
        float | None,
        typer.Option(
            min=0.001, metavar="S", help="Seconds for --explain; the time limit of the plan if not given."
        ),
    ] = None,
) -> None:
    """Plan a mission and write a verified plan. Ctrl-C ends planning with the best plan so far.

    Exit status: 0 with a plan, 3 when there is provably none, 4 when the limit came first.
    """
    from malipp_field.mission import read_mission
    from malipp_field.plan import write_plan

    mission = read_mission(mission_file)
    writable(output, mission_file)
    options = {
        "method": None if method is None else method.value,
        "handoffs": handoffs,
        "mip_gap": gap,
        "seed": seed,
        "threads": threads,
        "work_limit": work,
    }
    limit_s = mission.planner.time_limit_s if time_limit is None else time_limit
    found = _solve_until_interrupted(mission, {**options, "time_limit_s": limit_s})
    write_plan(found, output)
    show_plan(mission, found)
    stop_without_routes(found)
    typer.echo(f"plan: {output}")
    if explain:
        _explain(mission, found, options, explain_limit or limit_s)


def verify(mission_file: MissionFile, plan_file: PlanFile) -> None:
    """Check a plan against every rule of the paper; each broken one is a line on stderr.

    Exit status: 0 when every rule is kept, 2 when not, 3 or 4 for a plan file that says why there is no plan.
    """
    from malipp_field.mission import read_mission
    from malipp_field.plan import read_plan_of
    from malipp_field.planner import verify as find_violations

    mission = read_mission(mission_file)
    candidate = read_plan_of(mission, plan_file)
    violations = find_violations(mission, candidate)
    for violation in violations:
        typer.echo(f"{plan_file}: {violation}", err=True)
    if violations:
        raise typer.Exit(INPUT_ERROR)
    if not candidate.robots:
        show_plan(mission, candidate)
    stop_without_routes(candidate)
    typer.echo(f"{plan_file}: every rule is kept")


def solve_mission(mission: Mission, options: dict[str, Any]) -> Plan:
    """Plan a mission, with a line of progress."""
    from malipp_field.cli.display import ProgressLine
    from malipp_field.planner import method_for, solve

    with ProgressLine("planning") as line:
        found = solve(mission, **options, on_progress=line.planning)
    if (options.get("method") or mission.planner.method) == "auto":
        typer.echo("auto took {}: {}".format(*method_for(mission)), err=True)
    return found


def _solve_until_interrupted(mission: Mission, options: dict[str, Any]) -> Plan:
    from malipp_field.cli.interrupt import Interruption

    with Interruption() as interruption:
        found = solve_mission(mission, {**options, "cancelled": lambda: interruption.asked})
    if interruption.asked:
        typer.echo("interrupted: this is the best plan so far", err=True)
    return found


def _explain(mission: Mission, found: Plan, options: dict[str, Any], limit_s: float) -> None:
    """Say why a plan is as it is; the first Ctrl-C ends the questions, not the answer."""
    from malipp_field.cli.display import ProgressLine, out
    from malipp_field.cli.explain import print_explanation
    from malipp_field.cli.interrupt import Interruption
    from malipp_field.planner import solve
    from malipp_field.planner.explain import explain, settings

    again = partial(solve, **(options | settings(found)))
    with Interruption() as interruption, ProgressLine("explaining") as line:
        explanation = explain(
            mission, found, time_limit_s=limit_s, solve=again, on_progress=line.show,
            cancelled=lambda: interruption.asked,
        )  # fmt: skip
    print_explanation(explanation, out)


def show_plan(mission: Mission, found: Plan) -> None:
    """Print a plan as a table, and what it achieves; or why there is none."""
    from malipp_field.cli.display import out, plan_table, plan_words
    from malipp_field.field import information_model

    if found.robots:
        out.print(plan_table(mission, found))
    out.print(plan_words(found, information_model(mission).prior), soft_wrap=True)


def stop_without_routes(found: Plan) -> None:
    """End the command where there is no plan, with the status that says why."""
    if found.status == "infeasible":
        raise typer.Exit(INFEASIBLE)
    if found.status == "no_plan":
        raise typer.Exit(LIMIT_REACHED)
