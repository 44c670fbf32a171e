"""`malipp export`: mission files of ground stations, and maps."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from malipp_field.cli.check import show_faults
from malipp_field.cli.files import MissionFile, PlanFile, folder, verified
from malipp_field.cli.times import StartTime


class Format(StrEnum):
    """Mission file formats of ground stations, and formats of maps."""

    PLAN = "plan"
    WPL = "wpl"
    KML = "kml"
    GEOJSON = "geojson"


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
    from malipp_field.vehicle.export import export as write_exports

    mission, found = verified(mission_file, plan_file)
    folder(output)
    show_faults(mission, found, start)
    for path in write_exports(mission, found, file_format.value, output, start):
        typer.echo(path)
