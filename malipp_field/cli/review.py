"""`malipp review`: a recording, made into something to look at."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Annotated

import typer

from malipp_field.cli.files import writable
from malipp_field.errors import InputError


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
    writable(target, recording)
    review_recording(recording, target)
    typer.echo(f"review: {target}")
    if open_viewer:
        os.execv(sys.executable, [sys.executable, "-m", "rerun", str(target)])
