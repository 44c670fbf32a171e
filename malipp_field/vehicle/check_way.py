"""Whether a vehicle stays where it may be: it drives straight from one item's place to the next one's."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from typing import NamedTuple

from shapely.geometry import LineString, Point
from shapely.geometry.base import BaseGeometry

from malipp_field.mission import (
    ABSTRACT_ORIGIN,
    Mission,
    fence_polygon,
    keep_out_polygons,
    node_positions,
    to_local,
)
from malipp_field.vehicle.finding import Finding, Spot
from malipp_field.vehicle.firmware import COMMANDS, MAV_CMD_NAV_RETURN_TO_LAUNCH
from malipp_field.vehicle.items import MissionItem

FAR_FROM_HOME_M = 500.0
"""A first waypoint farther than this from home is more likely a mistake than a plan."""
HOME_OFF_M = 20.0
"""By how much home may lie beside the node where the robot is said to start."""
_TOUCHING_M = 0.05
"""How far into forbidden ground still counts as touching it: items have degrees to the centimetre."""


class _Position(NamedTuple):
    item: int
    name: str
    x_m: float
    y_m: float

    @property
    def point(self) -> tuple[float, float]:
        return self.x_m, self.y_m


class _Ground:
    """Where vehicles may be: within the fence, outside the keep-outs; touching either is allowed."""

    def __init__(self, mission: Mission) -> None:
        fence = fence_polygon(mission)
        self._fence = None if fence is None else fence.buffer(_TOUCHING_M)
        self._keep_outs = {
            name: area.buffer(-_TOUCHING_M) for name, area in keep_out_polygons(mission).items()
        }

    def leaves_fence(self, shape: BaseGeometry) -> bool:
        return self._fence is not None and not self._fence.covers(shape)

    def entered(self, shape: BaseGeometry) -> list[str]:
        """Return the keep-outs that a shape reaches into."""
        return [name for name, area in self._keep_outs.items() if area.intersects(shape)]


def way_findings(
    mission: Mission,
    robot: str,
    items: Sequence[MissionItem],
    where: Mapping[int, str] | None = None,
    begin: str | None = None,
) -> list[Finding]:
    """Return where a vehicle would leave the fence, cross a keep-out, or start from the wrong place.

    Parameters
    ----------
    items
        Its mission, home first.
    where
        What items are for in words, by sequence number.
    begin
        Node at which the vehicle stands when the mission begins; home where not given.
    """
    positions = _positions(mission, items, where or {})
    if not positions:
        return []
    places, ground = node_positions(mission), _Ground(mission)
    home, *others = positions
    first = home if begin is None else _Position(0, begin, *places[begin])
    found = [*_home(robot, home, places[mission.robot(robot).start])]
    if others:
        found += _first_waypoint(robot, first, others[0])
    for tail, head in pairwise((first, *others)):
        found += _leg(robot, tail, head, ground)
    for depot in mission.robot(robot).depots:
        found += _depot(Spot(robot, None, depot), Point(places[depot]), ground)
    return found


def _positions(mission: Mission, items: Sequence[MissionItem], where: Mapping[int, str]) -> list[_Position]:
    """Return where the vehicle goes, home first; an item without a place leaves it where it is."""
    origin = mission.site.origin or ABSTRACT_ORIGIN
    found: list[_Position] = []
    for index, item in enumerate(items):
        command = COMMANDS.get(item.command)
        if item.command == MAV_CMD_NAV_RETURN_TO_LAUNCH and found:
            found.append(found[0]._replace(item=index))
        elif command is not None and command.place == "degrees" and (item.x or item.y):
            name = where.get(index, f"item {index}" if index else "home")
            found.append(_Position(index, name, *to_local(item.x / 1e7, item.y / 1e7, origin)))
    return found


def _home(robot: str, home: _Position, start: tuple[float, float]) -> Iterator[Finding]:
    off_m = math.dist(home.point, start)
    if off_m > HOME_OFF_M:
        yield Spot(robot, home.item, home.name).warning(
            "home-off",
            f"home is {off_m:.0f} m from the node where the robot starts",
            "check site.origin and the robot's start, or export again",
        )


def _first_waypoint(robot: str, begin: _Position, first: _Position) -> Iterator[Finding]:
    far_m = math.dist(begin.point, first.point)
    if far_m > FAR_FROM_HOME_M:
        yield Spot(robot, first.item, first.name).warning(
            "far-from-home",
            f"the first waypoint is {far_m:.0f} m from {begin.name}",
            "check site.origin, and that the vehicle stands where its mission starts",
        )


def _leg(robot: str, tail: _Position, head: _Position, ground: _Ground) -> Iterator[Finding]:
    line = LineString([tail.point, head.point])
    spot = Spot(robot, head.item, head.name)
    if ground.leaves_fence(line):
        yield spot.error(
            "fence-crossing",
            f"the straight way from {tail.name} leaves the fence",
            "lead it round by a via node, or widen site.fence",
        )
    for keep_out in ground.entered(line):
        yield spot.error(
            "keep-out-crossing",
            f"the straight way from {tail.name} crosses keep-out '{keep_out}'",
            "lead it round by a via node",
        )


def _depot(spot: Spot, place: Point, ground: _Ground) -> Iterator[Finding]:
    remedy = "move the depot or the outline: vehicles may be sent to depots as rally points"
    if ground.leaves_fence(place):
        yield spot.error("depot-outside", "the depot lies outside the fence", remedy)
    for keep_out in ground.entered(place):
        yield spot.error("depot-outside", f"the depot lies in keep-out '{keep_out}'", remedy)
