"""Times as they are typed."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Annotated

import typer


def utc_seconds(text: str) -> float:
    """Return an ISO 8601 time in seconds since the Unix epoch; it is UTC unless it says otherwise.

    Raises
    ------
    typer.BadParameter
        When it is no such time.
    """
    try:
        time = datetime.fromisoformat(text.strip())
    except ValueError:
        raise typer.BadParameter(f"'{text}' is no time such as 2026-11-22T16:00Z") from None
    return (time if time.tzinfo else time.replace(tzinfo=UTC)).timestamp()


StartTime = Annotated[
    float | None,
    typer.Option(
        "--start",
        parser=utc_seconds,
        metavar="UTC",
        help="When the mission starts, such as 2027-05-04T09:30Z; without it no gate opens by time.",
    ),
]
