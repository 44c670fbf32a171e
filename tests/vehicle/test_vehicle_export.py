"""Mission files: key by key, and as MAVSDK and pymavlink read them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from importers import mavsdk_importer
from mavsdk.plugins.mission_raw.mission_raw import MissionRaw
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from pymavlink.mavwp import MAVWPLoader
from vehicle_cases import handoff_plan, plan_of, small_mission, stop

from malipp_field.errors import InputError, PlanError
from malipp_field.vehicle.compile import compile_plan
from malipp_field.vehicle.export import export
from malipp_field.vehicle.items import MissionItem
from malipp_field.vehicle.layout import lay_out

MISSION = small_mission()
DEG_TOLERANCE = 1e-7
"""About a centimetre."""


importer = pytest.fixture(scope="module")(mavsdk_importer)


def items_of(robot: str) -> list[MissionItem]:
    return lay_out(compile_plan(MISSION, handoff_plan()).missions[robot]).items


def test_one_file_a_robot_that_moves_and_the_map(tmp_path: Path) -> None:
    written = export(MISSION, handoff_plan(), "plan", tmp_path / "out")
    assert [path.name for path in written] == ["small-scout.plan", "small-carrier.plan", "small-steps.json"]
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == sorted(path.name for path in written)
    both = export(MISSION, handoff_plan(), "wpl", tmp_path / "out")
    assert [path.name for path in both[:2]] == ["small-scout.waypoints", "small-carrier.waypoints"]


def test_plan_file_key_by_key(tmp_path: Path) -> None:
    export(MISSION, handoff_plan(), "plan", tmp_path)
    document = json.loads((tmp_path / "small-carrier.plan").read_text())
    mission = document.pop("mission")
    fence = document.pop("geoFence")
    rally = document.pop("rallyPoints")
    assert document == {"fileType": "Plan", "groundStation": "malipp-field", "version": 1}
    items = mission.pop("items")
    home = mission.pop("plannedHomePosition")
    assert mission == {
        "version": 2, "firmwareType": 3, "vehicleType": 10, "cruiseSpeed": 1.5, "hoverSpeed": 1.5,
        "globalPlanAltitudeMode": 1,
    }  # fmt: skip
    assert home == pytest.approx([52.48, 13.785, 40.0])
    assert [item["doJumpId"] for item in items] == list(range(1, 8))
    lat_deg, lon_deg = items[0]["params"][4:6]
    assert items[0] == {
        "type": "SimpleItem", "frame": 3, "command": 16, "autoContinue": True, "doJumpId": 1,
        "AMSLAltAboveTerrain": None, "Altitude": 0.0, "AltitudeMode": 1,
        "params": [0.0, 0.0, 0.0, 0.0, lat_deg, lon_deg, 0.0],
    }  # fmt: skip
    assert (lat_deg, lon_deg) == pytest.approx((52.480359, 13.785883), abs=2e-6)  # 60 m east, 40 m north
    assert items[3] == {
        "type": "SimpleItem", "frame": 2, "command": 42702, "autoContinue": True, "doJumpId": 4,
        "params": [4.0, 0.0, 1.0, 1.0, 2, 0, 0.0],
    }  # fmt: skip
    assert (fence.pop("version"), fence.pop("circles")) == (2, [])
    ((polygon,),) = fence.values()
    assert (polygon["version"], polygon["inclusion"], len(polygon["polygon"])) == (1, False, 3)
    assert polygon["polygon"][0] == pytest.approx([52.480539, 13.786472], abs=2e-6)  # 100 m east, 60 m north
    assert rally["version"] == 2
    assert [point[2] for point in rally["points"]] == [0.0, 0.0]
    assert rally["points"][1][:2] == pytest.approx([52.48, 13.787943], abs=2e-6)  # the yard, 200 m east


@pytest.mark.parametrize("robot", ["scout", "carrier"])
def test_mavsdk_imports_the_plan(tmp_path: Path, importer: MissionRaw, robot: str) -> None:
    export(MISSION, handoff_plan(), "plan", tmp_path)
    data = importer.import_qgroundcontrol_mission(str(tmp_path / f"small-{robot}.plan"))
    home, *expected = items_of(robot)
    # For ArduPilot MAVSDK puts home first, so its items are the vehicle's, index for index.
    assert [item.seq for item in data.mission_items] == list(range(len(expected) + 1))
    assert [item.current for item in data.mission_items].count(1) == 1
    assert_same_place(data.mission_items[0], home)
    for read, sent in zip(data.mission_items[1:], expected, strict=True):
        assert (read.command, read.frame, read.autocontinue) == (sent.command, sent.frame, sent.autocontinue)
        assert (read.param1, read.param2, read.param3, read.param4) == sent[5:9]
        assert_same_place(read, sent)
    assert {item.command for item in data.geofence_items} == {
        mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_EXCLUSION
    }
    assert (len(data.geofence_items), len(data.rally_items)) == (3, 2)


def assert_same_place(read: Any, sent: MissionItem) -> None:
    assert read.x == pytest.approx(sent.x, abs=1)
    assert read.y == pytest.approx(sent.y, abs=1)


@pytest.mark.parametrize("robot", ["scout", "carrier"])
def test_pymavlink_reads_the_waypoint_file(tmp_path: Path, robot: str) -> None:
    export(MISSION, handoff_plan(), "wpl", tmp_path)
    loader = MAVWPLoader()
    expected = items_of(robot)
    assert loader.load(str(tmp_path / f"small-{robot}.waypoints")) == len(expected)
    assert (loader.wp(0).current, loader.wp(0).z) == (1, 40.0)
    for index, sent in enumerate(expected):
        read = loader.wp(index)
        assert (read.seq, read.frame, read.command, read.autocontinue) == (
            index,
            *sent[1:3],
            sent.autocontinue,
        )
        assert (read.param1, read.param2, read.param3, read.param4) == sent[5:9]
        scale = 1e-7 if sent.command == mavlink.MAV_CMD_NAV_WAYPOINT else 1.0
        assert (read.x, read.y) == pytest.approx((sent.x * scale, sent.y * scale), abs=DEG_TOLERANCE, rel=0)


def test_waypoint_file_column_by_column(tmp_path: Path) -> None:
    export(MISSION, handoff_plan(), "wpl", tmp_path)
    first, home, drive, wait, *_ = (tmp_path / "small-carrier.waypoints").read_text().splitlines()
    zeros = ["0.00000000"] * 4
    assert first == "QGC WPL 110"
    assert home.split("\t") == ["0", "1", "0", "16", *zeros, "52.48000000", "13.78500000", "40.00000000", "1"]
    assert drive.split("\t")[:8] == ["1", "0", "3", "16", *zeros]
    assert wait.split("\t") == [
        "2", "0", "2", "42702", "1.00000000", "0.00000000", "1.00000000", "2.00000000",
        "1.00000000", "0.00000000", "0.00000000", "1",
    ]  # fmt: skip


def test_the_map_ties_items_to_the_plan(tmp_path: Path) -> None:
    *_, path = export(MISSION, handoff_plan(), "plan", tmp_path)
    document = json.loads(path.read_text())
    robots = {robot["id"]: robot for robot in document["robots"]}
    assert (document["format"], document["mission"], document["version"]) == ("malipp-steps/1", "small", 1)
    assert (robots["carrier"]["file"], robots["scout2"]["file"]) == ("small-carrier.plan", None)
    assert robots["carrier"]["items"][2] == {
        "item": 3, "uid": "v1/carrier/1/pick/1", "action": "pick", "node": "hub", "stop": 1, "tags": [1],
        "peer": "scout", "not_before_s": None, "if_missing": "hold",
    }  # fmt: skip
    assert document["samples"][2] == {"tag": 3, "node": "hub", "sampler": "scout"}


def test_a_robot_that_now_stays_keeps_no_file(tmp_path: Path) -> None:
    export(MISSION, handoff_plan(), "plan", tmp_path)
    stays = plan_of({"scout": list(handoff_plan().robots[0].route[:2]), "carrier": [stop("base", 0.0)]})
    export(MISSION, stays, "plan", tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["small-scout.plan", "small-steps.json"]


def test_an_abstract_site_is_refused(tmp_path: Path) -> None:
    with pytest.raises(PlanError, match=r"mission 'small' has no site\.origin"):
        export(small_mission(abstract=True), handoff_plan(), "plan", tmp_path)
    assert not list(tmp_path.iterdir())


def test_a_fault_while_writing_leaves_what_was_there(tmp_path: Path) -> None:
    export(MISSION, handoff_plan(), "plan", tmp_path)
    before = (tmp_path / "small-scout.plan").read_text()
    (tmp_path / "small-steps.json.partial").mkdir()
    other = plan_of({"scout": [stop("base", 0.0), stop("a", 1.0, path=("base", "a"))]})
    with pytest.raises(InputError, match="cannot be written"):
        export(MISSION, other, "plan", tmp_path)
    assert (tmp_path / "small-scout.plan").read_text() == before
    assert not (tmp_path / "small-scout.plan.partial").exists()
