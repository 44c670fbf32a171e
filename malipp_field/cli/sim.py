"""`malipp sim`: the rovers of a mission, simulated."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from malipp_field.cli.files import MissionFile

if TYPE_CHECKING:
    from malipp_field.mission import Mission


def sim(
    mission_file: MissionFile,
    port: Annotated[
        int, typer.Option(min=1024, max=65000, metavar="PORT", help="UDP port of the first rover.")
    ] = 14551,
    speed: Annotated[
        float, typer.Option(min=0.1, max=200.0, metavar="X", help="Simulated seconds for each second.")
    ] = 1.0,
) -> None:
    """Start the mission's rovers as simulated MAVLink vehicles on this machine, until interrupted."""
    import asyncio

    from malipp_field.mission import read_mission

    mission = read_mission(mission_file)
    asyncio.run(_simulate(mission, mission_file.parent, port, speed))


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
        typer.echo("Ctrl-C stops them.")
        await clock.run()
