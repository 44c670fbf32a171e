"""Random missions for all hardware, exported and read, uploaded and downloaded: they stay the same."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from hardware_strategy import START_S, equipped_missions
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from importers import mavsdk_importer, read_plan_file, read_waypoints
from mavsdk.plugins.mission_raw.mission_raw import MissionRaw
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from pymavlink.mavwp import MAVWPLoader
from qgc_format import check_plan_file
from vehicle_cases import handoff_plan, random_plan, small_mission

from malipp_field.link.compare import differences
from malipp_field.link.mission_protocol import MissionDownload, MissionUpload
from malipp_field.mission import Mission
from malipp_field.sim.mission_store import MissionStore, Sender
from malipp_field.vehicle.compile import compile_plan
from malipp_field.vehicle.export import export
from malipp_field.vehicle.items import WITH_PLACE, MissionItem
from malipp_field.vehicle.layout import lay_out

SEEDS = st.integers(0, 2**32 - 1)
GROUND = Sender(255, 190)
INSIDE = mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION
OUTSIDE = mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_EXCLUSION
SINGLE = 2.0**-22
"""MAVSDK keeps params in single precision, as MAVLink does."""
MANY = settings(max_examples=20, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])

importer = pytest.fixture(scope="module")(mavsdk_importer)


def layouts(mission: Mission, seed: int, start_s: float | None) -> dict[str, list[MissionItem]]:
    """Return the items of every robot that moves."""
    compiled = compile_plan(mission, random_plan(seed), start_s=start_s)
    return {robot: lay_out(vehicle).items for robot, vehicle in compiled.missions.items() if vehicle.steps}


def written(
    mission: Mission, seed: int, start_s: float | None, kind: Any, folder: Path
) -> list[tuple[Path, list[MissionItem]]]:
    """Return the exported file of each robot that moves, and its items."""
    *paths, steps = export(mission, random_plan(seed), kind, folder, start_s)
    files = {robot["file"]: robot["id"] for robot in json.loads(steps.read_text())["robots"]}
    items = layouts(mission, seed, start_s)
    assert sorted(files[path.name] for path in paths) == sorted(items)
    return [(path, items[files[path.name]]) for path in paths]


@MANY
@given(mission=equipped_missions(), seed=SEEDS, start_s=START_S)
def test_a_plan_file_says_all_there_is_to_say(
    tmp_path: Path, mission: Mission, seed: int, start_s: float | None
) -> None:
    for path, items in written(mission, seed, start_s, "plan", tmp_path):
        document = json.loads(path.read_text())
        check_plan_file(document)
        assert read_plan_file(document) == items[1:]
        fences = [polygon["inclusion"] for polygon in document["geoFence"]["polygons"]]
        assert fences == [True] * (mission.site.fence is not None) + [False]


@pytest.mark.parametrize(
    ("key", "value"),
    [("version", "1"), ("fileType", "plan"), ("mission", None), ("geoFence", {}), ("colour", 1)],
)
def test_the_check_of_the_format_is_one(tmp_path: Path, key: str, value: object) -> None:
    path, *_ = export(small_mission(), handoff_plan(), "plan", tmp_path)
    document = json.loads(path.read_text())
    check_plan_file(document)
    with pytest.raises(AssertionError):
        check_plan_file(document | {key: value})


@settings(parent=MANY, max_examples=8)
@given(mission=equipped_missions(), seed=SEEDS, start_s=START_S)
def test_mavsdk_reads_the_plan_file_alike(
    tmp_path: Path, importer: MissionRaw, mission: Mission, seed: int, start_s: float | None
) -> None:
    for path, items in written(mission, seed, start_s, "plan", tmp_path):
        data = importer.import_qgroundcontrol_mission(str(path))
        for theirs, ours in zip(data.mission_items[1:], items[1:], strict=True):
            assert (theirs.seq, theirs.frame, theirs.command) == ours[:3]
            assert (theirs.autocontinue, theirs.z) == (ours.autocontinue, ours.z)
            params = [theirs.param1, theirs.param2, theirs.param3, theirs.param4]
            assert params == pytest.approx(ours[5:9], rel=SINGLE)
            assert (theirs.x, theirs.y) == pytest.approx((ours.x, ours.y), abs=1)
        commands = [item.command for item in data.geofence_items]
        assert commands == [INSIDE] * 4 * (mission.site.fence is not None) + [OUTSIDE] * 3
        assert len(data.rally_items) == 2


@MANY
@given(mission=equipped_missions(), seed=SEEDS, start_s=START_S)
def test_a_waypoint_file_says_all_there_is_to_say_and_pymavlink_reads_it_alike(
    tmp_path: Path, mission: Mission, seed: int, start_s: float | None
) -> None:
    for path, items in written(mission, seed, start_s, "wpl", tmp_path):
        home, *read = read_waypoints(path.read_text())
        assert read == [item._replace(param1=round(item.param1, 8)) for item in items[1:]]
        assert (home.x, home.y, home.current) == (items[0].x, items[0].y, 1)
        loader = MAVWPLoader()
        assert loader.load(str(path)) == len(items)
        for index, ours in enumerate(items[1:], start=1):
            theirs = loader.wp(index)
            assert (theirs.seq, theirs.frame, theirs.command) == ours[:3]
            params = [theirs.param1, theirs.param2, theirs.param3, theirs.param4]
            assert params == pytest.approx(ours[5:9], abs=1e-8)
            scale = 1e-7 if ours.command in WITH_PLACE else 1.0
            assert (theirs.x, theirs.y) == pytest.approx((ours.x * scale, ours.y * scale), abs=1e-8, rel=0)


@MANY
@given(mission=equipped_missions(), seed=SEEDS, start_s=START_S)
def test_what_a_vehicle_stores_makes_it_do_what_was_compiled(
    mission: Mission, seed: int, start_s: float | None
) -> None:
    for items in layouts(mission, seed, start_s).values():
        store = MissionStore(home=partial(items.__getitem__, 0))
        upload, download = MissionUpload(items, 1), MissionDownload(1)
        for exchange in (upload, download):
            talk(exchange, store)
            assert exchange.done, exchange.failure
        assert differences(items, download.items) == []


def talk(exchange: MissionUpload | MissionDownload, store: MissionStore) -> None:
    """Carry messages to and fro over a link that loses nothing, through their packed form."""
    asked = exchange.start(0.0)
    while asked:
        answers = [
            carried(answer, 1, 1)
            for message in asked
            for answer in [
                *store.receive(carried(message, GROUND.system, GROUND.component), GROUND, 0.0),
                *store.poll(0.0),
            ]
        ]
        asked = [message for answer in answers for message in exchange.receive(answer, 0.0)]


def carried(message: Any, system: int, component: int) -> Any:
    """Return a message as it arrives."""
    packed = message.pack(mavlink.MAVLink(None, srcSystem=system, srcComponent=component))
    return mavlink.MAVLink(None).parse_buffer(bytearray(packed))[0]
