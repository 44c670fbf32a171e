"""The `malipp` command, of which this module has plan, verify, export, sim, run and review.

A fault the user can mend is one line on stderr and exit status 2. `plan` and `run` exit with 3 when the
mission is proven infeasible and with 4 when a limit came before the first plan, `run` with 5 when not every
sample came home. Ctrl-C is 130.
"""

from __future__ import annotations

import gc
import logging
import os
import sys
from collections.abc import Callable
from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from malipp_field import __version__
from malipp_field.cli.bench import bench
from malipp_field.cli.check import check, show_faults
from malipp_field.cli.confirm import confirm
from malipp_field.cli.files import MissionFile, PlanFile, verified
from malipp_field.cli.key import key
from malipp_field.cli.script import script
from malipp_field.cli.times import StartTime
from malipp_field.cli.upload import upload, vehicles
from malipp_field.errors import InputError, MalippError, PlanError

if TYPE_CHECKING:
    from malipp_field.mission import Mission
    from malipp_field.plan import Plan

INPUT_ERROR, INFEASIBLE, LIMIT_REACHED, INCOMPLETE, INTERRUPTED = 2, 3, 4, 5, 130
_GARBAGE_AFTER = 50_000
"""New objects before Python looks for garbage: importing makes many and leaves none."""

app = typer.Typer(
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    help="Plan, export, fly and review missions of sampling rovers that hand over samples at dead drops.",
    epilog="Begin with: malipp run missions/quarry.yaml --output runs/quarry",
)


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


class Format(StrEnum):
    """Mission file formats of ground stations, and formats of maps."""

    PLAN = "plan"
    WPL = "wpl"
    KML = "kml"
    GEOJSON = "geojson"


Seconds = Annotated[
    float | None, typer.Option("--time-limit", min=0.001, metavar="S", help="Seconds to plan.")
]
Speed = Annotated[
    float | None,
    typer.Option("--speed", min=0.1, max=200.0, metavar="X", help="Simulated seconds for each second."),
]


def _version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"malipp {__version__}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Show the version.")
    ] = False,
) -> None:
    pass


@app.command()
def plan(
    mission_file: MissionFile,
    output: Annotated[Path, typer.Option("--output", "-o", metavar="PLAN", help="Where to write the plan.")],
    method: Annotated[
        Method | None,
        typer.Option(
            help="How to plan; the mission file's where not given. exact proves its plan, no-handoffs the "
            "same without drops; fast finds good plans in seconds, for teams of any size, and bounds them; "
            "auto is exact for small teams, else fast. seq plans robot by robot, lns is the paper's search "
            "over pairs of robots (both prove nothing), miqp solves the paper's model to the letter, arcs an "
            "arc model by outer approximation."
        ),
    ] = None,
    handoffs: Annotated[
        bool | None,
        typer.Option("--handoffs/--no-handoffs", help="Allow dead drops, or not; seq never makes any."),
    ] = None,
    time_limit: Seconds = None,
    gap: Annotated[
        float | None,
        typer.Option(min=0.0, help="Relative gap (J less its bound, by J) at which a method may stop."),
    ] = None,
    seed: Annotated[
        int | None, typer.Option(min=0, help="Seed of every random choice, of all methods.")
    ] = None,
    threads: Annotated[
        int | None,
        typer.Option(min=1, help="Cores for all methods that can use more than one; all where not given."),
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
    from malipp_field.plan import write_plan

    mission = _mission(mission_file)
    _writable(output, mission_file)
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
    _show_plan(mission, found)
    _stop_without_routes(found)
    typer.echo(f"plan: {output}")
    if explain:
        _explain(mission, found, options, explain_limit or limit_s)


@app.command(short_help="Check a plan against every rule of the paper.")
def verify(mission_file: MissionFile, plan_file: PlanFile) -> None:
    """Check a plan against every rule of the paper; each broken one is a line on stderr.

    Exit status: 0 when every rule is kept, 2 when not, 3 or 4 for a plan file that says why there is no plan.
    """
    from malipp_field.plan import read_plan
    from malipp_field.planner import verify as find_violations

    mission, candidate = _mission(mission_file), read_plan(plan_file)
    violations = find_violations(mission, candidate)
    for violation in violations:
        typer.echo(f"{plan_file}: {violation}", err=True)
    if violations:
        raise typer.Exit(INPUT_ERROR)
    if not candidate.robots:
        _show_plan(mission, candidate)
    _stop_without_routes(candidate)
    typer.echo(f"{plan_file}: every rule is kept")


@app.command(short_help="Write mission files for QGroundControl and others, and maps.")
def export(
    mission_file: MissionFile,
    plan_file: PlanFile,
    file_format: Annotated[
        Format,
        typer.Option(
            "--format", help="plan: QGroundControl; wpl: QGC WPL 110; kml, geojson: one map of all."
        ),
    ],
    output: Annotated[Path, typer.Option("--output", "-o", metavar="DIR", help="Folder to write to.")],
    start: StartTime = None,
) -> None:
    """Write one vehicle mission file a robot, or a map, and what ties each item to its stop and samples.

    What `malipp check` finds wrong with them is said on stderr; the files are written all the same.
    """
    mission, found = verified(mission_file, plan_file)
    _folder(output)
    show_faults(mission, found, start)
    for path in _export(mission, found, file_format, output, start):
        typer.echo(path)


@app.command(short_help="Start simulated MAVLink rovers on this machine.")
def sim(
    mission_file: MissionFile,
    port: Annotated[int, typer.Option(min=1024, max=65000, help="UDP port of the first rover.")] = 14551,
    speed: Annotated[
        float, typer.Option(min=0.1, max=200.0, metavar="X", help="Simulated seconds for each second.")
    ] = 1.0,
) -> None:
    """Start the mission's rovers as simulated MAVLink vehicles on this machine, until interrupted."""
    import asyncio

    mission = _mission(mission_file)
    asyncio.run(_simulate(mission, mission_file.parent, port, speed))


@app.command(short_help="Plan, export, fly a simulated team, and review.")
def run(
    mission_file: MissionFile,
    output: Annotated[Path, typer.Option("--output", "-o", metavar="DIR", help="Folder for all results.")],
    plan_file: Annotated[
        Path | None, typer.Option("--plan", metavar="PLAN", help="Fly this plan instead of planning.")
    ] = None,
    time_limit: Seconds = None,
    speed: Speed = None,
    listen: Annotated[
        str | None,
        typer.Option(metavar="ADDRESS", help="Where the bus listens, such as tcp/127.0.0.1:7447; any port."),
    ] = None,
) -> None:
    """Plan, export, fly with simulated rovers, record and review, all in one.

    Exit status: 0 when every sample taken is home, 5 when not; 3 when there is provably no plan, 4 when the
    limit came first.
    """
    from malipp_field.cli.whole_run import RESULTS, whole_run
    from malipp_field.plan import write_plan

    mission = _mission(mission_file)
    given = None if plan_file is None else verified(mission_file, plan_file)[1]
    _folder(output)
    _folder(output / "export")
    for name in RESULTS:
        _writable(output / name, mission_file)
    found = given or _solve(mission, {"time_limit_s": time_limit})
    write_plan(found, output / "plan.json")
    _show_plan(mission, found)
    _stop_without_routes(found)
    if show_faults(mission, found):
        raise PlanError("the missions of the plan are not to be uploaded")
    if not whole_run(mission, mission_file, found, output, speed, listen):
        raise typer.Exit(INCOMPLETE)


@app.command(short_help="Make a Rerun recording and a summary of a mission.")
def review(
    recording: Annotated[Path, typer.Argument(metavar="RUN.mcap", help="A recording of a mission.")],
    output: Annotated[
        Path | None,
        typer.Option(
            "--output", "-o", metavar="RRD", help="The Rerun recording; beside RUN.mcap if not given."
        ),
    ] = None,
    open_viewer: Annotated[bool, typer.Option("--open", help="Open it in the Rerun viewer.")] = False,
) -> None:
    """Make a Rerun recording and a summary from a mission recording alone."""
    from malipp_field.cli.whole_run import review_recording

    if recording.is_dir():
        raise InputError(str(recording), None, "", "is a folder; name the recording in it (run.mcap)")
    target = output or recording.with_suffix(".rrd")
    _writable(target, recording)
    review_recording(recording, target)
    typer.echo(f"review: {target}")
    if open_viewer:
        os.execv(sys.executable, [sys.executable, "-m", "rerun", str(target)])


app.command(short_help="Check vehicle missions before an upload.")(check)
app.command(short_help="Put the missions of a plan on the vehicles.")(upload)
app.command(short_help="Show the vehicles, and what is on them.")(vehicles)
app.command(short_help="Say that what a vehicle waits for is done.")(confirm)
app.command(short_help="Run the paper's experiments: tables, figures, a page.")(bench)
app.command(short_help="Write the payload script for ArduPilot rovers.")(script)
app.command(short_help="Make a signing key for a vehicle, and give it to it.")(key)


def _mission(path: Path) -> Mission:
    from malipp_field.mission import read_mission

    return read_mission(path)


def _solve(mission: Mission, options: dict[str, Any]) -> Plan:
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
        found = _solve(mission, {**options, "cancelled": lambda: interruption.asked})
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


def _show_plan(mission: Mission, found: Plan) -> None:
    from malipp_field.cli.display import out, plan_table, plan_words
    from malipp_field.field import information_model

    if found.robots:
        out.print(plan_table(mission, found))
    out.print(plan_words(found, information_model(mission).prior), soft_wrap=True)


def _stop_without_routes(found: Plan) -> None:
    if found.status == "infeasible":
        raise typer.Exit(INFEASIBLE)
    if found.status == "no_plan":
        raise typer.Exit(LIMIT_REACHED)


def _export(
    mission: Mission, found: Plan, file_format: Format, output: Path, start_s: float | None
) -> list[Path]:
    from malipp_field.vehicle.export import export as write_exports

    return write_exports(mission, found, file_format.value, output, start_s)


def _folder(path: Path) -> None:
    """Refuse a folder for results that is something else already."""
    if path.exists() and not path.is_dir():
        raise InputError(str(path), None, "", "is not a folder")


def _writable(path: Path, source: Path) -> None:
    """Find out before the work, not after it, that its result cannot be written, or not over ``source``."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as fault:
        raise InputError(str(path.parent), None, "", f"cannot be made: {fault.strerror}") from None
    if path.exists() and not path.is_file():
        # Results are moved into place whole, which would replace a device or a pipe by a file.
        raise InputError(str(path), None, "", "cannot be written: it is not an ordinary file")
    if path.exists() and source.exists() and path.samefile(source):
        raise InputError(str(path), None, "", "cannot be written: it is what is to be read")
    if not os.access(path if path.exists() else path.parent, os.W_OK):
        raise InputError(str(path), None, "", "cannot be written")


async def _simulate(mission: Mission, folder: Path, port: int, speed: float) -> None:
    from malipp_field.clock import SimClock, WallClock
    from malipp_field.link.keys import read_key
    from malipp_field.sim import Fleet

    key_files = {robot: settings.signing_key for robot, settings in mission.vehicles.items()}
    keys = {robot: read_key(folder / name) for robot, name in key_files.items() if name}
    clock = SimClock(WallClock().now_s(), speed)
    async with Fleet(mission, clock, first_port=port, keys=keys) as fleet:
        for robot, url in fleet.links.items():
            signed = ", signed" if robot in keys else ""
            typer.echo(f"{robot}: system {fleet.rovers[robot].system_id}{signed}, connect with {url}")
        typer.echo("Interrupt (Ctrl-C) to stop.")
        await clock.run()


def main(arguments: list[str] | None = None) -> None:
    """Run the command line and exit with its status."""
    gc.set_threshold(_GARBAGE_AFTER)
    logging.basicConfig(level=logging.WARNING, format="%(levelname)s %(name)s: %(message)s")
    given = (sys.argv[1:] if arguments is None else arguments) or ["--help"]
    sys.exit(_status(lambda: app(given, prog_name="malipp", standalone_mode=False)))


def _status(command: Callable[[], object]) -> int:
    try:
        result = command()
    except typer.TyperException as fault:
        context = getattr(fault, "ctx", None)
        where = "malipp" if context is None else context.command_path
        message = " ".join(str(getattr(fault, "format_message", fault.__str__)()).split())
        typer.echo(f"{where}: {message} (see {where} --help)", err=True)
        return INPUT_ERROR
    except MalippError as fault:
        typer.echo(str(fault), err=True)
        return INPUT_ERROR
    if result == INTERRUPTED:  # typer's word for a KeyboardInterrupt
        typer.echo("interrupted", err=True)
    return result if isinstance(result, int) else 0
