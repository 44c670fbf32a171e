"""The site's outline and keep-outs, and a robot's depots, as ArduPilot's fence and rally points.

Both are lists of items of their own, beside the mission and without home. A corner of a polygon is one item
that also says how many corners its polygon has, so that polygons follow one another without separators.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import NamedTuple

from shapely import Polygon

from malipp_field.errors import PlanError
from malipp_field.mission import Mission, fence_polygon, keep_out_polygons, node_positions, to_globe
from malipp_field.mission.schema import Origin
from malipp_field.vehicle.items import (
    MAV_CMD_NAV_FENCE_POLYGON_VERTEX_EXCLUSION,
    MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION,
    MAV_CMD_NAV_RALLY_POINT,
    MAV_FRAME_GLOBAL,
    MissionItem,
    item_at,
)

MAX_CORNERS = 255
"""Corners of one polygon: ArduPilot keeps their number in a byte."""
MAX_FENCE_ITEMS = 255
"""Corners of all polygons: no board stores more (ArduPilot, `AC_PolyFence_loader::max_items`), and one with
little storage stores fewer, and then refuses them on upload."""
MAX_RALLY_POINTS = 20
"""For so many rally points ArduPilot Rover has storage on the boards it is run on."""


class FencePolygon(NamedTuple):
    """A polygon of the fence, by the name it has in the mission file, and the command of its corners."""

    name: str
    command: int
    corners: list[tuple[float, float]]


def fence_polygons(mission: Mission) -> list[FencePolygon]:
    """Return a site's outline and its keep-outs, in metres; the rings are not closed."""
    outline = fence_polygon(mission)
    found = []
    if outline is not None:
        found.append(_polygon("site.fence", MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION, outline))
    for name, polygon in keep_out_polygons(mission).items():
        found.append(_polygon(f"keep-out '{name}'", MAV_CMD_NAV_FENCE_POLYGON_VERTEX_EXCLUSION, polygon))
    return found


def _polygon(name: str, command: int, polygon: Polygon) -> FencePolygon:
    return FencePolygon(name, command, [(x_m, y_m) for x_m, y_m in polygon.exterior.coords[:-1]])


def fence_items(mission: Mission, origin: Origin) -> list[MissionItem]:
    """Return the fence of a site: its outline to stay inside of, its keep-outs to stay out of.

    Empty where the site has neither.

    Raises
    ------
    PlanError
        When a polygon has more corners than ArduPilot stores.
    """
    return _numbered(item for polygon in fence_polygons(mission) for item in _corners(polygon, origin))


def rally_items(mission: Mission, origin: Origin, robot: str) -> list[MissionItem]:
    """Return the depots where a robot may unload as its rally points, at the height of home."""
    places = node_positions(mission)
    return _numbered(
        item_at(0, MAV_CMD_NAV_RALLY_POINT, *to_globe(*places[depot], origin))
        for depot in mission.robot(robot).depots
    )


def _corners(polygon: FencePolygon, origin: Origin) -> Iterator[MissionItem]:
    name, command, corners = polygon
    if len(corners) > MAX_CORNERS:
        raise PlanError(f"{name} has {len(corners)} corners; ArduPilot stores at most {MAX_CORNERS}")
    for x_m, y_m in corners:
        corner = item_at(0, command, *to_globe(x_m, y_m, origin), param1=float(len(corners)))
        yield corner._replace(frame=MAV_FRAME_GLOBAL)


def _numbered(items: Iterable[MissionItem]) -> list[MissionItem]:
    return [item._replace(seq=seq) for seq, item in enumerate(items)]
