"""Read a mission file and refuse what cannot be: dangling names, impossible places, blocked edges."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from shapely.geometry import LineString, Point, Polygon

from malipp_field.documents import ContentError, Document, Location, parse_document, read_document, suggest
from malipp_field.mission.geo import locate
from malipp_field.mission.graph import fence_polygon, keep_out_polygons, node_positions
from malipp_field.mission.schema import Edge, Mission, Place
from malipp_field.mission.vehicles import GroundStation


def read_mission(path: Path) -> Mission:
    """Read and check a mission file.

    Raises
    ------
    InputError
        With file, line, key and what would be right.
    """
    return _checked(read_document(path))


def parse_mission(text: str, source: str = "mission") -> Mission:
    """Read and check a mission from text, as a recording carries it; raises like `read_mission`."""
    return _checked(parse_document(text, source))


def _checked(document: Document) -> Mission:
    mission = document.validate(Mission)
    try:
        _check_places(mission)
        _check_graph(mission)
        _check_team(mission)
        _check_keep_outs(mission)
        _check_fence(mission)
        _check_vehicles(mission)
    except ContentError as fault:
        raise document.error(fault.location, fault.problem) from None
    return mission


def _check_places(mission: Mission) -> None:
    site = mission.site
    groups: list[tuple[Location, Iterable[Place]]] = [
        (("site", "nodes"), site.nodes),
        (("field", "test_points"), mission.field.test_points),
        (("simulation", "terrain"), mission.simulation.terrain),
        *[(("site", "keep_outs", i, "polygon"), k.polygon) for i, k in enumerate(site.keep_outs)],
        (("site", "fence"), site.fence or ()),
    ]
    for location, places in groups:
        for index, place in enumerate(places):
            try:
                locate(place, site.origin)
            except ValueError as fault:
                raise ContentError((*location, index), str(fault)) from None


def _check_graph(mission: Mission) -> None:
    site = mission.site
    nodes = [node.id for node in site.nodes]
    robots = [robot.id for robot in mission.team.robots]
    _check_unique(nodes, ("site", "nodes"), "node")
    seen: dict[tuple[str, str], int] = {}
    for index, edge in enumerate(site.edges):
        here: Location = ("site", "edges", index)
        for key, node in (("from", edge.from_), ("to", edge.to)):
            _check_known(node, nodes, (*here, key), "node")
        if edge.from_ == edge.to:
            raise ContentError((*here, "to"), f"an edge joins two different nodes, found '{edge.to}' twice")
        for direction in _directions(edge):
            if direction in seen:
                raise ContentError(
                    here,
                    f"{direction[0]} to {direction[1]} is given already by edges[{seen[direction]}]",
                )
            seen[direction] = index
        for key in ("energy_factor", "speed_factor"):
            for robot in getattr(edge, key):
                _check_known(robot, robots, (*here, key, robot), "robot")
        for position, robot in enumerate(edge.closed_to):
            _check_known(robot, robots, (*here, "closed_to", position), "robot")
    if not site.edges and not site.complete and len(nodes) > 1:
        raise ContentError(("site",), "no node can be left: give edges, or complete: true")


def _check_team(mission: Mission) -> None:
    roles = {node.id: node.role for node in mission.site.nodes}
    _check_unique([robot.id for robot in mission.team.robots], ("team", "robots"), "robot")
    for index, robot in enumerate(mission.team.robots):
        here: Location = ("team", "robots", index)
        _check_known(robot.start, list(roles), (*here, "start"), "node")
        for position, depot in enumerate(robot.depots):
            _check_known(depot, list(roles), (*here, "depots", position), "node")
            if roles[depot] != "depot":
                raise ContentError(
                    (*here, "depots", position), f"node '{depot}' has role {roles[depot]}, a depot is needed"
                )
        if len(set(robot.depots)) < len(robot.depots):
            raise ContentError((*here, "depots"), "the same depot is listed twice")


def _check_keep_outs(mission: Mission) -> None:
    site = mission.site
    _check_unique([keep_out.id for keep_out in site.keep_outs], ("site", "keep_outs"), "keep-out")
    polygons = keep_out_polygons(mission)
    for index, (keep_out_id, polygon) in enumerate(polygons.items()):
        if not polygon.is_valid:
            raise ContentError(
                ("site", "keep_outs", index, "polygon"), f"the outline of '{keep_out_id}' crosses itself"
            )
    places = node_positions(mission)
    for index, edge in enumerate(site.edges):
        line = LineString([places[edge.from_], places[edge.to]])
        for keep_out_id, polygon in polygons.items():
            if _crosses(line, polygon):
                raise ContentError(
                    ("site", "edges", index),
                    f"the straight edge {edge.from_} to {edge.to} crosses keep-out '{keep_out_id}'; "
                    "lead it round by a via node",
                )


def _check_fence(mission: Mission) -> None:
    fence = fence_polygon(mission)
    if fence is None:
        return
    if not fence.is_valid:
        raise ContentError(("site", "fence"), "the outline crosses itself")
    for index, (node, place) in enumerate(node_positions(mission).items()):
        if not fence.covers(Point(place)):
            raise ContentError(("site", "nodes", index), f"node '{node}' lies outside the fence")
    places = node_positions(mission)
    for index, edge in enumerate(mission.site.edges):
        if not fence.covers(LineString([places[edge.from_], places[edge.to]])):
            raise ContentError(
                ("site", "edges", index),
                f"the straight edge {edge.from_} to {edge.to} leaves the fence; lead it round by a via node",
            )


def _check_vehicles(mission: Mission) -> None:
    robots = [robot.id for robot in mission.team.robots]
    for robot in mission.vehicles:
        _check_known(robot, robots, ("vehicles", robot), "robot")
    if not mission.vehicles and mission.ground_station == GroundStation():
        return  # ids by position differ; teams of more than 254 can be planned for, if not driven
    taken: dict[int, str] = {mission.ground_station.system_id: "the ground station"}
    for robot in robots:
        system_id = mission.vehicle(robot).system_id or 0
        if system_id in taken:
            raise ContentError(
                ("vehicles", robot, "system_id"),
                f"MAVLink system id {system_id} of '{robot}' is that of {taken[system_id]} already",
            )
        taken[system_id] = f"'{robot}'"


def _crosses(line: LineString, polygon: Polygon) -> bool:
    return bool(line.intersects(polygon) and not line.touches(polygon))


def _directions(edge: Edge) -> list[tuple[str, str]]:
    return [(edge.from_, edge.to)] if edge.one_way else [(edge.from_, edge.to), (edge.to, edge.from_)]


def _check_unique(names: list[str], location: Location, what: str) -> None:
    first: dict[str, int] = {}
    for index, name in enumerate(names):
        if name in first:
            raise ContentError(
                (*location, index, "id"), f"{what} '{name}' is given already by {location[-1]}[{first[name]}]"
            )
        first[name] = index


def _check_known(name: str, known: list[str], location: Location, what: str) -> None:
    if name not in known:
        raise ContentError(location, f"unknown {what} '{name}'" + suggest(name, known))
