"""`QGC WPL 110` files, the plain-text missions that Mission Planner, MAVProxy and others read.

Format: "Mission Plain-Text File Format" of the MAVLink guide: twelve tab-separated columns (index, current,
frame, command, params 1 to 4, latitude or x, longitude or y, altitude or z, autocontinue); row 0 is home.
"""

from __future__ import annotations

from malipp_field.mission.schema import Origin
from malipp_field.vehicle.items import WITH_PLACE, MissionItem
from malipp_field.vehicle.layout import lay_out
from malipp_field.vehicle.steps import VehicleMission


def wpl_text(origin: Origin, vehicle: VehicleMission) -> str:
    """Return the text of a waypoint file; ``origin`` gives home its altitude above sea level."""
    home, *items = lay_out(vehicle).items
    rows = [home._replace(current=1, z=origin.alt_m + home.z), *items]
    return "QGC WPL 110\n" + "".join(_row(item) for item in rows)


def _row(item: MissionItem) -> str:
    if item.command in WITH_PLACE:
        x, y = item.x / 1e7, item.y / 1e7
    else:
        x, y = float(item.x), float(item.y)
    numbers = (item.param1, item.param2, item.param3, item.param4, x, y, item.z)
    columns = [
        *(str(value) for value in (item.seq, item.current, item.frame, item.command)),
        *(f"{value:.8f}" for value in numbers),
        str(item.autocontinue),
    ]
    return "\t".join(columns) + "\n"
