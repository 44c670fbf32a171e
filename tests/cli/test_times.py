"""Times as they are typed."""

from __future__ import annotations

import pytest
import typer

from malipp_field.cli.times import utc_seconds


@pytest.mark.parametrize(
    "text",
    [
        "2027-01-15T12:00Z",
        "2027-01-15T12:00:00",
        " 2027-01-15 12:00 ",
        "20270115T1300+01",
        "2027-01-15T14:30+02:30",
    ],
)
def test_a_time_is_utc_unless_it_says_otherwise(text: str) -> None:
    assert utc_seconds(text) == 1_800_014_400.0


@pytest.mark.parametrize("text", ["", "tomorrow", "12:00", "2027-13-01T00:00Z", "2027-01-15T25:00"])
def test_what_is_no_time_is_refused(text: str) -> None:
    with pytest.raises(typer.BadParameter, match="is no time such as"):
        utc_seconds(text)
