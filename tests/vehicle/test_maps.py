"""KML and GeoJSON: what is on the map of a plan, and whether others can read it."""

from __future__ import annotations

import json
from itertools import pairwise
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import pytest
from hardware_strategy import FENCE
from shapely import Polygon
from shapely.geometry import shape
from vehicle_cases import handoff_plan, plan_of, small_mission, stop

from malipp_field.errors import PlanError
from malipp_field.mission import Mission
from malipp_field.vehicle.export import export

KML = {"k": "http://www.opengis.net/kml/2.2"}
NOON = 1_800_014_400.0
"""2027-01-15T12:00:00Z"""


def fenced(**vehicles: Any) -> Mission:
    record = small_mission().model_dump(mode="json", by_alias=True, exclude_none=True)
    record["site"]["fence"] = FENCE[::-1]
    record["vehicles"] = vehicles
    return Mission.model_validate(record)


def geojson(folder: Path, mission: Mission | None = None, start_s: float | None = None) -> dict[str, Any]:
    """Return the features of the exported map by id."""
    path, steps = export(mission or fenced(), handoff_plan(), "geojson", folder, start_s)
    assert (path.name, steps.name) == ("small.geojson", "small-steps.json")
    document = json.loads(path.read_text())
    assert document.keys() == {"type", "features"}
    assert document["type"] == "FeatureCollection"
    return {feature["id"]: feature for feature in document["features"]}


def test_everything_is_on_the_map_once(tmp_path: Path) -> None:
    features = geojson(tmp_path)
    assert list(features) == [
        "fence", "keep_out/pit",
        *[f"node/{node}" for node in ("base", "yard", "a", "b", "c", "hub", "gate")],
        "drop/hub/scout/carrier",
        "scout/route", "scout/stop/1", "scout/stop/2", "scout/stop/3",
        "carrier/route", "carrier/stop/1", "carrier/stop/2",
    ]  # fmt: skip
    roles = {
        f["properties"]["title"]: f["properties"]["role"]
        for f in features.values()
        if "role" in f["properties"]
    }
    assert (roles["yard"], roles["a"], roles["gate"]) == ("depot", "candidate", "via")
    drop = features["drop/hub/scout/carrier"]["properties"]
    assert (drop["sender"], drop["receiver"], drop["tags"]) == ("scout", "carrier", [1, 2])
    assert drop["description"] == "containers 1, 2"


def test_geojson_keeps_its_specification(tmp_path: Path) -> None:
    features = geojson(tmp_path)
    for feature in features.values():
        assert feature.keys() == {"type", "id", "geometry", "properties"}
        assert feature["geometry"].keys() == {"type", "coordinates"}
        geometry = shape(feature["geometry"])
        assert geometry.is_valid
        west, south, east, north = geometry.bounds
        assert 13.78 < west <= east < 13.79  # longitude first
        assert 52.47 < south <= north < 52.49
        if isinstance(geometry, Polygon):
            assert geometry.exterior.is_ccw  # the interior lies to the left (RFC 7946, 3.1.6)
            assert feature["geometry"]["coordinates"][0][0] == feature["geometry"]["coordinates"][0][-1]


def test_a_robot_has_one_colour_and_its_own(tmp_path: Path) -> None:
    features = geojson(tmp_path)
    colors: dict[str, set[str]] = {}
    for feature in features.values():
        properties = feature["properties"]
        if "robot" in properties:
            colors.setdefault(properties["robot"], set()).add(
                properties.get("stroke") or properties["marker-color"]
            )
    assert all(len(found) == 1 for found in colors.values())
    assert colors["scout"] != colors["carrier"]
    widths = [features[f"{robot}/route"]["properties"]["stroke-width"] for robot in ("scout", "carrier")]
    assert widths[0] > widths[1]  # where both drive, both are seen


def test_a_route_leads_through_what_is_on_the_way(tmp_path: Path) -> None:
    features = geojson(tmp_path)
    places = {
        name: features[f"node/{name}"]["geometry"]["coordinates"] for name in ("base", "gate", "a", "hub")
    }
    route = features["scout/route"]
    expected = [places[node] for node in ("base", "gate", "a", "hub", "gate", "base")]
    assert route["geometry"]["coordinates"] == expected
    assert (route["properties"]["energy_j"], route["properties"]["end_s"]) == (3.0, 190.0)


def test_a_stop_says_when_and_what(tmp_path: Path) -> None:
    properties = geojson(tmp_path)["scout/stop/2"]["properties"]
    assert properties["title"] == "scout 2: hub"
    assert properties["description"].splitlines() == [
        "arrives at 90 s", "collect 3", "drop 1 (carrier)", "drop 2 (carrier)", "leaves at 90 s",
    ]  # fmt: skip
    assert properties["actions"][1] == {"action": "drop", "tags": [1], "peer": "carrier"}
    assert (properties["stop"], properties["node"], properties["arrive_s"]) == (2, "hub", 90.0)


def test_with_a_start_times_are_of_day_and_gates_are_told(tmp_path: Path) -> None:
    timed = fenced(carrier={"gate": "time", "gate_margin_s": 20.0})
    properties = geojson(tmp_path, timed, NOON)["carrier/stop/1"]["properties"]
    assert properties["description"].splitlines()[:2] == [
        "arrives at 2027-01-15T12:02:10Z", "wait 1, 2, at most until 2027-01-15T12:02:30Z",
    ]  # fmt: skip


def test_kml_holds_the_same_places_in_folders(tmp_path: Path) -> None:
    features = geojson(tmp_path)
    path, _ = export(fenced(), handoff_plan(), "kml", tmp_path)
    root = ET.parse(path).getroot()
    names = [name.text for name in root.iterfind("k:Document/k:Folder/k:name", KML)]
    assert names == ["site", "drops", "scout", "carrier"]
    read = {}
    for placemark in root.iterfind(".//k:Placemark", KML):
        tags = [child.tag.split("}")[1] for child in placemark]
        described = ["description"] if "description" in tags else []
        assert tags == ["name", *described, "Style", "ExtendedData", tags[-1]]  # the schema's order
        text = placemark.findtext(".//k:coordinates", "", KML)
        places = [[float(number) for number in place.split(",")] for place in text.split()]
        read[placemark.findtext(".//k:Data[@name='id']/k:value", "", KML)] = tags[-1], places
    assert list(read) == list(features)
    for name, (kind, places) in read.items():
        geometry = features[name]["geometry"]
        assert kind == geometry["type"]
        nested = {"Point": 0, "LineString": 1, "Polygon": 2}[kind]
        coordinates = geometry["coordinates"]
        assert places == ([coordinates] if nested == 0 else coordinates if nested == 1 else coordinates[0])


def test_kml_has_the_colours_its_own_way_round(tmp_path: Path) -> None:
    path, _ = export(fenced(), handoff_plan(), "kml", tmp_path)
    assert path.read_text().startswith("<?xml version='1.0' encoding='utf-8'?>")
    colors = [color.text or "" for color in ET.parse(path).iterfind(".//k:LineStyle/k:color", KML)]
    assert "ff005ed5" in colors  # #d55e00, as KML has it: alpha, blue, green, red


def test_a_robot_that_stays_has_no_route(tmp_path: Path) -> None:
    stays = plan_of({"scout": [stop("base", 0.0)], "carrier": [stop("base", 0.0)]})
    path, steps = export(fenced(), stays, "geojson", tmp_path)
    kinds = [feature["properties"]["kind"] for feature in json.loads(path.read_text())["features"]]
    assert "route" not in kinds
    assert [robot["file"] for robot in json.loads(steps.read_text())["robots"]] == [None, None]


def test_items_and_map_tell_of_the_same_file(tmp_path: Path) -> None:
    _, steps = export(fenced(), handoff_plan(), "kml", tmp_path)
    robots = json.loads(steps.read_text())["robots"]
    assert [robot["file"] for robot in robots] == ["small.kml", None, "small.kml"]
    assert all(one["item"] < other["item"] for one, other in pairwise(robots[0]["items"]))


def test_an_abstract_site_has_no_map(tmp_path: Path) -> None:
    with pytest.raises(PlanError, match=r"has no site\.origin"):
        export(small_mission(abstract=True), handoff_plan(), "kml", tmp_path)
