"""A plan as features of a map: what there is to draw, whatever the file format."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Literal, TypeAlias

from shapely import Polygon
from shapely.geometry.polygon import orient

from malipp_field.mission import Mission, fence_polygon, keep_out_polygons, node_positions, to_globe
from malipp_field.mission.schema import Origin
from malipp_field.plan import Plan, RobotPlan, Stop
from malipp_field.vehicle.compile import Compiled
from malipp_field.vehicle.steps import Action, GeoPoint, Step, VehicleMission

Kind: TypeAlias = Literal["fence", "keep_out", "node", "drop", "route", "stop"]
Shape: TypeAlias = Literal["Point", "LineString", "Polygon"]
Degrees: TypeAlias = tuple[float, float]
"""Latitude and longitude."""
Json: TypeAlias = "dict[str, Json] | list[Json] | str | float | int | bool | None"

# Okabe and Ito's colours, which people with any colour vision can tell apart on a light map.
_ROBOT_COLORS = ("#d55e00", "#0072b2", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#8c510a", "#5a5a5a")
_INSIDE, _OUTSIDE, _DROP = "#2f6f3e", "#b2182b", "#000000"
_ROLE_COLORS = {"depot": "#000000", "start": "#555555", "candidate": "#888888", "via": "#bbbbbb"}

_ROUTE_WIDTH, _MOST_WIDENED = 3, 3


@dataclass(frozen=True)
class Feature:
    """One thing to draw.

    Attributes
    ----------
    id
        The same in every export of a plan.
    kind, title, lines
        What it is, its name on the map, and what there is to say about it.
    shape, places
        A point, a line, or a polygon whose first corner is also its last and whose interior lies to the left.
    color
        ``#rrggbb``; a robot's is the same for all of its features.
    robot
        Whose route or stop it is.
    width
        Of a line or outline, in pixels; routes drawn first are wider, so that later ones do not hide them.
    data
        The same as the words, for programs.
    """

    id: str
    kind: Kind
    title: str
    shape: Shape
    places: tuple[Degrees, ...]
    color: str
    lines: tuple[str, ...] = ()
    robot: str | None = None
    width: int = 2
    data: tuple[tuple[str, Json], ...] = ()


def map_features(
    mission: Mission, origin: Origin, plan: Plan, compiled: Compiled, start_s: float | None = None
) -> list[Feature]:
    """Return the features of a plan: the site first, then the drops, then robot by robot.

    Parameters
    ----------
    mission, origin
        The site; an abstract one has no place on a map.
    plan, compiled
        The plan, and its steps with the containers' tags.
    start_s
        When mission time 0 is, in seconds since the Unix epoch; without it times count from 0.
    """
    clock = _Clock(start_s)
    colors = {robot.id: _ROBOT_COLORS[i % len(_ROBOT_COLORS)] for i, robot in enumerate(mission.team.robots)}
    features = [*_areas(mission, origin), *_nodes(mission, origin), *_drops(compiled)]
    for over, robot in zip(reversed(range(len(plan.robots))), plan.robots, strict=True):
        vehicle, color = compiled.missions[robot.id], colors[robot.id]
        width = _ROUTE_WIDTH + 2 * min(over, _MOST_WIDENED)
        features += _route(robot, vehicle, color, width, clock)
        features += _stops(robot, vehicle.steps, color, clock)
    return features


def utc(time_s: float) -> str:
    """Return a time in seconds since the Unix epoch as ISO 8601 has it, to the second."""
    return datetime.fromtimestamp(round(time_s), UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


@dataclass(frozen=True)
class _Clock:
    """Mission time in words: of day where it is known when the mission starts."""

    start_s: float | None

    def __call__(self, time_s: float) -> str:
        return f"{time_s:.0f} s" if self.start_s is None else utc(self.start_s + time_s)


def _areas(mission: Mission, origin: Origin) -> Iterator[Feature]:
    fence = fence_polygon(mission)
    if fence is not None:
        yield Feature("fence", "fence", "fence", "Polygon", _ring(fence, origin), _INSIDE)
    for name, polygon in keep_out_polygons(mission).items():
        yield Feature(f"keep_out/{name}", "keep_out", name, "Polygon", _ring(polygon, origin), _OUTSIDE)


def _ring(polygon: Polygon, origin: Origin) -> tuple[Degrees, ...]:
    """Return a closed ring, anticlockwise as seen from above."""
    return tuple(to_globe(x_m, y_m, origin) for x_m, y_m in orient(polygon, 1.0).exterior.coords)


def _nodes(mission: Mission, origin: Origin) -> Iterator[Feature]:
    places = node_positions(mission)
    for node in mission.site.nodes:
        yield Feature(
            f"node/{node.id}", "node", node.id, "Point", (to_globe(*places[node.id], origin),),
            _ROLE_COLORS[node.role], lines=(node.role,), data=(("role", node.role),),
        )  # fmt: skip


def _drops(compiled: Compiled) -> Iterator[Feature]:
    """Yield what one robot leaves for another at a node, with its tags."""
    found: dict[tuple[str, str, str], list[Step]] = {}
    for vehicle in compiled.missions.values():
        for step in vehicle.steps:
            if step.action is Action.DROP and step.peer is not None:
                found.setdefault((step.node, vehicle.robot, step.peer), []).append(step)
    for (node, sender, receiver), steps in found.items():
        tags = [tag for step in steps for tag in step.tags]
        yield Feature(
            f"drop/{node}/{sender}/{receiver}", "drop", f"{node}: {sender} to {receiver}", "Point",
            (_degrees(steps[0].place),), _DROP, lines=(_containers(tags),),
            data=(("node", node), ("sender", sender), ("receiver", receiver), ("tags", [*tags])),
        )  # fmt: skip


def _route(
    robot: RobotPlan, vehicle: VehicleMission, color: str, width: int, clock: _Clock
) -> Iterator[Feature]:
    places = [vehicle.home, *(step.place for step in vehicle.steps if step.action is Action.DRIVE)]
    if len(places) == 1:  # it stays where it is
        return
    energy_j = sum(stop.leg_energy_j or 0.0 for stop in robot.route)
    end_s = robot.route[-1].depart_s
    yield Feature(
        f"{robot.id}/route", "route", robot.id, "LineString", tuple(map(_degrees, places)), color,
        lines=(f"{energy_j:.0f} J", f"ends at {clock(end_s)}"), robot=robot.id, width=width,
        data=(("energy_j", energy_j), ("end_s", end_s)),
    )  # fmt: skip


def _stops(robot: RobotPlan, steps: tuple[Step, ...], color: str, clock: _Clock) -> Iterator[Feature]:
    for index, stop in enumerate(robot.route):
        here = [step for step in steps if step.stop == index and step.action is not Action.DRIVE]
        if here:
            yield Feature(
                f"{robot.id}/stop/{index}", "stop", f"{robot.id} {index}: {stop.node}", "Point",
                (_degrees(here[0].place),), color, lines=tuple(_words(stop, here, clock)), robot=robot.id,
                data=(
                    ("stop", index), ("node", stop.node), ("arrive_s", stop.arrive_s),
                    ("depart_s", stop.depart_s),
                    ("actions", [{"action": s.action, "tags": [*s.tags], "peer": s.peer} for s in here]),
                ),
            )  # fmt: skip


def _words(stop: Stop, steps: list[Step], clock: _Clock) -> Iterator[str]:
    if stop.arrive_s is not None:
        yield f"arrives at {clock(stop.arrive_s)}"
    for step in steps:
        peer = "" if step.peer is None else f" ({step.peer})"
        gate = "" if step.not_before_s is None else f", at most until {utc(step.not_before_s)}"
        yield f"{step.action} {', '.join(map(str, step.tags))}{peer}{gate}"
    yield f"leaves at {clock(stop.depart_s)}"


def _containers(tags: list[int]) -> str:
    return f"container{'s' if len(tags) > 1 else ''} {', '.join(map(str, tags))}"


def _degrees(place: GeoPoint) -> Degrees:
    return place.lat_deg, place.lon_deg
