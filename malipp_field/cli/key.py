"""`malipp key`: a signing key for a vehicle, made, and given to it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from malipp_field.cli.files import known_robot
from malipp_field.errors import MalippError

if TYPE_CHECKING:
    from malipp_field.link import VehicleLink


def key(
    key_file: Annotated[Path, typer.Argument(metavar="FILE", help="The key file.")],
    setup: Annotated[
        str | None,
        typer.Option("--setup", metavar="ROBOT", help="Give the key to this robot's vehicle, over its link."),
    ] = None,
    mission_file: Annotated[
        Path | None, typer.Option("--mission", metavar="MISSION", help="Mission file that knows the robot.")
    ] = None,
    link: Annotated[
        str | None,
        typer.Option(metavar="URL", help="Link to use in place of the mission's, such as a cable."),
    ] = None,
) -> None:
    """Make a MAVLink 2 signing key that only you can read; with --setup give it to a vehicle.

    A key crosses the link in clear: use a cable. An existing file is never overwritten.
    """
    from malipp_field.link.keys import make_key_file

    if setup is None:
        if mission_file or link:
            raise MalippError("--mission and --link go with --setup ROBOT")
        make_key_file(key_file)
        typer.echo(
            f"{key_file}: made. Name it as signing_key in the mission file, then, over a cable: "
            f"malipp key {key_file} --setup ROBOT --mission MISSION"
        )
        return
    if mission_file is None:
        raise MalippError("--setup ROBOT needs --mission MISSION, which knows its link")
    _give(key_file, setup, mission_file, link)


def _give(key_file: Path, robot: str, mission_file: Path, link: str | None) -> None:
    import asyncio
    import dataclasses

    from malipp_field.link import KeyRing, vehicle_link
    from malipp_field.mission import read_mission
    from malipp_field.mission.link_url import parse_link_url

    mission = read_mission(mission_file)
    known_robot(mission_file, mission, robot)
    settings = mission.vehicle(robot)
    if link is not None:
        try:
            settings = settings.model_copy(update={"link": str(parse_link_url(link))})
        except ValueError as fault:
            raise MalippError(f"--link {fault}") from None
    changed = settings.model_copy(update={"signing_key": None})
    mission = mission.model_copy(update={"vehicles": {**mission.vehicles, robot: changed}})
    with KeyRing() as keys:
        where = dataclasses.replace(
            vehicle_link(mission, robot, mission_file.parent, keys), key=keys.key(key_file)
        )
        had_it = asyncio.run(_set_up(where))
    typer.echo(f"{robot}: {'has had the key already' if had_it else 'signs with the key'}")


async def _set_up(where: VehicleLink) -> bool:
    from malipp_field.clock import WallClock
    from malipp_field.link import Links
    from malipp_field.link.setup_signing import give_key

    clock = WallClock()
    async with Links(clock) as links:
        return await give_key(links, where, clock)
