"""QGroundControl's plan file format, key by key, as data.

Source: "Plan File Format" of QGroundControl's developer guide, and what its loaders insist on beyond that
(`SimpleMissionItem`, `QGCFencePolygon`): a key they do not require is marked with a question mark.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeAlias

Check: TypeAlias = Callable[[Any, str], None]


def number(value: Any, where: str) -> None:
    assert isinstance(value, int | float), f"{where} is no number"
    assert not isinstance(value, bool), f"{where} is no number"


def whole(value: Any, where: str) -> None:
    assert type(value) is int, f"{where} is no whole number"


def number_or_null(value: Any, where: str) -> None:
    if value is not None:
        number(value, where)


def truth(value: Any, where: str) -> None:
    assert type(value) is bool, f"{where} is neither true nor false"


def text(value: Any, where: str) -> None:
    assert isinstance(value, str), f"{where} is no text"


def exactly(wanted: object) -> Check:
    def check(value: Any, where: str) -> None:
        assert value == wanted, f"{where} is {value!r}, not {wanted!r}"
        assert type(value) is type(wanted), f"{where} is of another type than {wanted!r}"

    return check


def many(check: Check, least: int = 0, most: int | None = None) -> Check:
    def each(value: Any, where: str) -> None:
        assert isinstance(value, list), f"{where} is no list"
        assert len(value) >= least, f"{where} has {len(value)} entries"
        assert most is None or len(value) <= most, f"{where} has {len(value)} entries"
        for index, entry in enumerate(value):
            check(entry, f"{where}[{index}]")

    return each


def latitude_longitude(value: Any, where: str) -> None:
    many(number, 2)(value, where)
    assert -90 <= value[0] <= 90, where
    assert -180 <= value[1] <= 180, where


def place_with_height(value: Any, where: str) -> None:
    many(number, 3, 3)(value, where)
    latitude_longitude(value, where)


def record(**keys: Check) -> Check:
    """Return a check for an object of just these keys; one whose name ends with ``_`` may be left out."""

    def check(value: Any, where: str) -> None:
        assert isinstance(value, dict), f"{where} is no object"
        known = {name.rstrip("_"): rule for name, rule in keys.items()}
        needed = {name for name in keys if not name.endswith("_")}
        assert needed <= value.keys() <= known.keys(), f"{where}: {sorted(value.keys() ^ needed)}"
        for name, entry in value.items():
            known[name](entry, f"{where}.{name}")

    return check


SIMPLE_ITEM = record(
    type=exactly("SimpleItem"),
    frame=whole,
    command=whole,
    params=many(number_or_null, 7, 7),
    autoContinue=truth,
    doJumpId_=whole,
    AMSLAltAboveTerrain_=number_or_null,
    Altitude_=number,
    AltitudeMode_=whole,
)

CORNERS = many(latitude_longitude, 3)

PLAN_FILE = record(
    fileType=exactly("Plan"),
    version=exactly(1),
    groundStation=text,
    mission=record(
        version=exactly(2),
        firmwareType=exactly(3),
        vehicleType_=exactly(10),
        globalPlanAltitudeMode_=exactly(1),
        cruiseSpeed_=number,
        hoverSpeed_=number,
        plannedHomePosition=place_with_height,
        items=many(SIMPLE_ITEM, 1),
    ),
    geoFence=record(
        version=exactly(2),
        circles=many(
            record(
                version=exactly(1), inclusion=truth, circle=record(center=latitude_longitude, radius=number)
            )
        ),
        polygons=many(record(version=exactly(1), inclusion=truth, polygon=CORNERS)),
    ),
    rallyPoints=record(version=exactly(2), points=many(place_with_height)),
)

WITH_A_PLACE = {16, 17}
"""Commands of ours for which QGroundControl has a place on its map, and so wants an altitude."""


def check_plan_file(document: Any) -> None:
    """Raise AssertionError where QGroundControl would refuse a plan, or not do as it says."""
    PLAN_FILE(document, "plan")
    for number_, item in enumerate(document["mission"]["items"], start=1):
        assert item["doJumpId"] == number_
        altitude = {"AMSLAltAboveTerrain", "Altitude", "AltitudeMode"} & item.keys()
        assert len(altitude) == (3 if item["command"] in WITH_A_PLACE else 0)
        assert item["frame"] == (3 if item["command"] in WITH_A_PLACE else 2)
    for polygon in document["geoFence"]["polygons"]:
        assert clockwise(polygon["polygon"])


def clockwise(corners: list[list[float]]) -> bool:
    """Tell whether corners (latitude, longitude) run clockwise as seen from above, and are not closed."""
    twice_area = sum(
        (x2 - x1) * (y2 + y1) for (y1, x1), (y2, x2) in zip(corners, corners[1:] + corners[:1], strict=True)
    )
    return twice_area > 0 and corners[0] != corners[-1]
