"""`malipp run`: a mission from its plan to its review, with simulated rovers."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from malipp_field.cli.check import show_faults
from malipp_field.cli.files import MissionFile, folder, verified, writable
from malipp_field.cli.plan import Seconds, show_plan, solve_mission, stop_without_routes
from malipp_field.cli.status import INCOMPLETE
from malipp_field.errors import PlanError

Speed = Annotated[
    float | None,
    typer.Option("--speed", min=0.1, max=200.0, metavar="X", help="Simulated seconds for each second."),
]


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
    from malipp_field.clock import WallClock
    from malipp_field.mission import read_mission
    from malipp_field.plan import write_plan

    mission = read_mission(mission_file)
    given = None if plan_file is None else verified(mission_file, plan_file)[1]
    folder(output)
    folder(output / "export")
    for name in RESULTS:
        writable(output / name, mission_file)
    found = given or solve_mission(mission, {"time_limit_s": time_limit})
    write_plan(found, output / "plan.json")
    show_plan(mission, found)
    stop_without_routes(found)
    if show_faults(mission, found, WallClock().now_s(), fence=False):
        raise PlanError("the missions of the plan are not to be uploaded")
    if not whole_run(mission, mission_file, found, output, speed, listen):
        raise typer.Exit(INCOMPLETE)
