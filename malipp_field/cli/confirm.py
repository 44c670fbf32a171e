"""`malipp confirm`: a person's word on what the vehicles of a team wait for."""

from __future__ import annotations

import asyncio
import sys
from typing import TYPE_CHECKING, Annotated

import typer

from malipp_field.cli.files import MissionFile, known_robot
from malipp_field.errors import LinkError

if TYPE_CHECKING:
    from malipp_field.bus import Awaited, Bus, Confirm
    from malipp_field.mission import Mission

_HEAR_S = 6.0


def confirm(
    mission_file: MissionFile,
    robot: Annotated[
        str | None, typer.Argument(metavar="[ROBOT]", help="Confirm what this one waits for, unasked.")
    ] = None,
    connect: Annotated[
        str,
        typer.Option(
            envvar="MALIPP_BUS", metavar="ADDRESS", help="The bus of the mission, as `malipp run` prints it."
        ),
    ] = "",
    failed: Annotated[
        str | None,
        typer.Option(metavar="WORDS", help="It is not done, for this reason; the vehicle goes on."),
    ] = None,
    value: Annotated[
        float | None, typer.Option(metavar="X", help="Reading of the sample that was collected.")
    ] = None,
) -> None:
    """Show what the vehicles wait for a person to do, and say that it is done.

    Without ROBOT it lists what waits and, on a terminal, asks about each. A vehicle goes on as soon as its
    action is confirmed, done or not.
    """
    from malipp_field.mission import read_mission

    mission = read_mission(mission_file)
    if robot is not None:
        known_robot(mission_file, mission, robot)
    if robot is None and (failed is not None or value is not None):
        raise LinkError("say which ROBOT's action that is")
    if not connect:
        raise LinkError("say where the mission's bus is: --connect ADDRESS, or MALIPP_BUS=ADDRESS beforehand")
    asyncio.run(_confirm(mission, robot, connect, failed, value))


async def _confirm(
    mission: Mission, robot: str | None, connect: str, failed: str | None, value: float | None
) -> None:
    from malipp_field.bus import Bus, Confirm

    async with Bus(connect=(connect,)) as bus:
        waiting = await _waiting(mission, bus, connect)
        if robot is not None:
            if robot not in waiting:
                raise LinkError(f"{robot} waits for nobody")
            word = Confirm(uid=waiting[robot].uid, ok=failed is None, text=failed or "", value=value)
            await _say(mission, bus, robot, waiting[robot], word)
            return
        if not waiting:
            typer.echo("nothing waits for a person")
        for name, awaited in waiting.items():
            typer.echo(f"{name}: {awaited}")
            answer = _asked(awaited) if sys.stdin.isatty() else None
            if answer is not None:
                await _say(mission, bus, name, awaited, answer)


async def _waiting(mission: Mission, bus: Bus, connect: str) -> dict[str, Awaited]:
    """Return what waits, by robot, the longest first."""
    from malipp_field.bus import Telemetry, vehicle_key

    heard: dict[str, Telemetry] = {}
    news = asyncio.Event()

    def hear(_: str, telemetry: Telemetry) -> None:
        heard[telemetry.robot] = telemetry
        if len(heard) == len(mission.team.robots):
            news.set()

    await bus.subscribe(vehicle_key(mission.name, "*", "telemetry"), Telemetry, hear)
    try:
        await asyncio.wait_for(news.wait(), _HEAR_S)
    except TimeoutError:
        silent = [robot.id for robot in mission.team.robots if robot.id not in heard]
        if not heard:
            raise LinkError(f"mission '{mission.name}' is not heard at {connect}: is it running?") from None
        typer.echo(f"not heard: {', '.join(silent)}", err=True)
    found = {robot: t.awaits for robot, t in heard.items() if t.awaits is not None}
    return dict(sorted(found.items(), key=lambda entry: entry[1].since_s))


def _asked(awaited: Awaited) -> Confirm | None:
    """Ask about one action until the answer is one; `None` leaves it as it is."""
    from malipp_field.bus import Confirm
    from malipp_field.vehicle.steps import Action

    reading = "a number: done with this reading, " if awaited.action is Action.COLLECT else ""
    question = f"  y: done, {reading}n: not done, Enter: leave it"
    while True:
        answer = typer.prompt(question, default="", show_default=False, prompt_suffix="? ").strip()
        if not answer:
            return None
        if answer.lower() in ("y", "yes"):
            return Confirm(uid=awaited.uid)
        if answer.lower() in ("n", "no"):
            words = typer.prompt("  what is wrong", default="not done").strip()
            return Confirm(uid=awaited.uid, ok=False, text=words)
        try:
            if awaited.action is Action.COLLECT:
                return Confirm(uid=awaited.uid, value=float(answer.replace(",", ".")))
        except ValueError:
            pass
        typer.echo(f"  '{answer}' is none of these")


async def _say(mission: Mission, bus: Bus, robot: str, awaited: Awaited, word: Confirm) -> None:
    from malipp_field.clock import WallClock
    from malipp_field.control.orders import Orders

    reply = await Orders(mission.name, bus, WallClock()).give(robot, word)
    if not reply.ok:
        raise LinkError(f"{robot}: not confirmed: {reply.text}")
    typer.echo(f"{robot}: {awaited}: {'done' if word.ok else 'not done'}, the vehicle goes on")
