"""`malipp script`: the payload script, to be put on vehicles."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def script(
    output: Annotated[
        Path, typer.Option("--output", "-o", metavar="FILE", help="Where to write the script.")
    ] = Path("malipp_payload.lua"),
) -> None:
    """Write the payload script for ArduPilot rovers (docs/vehicles.md says how to put it on one)."""
    from malipp_field.documents import whole_file
    from malipp_field.link.lua import payload_script

    with whole_file(output) as partial:
        partial.write_text(payload_script(), encoding="utf-8")
    typer.echo(f"script: {output}")
