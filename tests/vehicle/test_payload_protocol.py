import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from malipp_field.vehicle.payload_protocol import (
    MAX_TEXT,
    PayloadReport,
    format_confirmation,
    parse_confirmation,
)
from malipp_field.vehicle.steps import MAX_RUN, MAX_TAG, Action


@settings(deadline=None)
@given(
    number=st.integers(1, 2**32 - 1),
    action=st.sampled_from(Action),
    tag=st.integers(0, MAX_TAG),
    value=st.none() | st.floats(allow_nan=False, allow_infinity=False, width=32),
    run=st.integers(0, MAX_RUN),
)
def test_a_confirmation_survives_the_way_and_fits_into_one_statustext(
    number: int, action: Action, tag: int, value: float | None, run: int
) -> None:
    text = format_confirmation(number, action, tag, "ok", value, run)
    report = parse_confirmation(text)
    assert len(text.encode("ascii")) <= MAX_TEXT
    assert report is not None
    assert (report.number, report.action, report.tag, report.ok, report.run) == (
        number, action, tag, True, run,
    )  # fmt: skip
    if value is None:
        assert report.value is None
    elif number < 100 or run == 0:
        assert report.value == pytest.approx(value, rel=1e-8)
    else:
        assert report.value == pytest.approx(value, rel=0.5)  # rounded to the room there is


def test_the_longest_confirmation_has_room_for_one_digit_of_a_reading() -> None:
    text = format_confirmation(2**32 - 1, Action.COLLECT, MAX_TAG, "ok", -1.23456789e-300, MAX_RUN)
    assert text == "MLP 4294967295 collect 32767 ok k=16383 v=-1e-300"
    assert len(text) == MAX_TEXT - 1


def test_the_texts_are_the_contract_with_the_script_on_board() -> None:
    assert format_confirmation(3, Action.COLLECT, 17, "ok", 0.25) == "MLP 3 collect 17 ok v=0.25"
    assert format_confirmation(3, Action.DROP, 17, "ok", 0.25, 12) == "MLP 3 drop 17 ok k=12 v=0.25"
    assert format_confirmation(4, Action.PICK, 17, "missing") == "MLP 4 pick 17 missing"
    assert parse_confirmation("MLP 4 pick 17 missing\0\0") == PayloadReport(4, Action.PICK, 17, "missing")
    report = parse_confirmation("MLP 5 pick 17 full")
    assert report is not None
    assert not report.ok


@pytest.mark.parametrize(
    "text",
    [
        "Reached waypoint #3",
        "",
        "MLP",
        "MLP 0 collect 17 ok",
        "MLP -1 collect 17 ok",
        "MLP 1 dance 17 ok",
        "MLP 1 collect 17 done",
        "MLP 1 collect 17 ok v=much",
        f"MLP 1 collect 17 ok v={math.inf}",
        "MLP 1 collect 17 ok v=1 2",
        "MLP 1 collect 17 ok k=0",
        "MLP 1 collect 17 ok k=-3",
        "MLP 1 collect 17 ok v=1 k=3",
        "xMLP 1 collect 17 ok",
    ],
)
def test_anything_else_is_no_confirmation(text: str) -> None:
    assert parse_confirmation(text) is None
