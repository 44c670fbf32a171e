"""Readers of mission files: our own of the two formats, and MAVSDK's."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from mavsdk import ComponentType, Configuration, Mavsdk
from mavsdk.plugins.mission_raw.mission_raw import MissionRaw
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from malipp_field.vehicle.items import MAV_FRAME_MISSION, MissionItem


def mavsdk_importer() -> Iterator[MissionRaw]:
    """MAVSDK's importer; it wants a vehicle, so it is told of one without any network."""
    sdk = Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION))
    try:
        sdk.add_any_connection("raw://")
        mav = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
        heartbeat = mav.heartbeat_encode(
            mavlink.MAV_TYPE_GROUND_ROVER,
            mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA,
            0,
            0,
            mavlink.MAV_STATE_STANDBY,
        )
        sdk.pass_received_raw_bytes(heartbeat.pack(mav))
        system = sdk.first_autopilot(10.0)
        assert system is not None
        yield MissionRaw(system)
    finally:
        sdk.destroy()


def read_plan_file(document: Any) -> list[MissionItem]:
    """Return the items of a `.plan`, as a vehicle would get them; home is none of them."""
    return [
        _item(item["doJumpId"], item["frame"], item["command"], 0, int(item["autoContinue"]), item["params"])
        for item in document["mission"]["items"]
    ]


def read_waypoints(text: str) -> list[MissionItem]:
    """Return the items of a `QGC WPL 110` file, home first."""
    first, *rows = text.splitlines()
    assert first == "QGC WPL 110"
    items = []
    for row in rows:
        columns = row.split("\t")
        assert len(columns) == 12
        seq, current, frame, command = map(int, columns[:4])
        items.append(_item(seq, frame, command, current, int(columns[11]), [float(c) for c in columns[4:11]]))
    return items


def _item(
    seq: int, frame: int, command: int, current: int, autocontinue: int, params: list[float]
) -> MissionItem:
    scale = 1.0 if frame == MAV_FRAME_MISSION else 1e7
    x, y = (round(value * scale) for value in params[4:6])
    p1, p2, p3, p4 = params[:4]
    return MissionItem(seq, frame, command, current, autocontinue, p1, p2, p3, p4, x, y, params[6])
