"""The `malipp` command: what it consists of, and how its faults are told.

A fault the user can mend is one line on stderr and exit status 2, Ctrl-C is 130; `cli.status` has them all.
"""

from __future__ import annotations

import gc
import logging
import sys
from collections.abc import Callable
from typing import Annotated

import typer

from malipp_field import __version__
from malipp_field.cli.bench import bench
from malipp_field.cli.check import check
from malipp_field.cli.confirm import confirm
from malipp_field.cli.export import export
from malipp_field.cli.key import key
from malipp_field.cli.plan import plan, verify
from malipp_field.cli.review import review
from malipp_field.cli.run import run
from malipp_field.cli.script import script
from malipp_field.cli.sim import sim
from malipp_field.cli.status import INPUT_ERROR, INTERRUPTED
from malipp_field.cli.upload import upload, vehicles
from malipp_field.errors import MalippError

_GARBAGE_AFTER = 50_000
"""New objects before Python looks for garbage: importing makes many and leaves none."""

app = typer.Typer(
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    help="Plan, check, fly and review missions of sampling rovers that hand over samples at dead drops.",
    epilog="Begin with: malipp run missions/quarry.yaml --output runs/quarry",
)


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


# In the order in which they are needed, which is that of README.md and of `malipp --help`.
app.command(short_help="Plan a mission and write a verified plan.")(plan)
app.command(short_help="Check a plan against every rule of the paper.")(verify)
app.command(short_help="Check what would go wrong on the vehicles.")(check)
app.command(short_help="Write mission files for QGroundControl and others, and maps.")(export)
app.command(short_help="Write the payload script for ArduPilot rovers.")(script)
app.command(short_help="Make a signing key for a vehicle, and give it to it.")(key)
app.command(short_help="Put the missions of a plan on the vehicles.")(upload)
app.command(short_help="Show the vehicles, and what is on them.")(vehicles)
app.command(short_help="Start simulated MAVLink rovers on this machine.")(sim)
app.command(short_help="Plan, export, fly a simulated team, and review.")(run)
app.command(short_help="Say that what a vehicle waits for is done.")(confirm)
app.command(short_help="Make a Rerun recording and a summary of a mission.")(review)
app.command(short_help="Run the paper's experiments: tables, figures, a page.")(bench)


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
        message = message.replace("Value error, ", "")  # pydantic's, before the words that follow
        typer.echo(f"{where}: {message} (see {where} --help)", err=True)
        return INPUT_ERROR
    except MalippError as fault:
        typer.echo(str(fault), err=True)
        return INPUT_ERROR
    if result == INTERRUPTED:  # typer's word for a KeyboardInterrupt
        typer.echo("interrupted", err=True)
    return result if isinstance(result, int) else 0
