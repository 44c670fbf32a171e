"""The physical motion graph of a site: what each robot can drive, how far, at what cost."""

from __future__ import annotations

import itertools
import math
from typing import NamedTuple

from shapely.geometry import LineString, Polygon
from shapely.ops import unary_union

from malipp_field.mission.geo import locate
from malipp_field.mission.schema import Mission

Position = tuple[float, float]


class Passage(NamedTuple):
    """One edge in the direction in which one robot may drive it."""

    tail: str
    head: str
    length_m: float
    energy_per_kg: float
    """alpha_e of this robot: joules for each kilogram moved (robot and payload)."""
    time_s: float


def node_positions(mission: Mission) -> dict[str, Position]:
    """Return (east, north) in metres of every node."""
    return {node.id: locate(node, mission.site.origin) for node in mission.site.nodes}


def keep_out_polygons(mission: Mission) -> dict[str, Polygon]:
    """Return the keep-outs in local metres, by id."""
    origin = mission.site.origin
    return {
        keep_out.id: Polygon([locate(place, origin) for place in keep_out.polygon])
        for keep_out in mission.site.keep_outs
    }


def fence_polygon(mission: Mission) -> Polygon | None:
    """Return the area no vehicle may leave, in local metres; `None` where the mission has no fence."""
    fence = mission.site.fence
    return None if fence is None else Polygon([locate(place, mission.site.origin) for place in fence])


def drives_alike(mission: Mission) -> list[tuple[str, ...]]:
    """Return the ids of the robots in groups whose `passages` are the same, each in the order of the team."""
    named: dict[str, list[tuple[int, bool, float, float]]] = {}
    for i, edge in enumerate(mission.site.edges):
        for robot_id in {*edge.closed_to, *edge.energy_factor, *edge.speed_factor}:
            factors = edge.energy_factor.get(robot_id, 1.0), edge.speed_factor.get(robot_id, 1.0)
            named.setdefault(robot_id, []).append((i, robot_id in edge.closed_to, *factors))
    groups: dict[tuple[object, ...], list[str]] = {}
    for robot in mission.team.robots:
        key = robot.energy_per_kg_m, robot.speed_m_s, *named.get(robot.id, [])
        groups.setdefault(key, []).append(robot.id)
    return [tuple(group) for group in groups.values()]


def passages(mission: Mission, robot_id: str) -> list[Passage]:
    """Return every directed edge that ``robot_id`` may drive.

    Explicit edges first; in a `complete` site also a straight one for every pair of nodes that no keep-out
    separates, that stays within the fence, and that no explicit edge joins in that direction.
    """
    robot = mission.robot(robot_id)
    places = node_positions(mission)
    given: set[tuple[str, str]] = set()
    found: list[Passage] = []

    def add(tail: str, head: str, length_m: float, energy_factor: float, speed_factor: float) -> None:
        found.append(
            Passage(
                tail, head, length_m,
                energy_per_kg=robot.energy_per_kg_m * length_m * energy_factor,
                time_s=length_m / (robot.speed_m_s * speed_factor),
            )
        )  # fmt: skip

    for edge in mission.site.edges:
        length_m = math.dist(places[edge.from_], places[edge.to]) if edge.length_m is None else edge.length_m
        directions = [(edge.from_, edge.to)] + ([] if edge.one_way else [(edge.to, edge.from_)])
        given.update(directions)
        if robot_id in edge.closed_to:
            continue
        dearer, faster = edge.energy_factor.get(robot_id, 1.0), edge.speed_factor.get(robot_id, 1.0)
        for tail, head in directions:
            add(tail, head, length_m, dearer, faster)
    if mission.site.complete:
        blocked, fence = unary_union(list(keep_out_polygons(mission).values())), fence_polygon(mission)
        for tail, head in itertools.permutations(places, 2):
            line = LineString([places[tail], places[head]])
            free = not line.intersects(blocked) or line.touches(blocked)
            if (tail, head) not in given and free and (fence is None or fence.covers(line)):
                add(tail, head, line.length, 1.0, 1.0)
    return found
