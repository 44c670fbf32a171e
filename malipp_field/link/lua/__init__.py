"""The payload script that runs on a vehicle, for ArduPilot's scripting (see docs/vehicles.md)."""

from __future__ import annotations

from importlib.resources import files

SCRIPT_NAME = "malipp_payload.lua"


def payload_script() -> str:
    """Return the text of the script."""
    return files(__package__).joinpath(SCRIPT_NAME).read_text(encoding="utf-8")
