from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from link_cases import UNHURRIED, mission_items

from malipp_field.link.compare import PLACE_TOLERANCE_M, differences
from malipp_field.sim.items import RefusedItemError, stored
from malipp_field.vehicle.items import MissionItem

HOME = mission_items(1)[0]
FLOATS = st.floats(-70000, 70000, width=32)


def waypoint(**changes: Any) -> MissionItem:
    item = MissionItem(1, 3, 16, 0, 1, 0.0, 0.0, 0.0, 0.0, 340000000, -1180000000, 0.0)
    return item._replace(**changes)


def script(**changes: Any) -> MissionItem:
    item = MissionItem(1, 2, 42702, 0, 1, 2.0, 0.0, 3.0, 1.0, 17, 0, 0.0)
    return item._replace(**changes)


def compare(sent: MissionItem, there: MissionItem) -> list[str]:
    return differences([HOME, sent], [HOME, there])


@UNHURRIED
@given(
    hold=st.integers(0, 65535), lat=st.floats(-89, 89), lon=st.floats(-180, 180), z=st.floats(-300, 9000),
    frame=st.sampled_from([0, 3, 5, 6, 10, 11]), nan=st.booleans(),
)  # fmt: skip
def test_waypoints_that_fit_compare_equal(
    hold: int, lat: float, lon: float, z: float, frame: int, nan: bool
) -> None:
    sent = waypoint(
        param1=hold, x=round(lat * 1e7), y=round(lon * 1e7), z=float(np.float32(z)), frame=frame,
        param4=math.nan if nan else 0.0,
    )  # fmt: skip
    assert compare(sent, stored(sent, 0)) == []


@UNHURRIED
@given(
    code=st.integers(0, 255), stop=st.integers(0, 2048), count=st.integers(0, 99), tag=st.integers(0, 32767)
)
def test_script_items_that_fit_compare_equal(code: int, stop: int, count: int, tag: int) -> None:
    sent = script(param1=code, param3=stop, param4=count, x=tag)
    assert compare(sent, stored(sent, 0)) == []


@UNHURRIED
@given(params=st.tuples(FLOATS, FLOATS, FLOATS, FLOATS), x=st.integers(-40000, 40000))
def test_script_items_compare_equal_exactly_when_the_script_gets_what_was_sent(
    params: tuple[float, float, float, float], x: int
) -> None:
    p1, p2, p3, p4 = params
    sent = script(param1=p1, param2=p2, param3=p3, param4=p4, x=x)
    there = stored(sent, 0)
    kept = (
        math.trunc(p1) == there.param1
        and math.trunc(p2) == there.param2
        and all(
            abs(a - b) <= max(abs(a) * 2.0**-10, 2.0**-24)
            for a, b in ((p3, there.param3), (p4, there.param4))
        )
        and -(2**15) <= x < 2**15
    )
    assert (compare(sent, there) == []) is kept


@UNHURRIED
@given(north_m=st.floats(-3, 3), east_m=st.floats(-3, 3))
def test_places_compare_by_distance(north_m: float, east_m: float) -> None:
    sent = waypoint()
    metre_e7 = 1e7 / 111_320
    there = waypoint(
        x=round(sent.x + north_m * metre_e7),
        y=round(sent.y + east_m * metre_e7 / math.cos(math.radians(34.0))),
    )
    distance_m = math.hypot(north_m, east_m)
    assume(abs(distance_m - PLACE_TOLERANCE_M) > 0.05)
    assert (compare(sent, there) == []) is (distance_m < PLACE_TOLERANCE_M)


@UNHURRIED
@given(lat=st.floats(-80, 80), lon=st.floats(-60, 60))
def test_places_that_went_through_float32_compare_equal(lat: float, lon: float) -> None:
    sent = waypoint(x=round(lat * 1e7), y=round(lon * 1e7))
    there = waypoint(x=round(float(np.float32(lat)) * 1e7), y=round(float(np.float32(lon)) * 1e7))
    assert compare(sent, there) == []


@pytest.mark.parametrize(
    ("sent", "there", "words"),
    [
        (waypoint(param1=70000), waypoint(param1=4464), "param1 is 4464, not 70000"),
        (waypoint(param2=5), waypoint(), "param2 is 0, not 5"),
        (script(param1=258), script(), "param1 is 2, not 258"),
        (script(), script(x=18), "x is 18, not 17"),
        (script(), waypoint(), "NAV_WAYPOINT is on board instead"),
        (waypoint(frame=0), waypoint(frame=3), "frame is 3, not 0"),
        (waypoint(z=2.5), waypoint(z=0), "altitude is 0 m, not 2.5 m"),
        (waypoint(param1=3), waypoint(param1=math.nan), "param1 is nan, not 3"),
        (waypoint(param1=math.inf), waypoint(param1=0), "param1 is 0, not inf"),
    ],
)
def test_differences_are_told_in_words(sent: MissionItem, there: MissionItem, words: str) -> None:
    assert [text.split(": ", 1)[1] for text in compare(sent, there)] == [words]
    assert compare(sent, there)[0].startswith(f"item 1 (NAV_{'WAYPOINT' if sent.command == 16 else 'SCRIPT'}")


def test_whole_missions() -> None:
    sent = mission_items(6)
    there = [stored(item, 0) for item in sent]
    assert differences(sent, [there[0]._replace(x=0, y=0), *there[1:]]) == []  # home is the vehicle's own
    assert differences(sent, there[:4]) == ["3 items after home on board, not 5"]
    assert differences(sent[:4], there) == ["5 items after home on board, not 3"]
    assert differences(sent[:1], []) == []
    swapped = [there[0], there[2], there[1], *there[3:]]
    assert [text.split(" ")[1] for text in differences(sent, swapped)] == ["1", "2"]


@UNHURRIED
@given(st.lists(st.booleans(), min_size=1, max_size=8), st.randoms(use_true_random=False))
def test_a_mixed_mission_is_found(kinds: list[bool], random: object) -> None:
    """The items of a failed upload, then the rest of the old mission: equal only where they agree."""
    new = [HOME, *(script(seq=i, x=i) if kind else waypoint(seq=i) for i, kind in enumerate(kinds, start=1))]
    old = [HOME, *(item._replace(param1=9.0) for item in new[1:])]
    for cut in range(1, len(new)):
        mixed = new[:cut] + old[cut:]
        assert len(differences(new, mixed)) == len(new) - cut


def test_what_storage_refuses_is_not_compared() -> None:
    with pytest.raises(RefusedItemError):
        stored(waypoint(param1=math.nan), 0)
