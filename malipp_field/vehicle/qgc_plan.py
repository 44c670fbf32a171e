"""QGroundControl `.plan` files: mission, fence and keep-outs, depots as rally points.

Format: "Plan File Format" in QGroundControl's developer guide. Home is not an item there; it is
``plannedHomePosition``, and the item with ``doJumpId`` *i* is item *i* of the MAVLink mission.
"""

from __future__ import annotations

import json

from shapely import Polygon
from shapely.geometry.polygon import orient

from malipp_field.mission import Mission, fence_polygon, keep_out_polygons, node_positions, to_globe
from malipp_field.mission.schema import Origin
from malipp_field.vehicle.items import WITH_PLACE, MissionItem
from malipp_field.vehicle.layout import lay_out
from malipp_field.vehicle.steps import VehicleMission

MAV_AUTOPILOT_ARDUPILOTMEGA = 3
MAV_TYPE_GROUND_ROVER = 10
ALTITUDE_MODE_RELATIVE = 1

Json = dict[str, object]


def qgc_plan_text(mission: Mission, origin: Origin, vehicle: VehicleMission) -> str:
    """Return the text of a `.plan` file.

    Parameters
    ----------
    mission
        Gives fence, keep-outs, depots and the speed of the robot.
    origin
        The mission's origin; an abstract site cannot be exported.
    vehicle
        What the robot is to do; at least one step.
    """
    speed_m_s = mission.robot(vehicle.robot).speed_m_s
    document: Json = {
        "fileType": "Plan",
        "groundStation": "malipp-field",
        "version": 1,
        "mission": {
            "version": 2,
            "firmwareType": MAV_AUTOPILOT_ARDUPILOTMEGA,
            "vehicleType": MAV_TYPE_GROUND_ROVER,
            "cruiseSpeed": speed_m_s,
            "hoverSpeed": speed_m_s,
            "globalPlanAltitudeMode": ALTITUDE_MODE_RELATIVE,
            "plannedHomePosition": [
                *_rounded(vehicle.home.lat_deg, vehicle.home.lon_deg),
                origin.alt_m + vehicle.home.alt_m,
            ],
            "items": [_simple_item(item) for item in lay_out(vehicle).items[1:]],
        },
        "geoFence": {"version": 2, "circles": [], "polygons": _polygons(mission, origin)},
        "rallyPoints": {"version": 2, "points": _rally_points(mission, origin, vehicle.robot)},
    }  # fmt: skip
    return json.dumps(document, indent=4) + "\n"


def _simple_item(item: MissionItem) -> Json:
    data: Json = {
        "type": "SimpleItem",
        "frame": item.frame,
        "command": item.command,
        "autoContinue": bool(item.autocontinue),
        "doJumpId": item.seq,
    }
    params = [item.param1, item.param2, item.param3, item.param4]
    if item.command in WITH_PLACE:
        data |= {"AMSLAltAboveTerrain": None, "Altitude": item.z, "AltitudeMode": ALTITUDE_MODE_RELATIVE}
        return data | {"params": [*params, item.x / 1e7, item.y / 1e7, item.z]}
    # Without a position (frame 2) params 5 to 7 are not degrees: x and y travel as they are.
    return data | {"params": [*params, item.x, item.y, item.z]}


def _polygons(mission: Mission, origin: Origin) -> list[Json]:
    """Return the outline to stay inside of, and the keep-outs to stay out of."""
    fence = fence_polygon(mission)
    inclusions = [] if fence is None else [_polygon(fence, origin, inclusion=True)]
    exclusions = [_polygon(area, origin, inclusion=False) for area in keep_out_polygons(mission).values()]
    return inclusions + exclusions


def _polygon(polygon: Polygon, origin: Origin, *, inclusion: bool) -> Json:
    """Return a polygon as the format has it: clockwise, and not closed."""
    corners = orient(polygon, -1.0).exterior.coords[:-1]
    return {
        "version": 1,
        "inclusion": inclusion,
        "polygon": [_rounded(*to_globe(x_m, y_m, origin)) for x_m, y_m in corners],
    }


def _rally_points(mission: Mission, origin: Origin, robot: str) -> list[list[float]]:
    """Return the depots where the robot may unload: degrees, and metres above home."""
    places = node_positions(mission)
    return [[*_rounded(*to_globe(*places[depot], origin)), 0.0] for depot in mission.robot(robot).depots]


def _rounded(lat_deg: float, lon_deg: float) -> list[float]:
    """Return degrees to a tenth of a millimetre; more digits would be noise."""
    return [round(lat_deg, 9), round(lon_deg, 9)]
