"""What moves and changes on the map: routes, tracks, loads, samples, drops and depots."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import rerun as rr

from malipp_field.bus.messages import PlanAdopted
from malipp_field.field import FloatArray
from malipp_field.mission import ABSTRACT_ORIGIN, node_positions, to_globe, to_local
from malipp_field.record import Run
from malipp_field.review.custody import Custody, custody_over_time, loads
from malipp_field.review.site import INK, Color, frame, names, robot_colors
from malipp_field.review.summary import done
from malipp_field.review.timeline import Timeline
from malipp_field.review.tracks import local_track, moves
from malipp_field.vehicle.steps import Action, VehicleMission

# A track is logged anew as it grows; beyond this many stages it would grow the file with the square of its
# length, and nobody could see the difference.
_TRACK_STAGES = 240
_PLANNED_ALPHA = 130
# How far north of a robot its name stands, in markers: robots in one place (the start) can all be read.
_NAME_ROWS = (6.5, 10.5, 14.5)


def log_team(timeline: Timeline, run: Run) -> None:
    """Log of every robot the route planned, the track so far, and the position."""
    for robot, color in robot_colors(run.mission).items():
        _log_routes(timeline, run, robot, color)
        times, places = local_track(run, robot)
        if times.size:
            _log_track(timeline, run, robot, color, times, places)
            _log_position(timeline, run, robot, color, times, places)


def _log_routes(timeline: Timeline, run: Run, robot: str, color: Color) -> None:
    size_m = frame(run.mission).marker_m
    shift = _shift(run, robot)
    timeline.log_static(
        f"site/team/{robot}/route",
        rr.LineStrips2D.from_fields(colors=(*color, _PLANNED_ALPHA), radii=0.17 * size_m, draw_order=14.0),
    )
    for adopted, route in _routes(run, robot):
        strips = [route + shift] if len(route) > 1 else []
        entity = f"site/team/{robot}/route"
        timeline.log(adopted.time_s, entity, rr.LineStrips2D.from_fields(strips=strips))


def _shift(run: Run, robot: str) -> FloatArray:
    """Return by how much a robot's planned route is drawn aside, so that routes on one road are all seen."""
    robots = [other.id for other in run.mission.team.robots]
    aside = robots.index(robot) - (len(robots) - 1) / 2
    return np.array([1.0, -1.0]) * aside * frame(run.mission).marker_m * 0.9


def _routes(run: Run, robot: str) -> Iterator[tuple[PlanAdopted, FloatArray]]:
    """Yield what each plan still had the robot drive when it came into force, in local metres."""
    for adopted in run.plans:
        order = next((order for order in adopted.missions if order.robot == robot), None)
        if order is not None:
            yield adopted, _remaining_route(run, adopted, order)


def _remaining_route(run: Run, adopted: PlanAdopted, order: VehicleMission) -> FloatArray:
    origin = run.mission.site.origin or ABSTRACT_ORIGIN
    reports = [report for report in run.telemetry[order.robot] if report.time_s <= adopted.time_s]
    here = node_positions(run.mission)[run.mission.robot(order.robot).start]
    first = 0
    if reports:
        here = to_local(reports[-1].lat_deg, reports[-1].lon_deg, origin)
        begun = next((report.step_uid for report in reversed(reports) if report.step_uid is not None), "")
        # A vehicle that has finished is past the last step it reported.
        first = (order.index_of(begun) or 0) + reports[-1].finished
    ahead = [step.place for step in order.steps[first:] if step.action is Action.DRIVE]
    return np.array([here, *(to_local(place.lat_deg, place.lon_deg, origin) for place in ahead)])


def _log_track(
    timeline: Timeline, run: Run, robot: str, color: Color, times: FloatArray, places: FloatArray
) -> None:
    size_m = frame(run.mission).marker_m
    kept = moves(places, size_m / 4)
    above = list(run.telemetry).index(robot)
    entity = f"site/team/{robot}/track"
    timeline.log_static(
        entity,
        rr.LineStrips2D.from_fields(
            colors=color, radii=_track_radius(run, above) * size_m, draw_order=12.0 + above / 100
        ),
    )
    if len(kept) < 2:
        return
    stages = np.unique(np.linspace(2, len(kept), _TRACK_STAGES).astype(int))
    for stage in stages:
        so_far = kept[:stage]
        time_s = timeline.start_s + float(times[so_far[-1]])
        timeline.log(time_s, entity, rr.LineStrips2D.from_fields(strips=[places[so_far]]))


def _track_radius(run: Run, above: int) -> float:
    """Return half the width of a track in markers: a lower one is wider, so that its rims are seen."""
    beneath = min(len(run.telemetry) - 1 - above, 3)
    return 0.26 + 0.18 * beneath


def _log_position(
    timeline: Timeline, run: Run, robot: str, color: Color, times: FloatArray, places: FloatArray
) -> None:
    size_m = frame(run.mission).marker_m
    entity = f"site/team/{robot}/position"
    kept = moves(places, size_m / 8)
    timeline.log_static(entity, rr.Points2D.from_fields(colors=color, draw_order=40.0))
    timeline.send(times[kept], entity, rr.Points2D.columns(positions=places[kept]))
    name = f"site/team/{robot}/name"
    above = places[kept] + (0.0, size_m * _NAME_ROWS[list(run.telemetry).index(robot) % len(_NAME_ROWS)])
    timeline.log_static(name, rr.Points2D.from_fields(colors=color, radii=0.0, draw_order=50.0))
    timeline.send(times[kept], name, rr.Points2D.columns(positions=above))
    for time_s, load in [(timeline.start_s + float(times[0]), 0), *loads(run, robot)]:
        # The marker's area grows with the samples on board, and the label counts them.
        timeline.log(time_s, entity, rr.Points2D.from_fields(radii=size_m * 1.15 * math.sqrt(1 + load)))
        timeline.log(time_s, name, rr.Points2D.from_fields(labels=f"{robot} {load}" if load else robot))


def log_custody(timeline: Timeline, run: Run) -> None:
    """Log samples, drops and the tally of the depots as they change."""
    _log_samples(timeline, run)
    _log_depots(timeline, run, run.start_s, Custody())
    for said, custody in custody_over_time(run):
        if said.action is Action.UNLOAD:
            _log_depots(timeline, run, said.time_s, custody)
        elif said.action in (Action.DROP, Action.PICK):
            _log_drops(timeline, run, said.time_s, custody)


def _log_samples(timeline: Timeline, run: Run) -> None:
    places, colors = node_positions(run.mission), robot_colors(run.mission)
    size_m = frame(run.mission).marker_m
    taken = done(run, Action.COLLECT)
    for count, said in enumerate(taken, start=1):
        timeline.log(
            said.time_s,
            "site/samples",
            rr.Points2D(
                [places[sample.node] for sample in taken[:count]],
                colors=[colors[sample.robot] for sample in taken[:count]],
                radii=1.1 * size_m,
                draw_order=25.0,
            ),
        )


def _log_depots(timeline: Timeline, run: Run, time_s: float, custody: Custody) -> None:
    places, size_m = node_positions(run.mission), frame(run.mission).marker_m
    depots = [node.id for node in run.mission.site.nodes if node.role == "depot"]
    timeline.log(
        time_s,
        "site/depots",
        rr.Points2D(
            [places[depot] for depot in depots],
            radii=2.0 * size_m,
            colors=INK,
            draw_order=22.0,
        ),
    )
    tally = [f"{depot}: {custody.delivered[depot]} in" for depot in depots]
    timeline.log(time_s, "site/names/depots", names([places[d] for d in depots], tally, INK, -1.8 * size_m))


def _log_drops(timeline: Timeline, run: Run, time_s: float, custody: Custody) -> None:
    """Log every drop there was as a ring in the colour of who left it, and what lies there in words.

    The disc within the ring is in the colour of who fetched it. How much that was is said when it is pointed
    at, lest old drops cover the map with words.
    """
    places, colors = node_positions(run.mission), robot_colors(run.mission)
    size_m = frame(run.mission).marker_m
    fetched, lying = custody.fetched.items(), [item for item in custody.lying.items() if item[1]]

    def discs(entity: str, radius: float, order: float, held: list[tuple[str, str]], said: list[str]) -> None:
        points = rr.Points2D(
            [places[node] for node, _ in held],
            radii=radius * size_m,
            colors=[colors.get(robot, INK) for _, robot in held],
            labels=said,
            show_labels=False,
            draw_order=order,
        )
        timeline.log(time_s, f"site/drops/{entity}", points)

    left = list(custody.lying)
    discs("left", 2.2, 23.0, left, [f"left by {sender}" for _, sender in left])
    discs(
        "fetched", 1.7, 24.0,
        [(node, receiver) for (node, _, receiver), _ in fetched],
        [f"{count} from {sender} to {receiver}" for (_, sender, receiver), count in fetched],
    )  # fmt: skip
    where = [places[node] for (node, _), _ in lying]
    tints = [colors.get(sender, INK) for (_, sender), _ in lying]
    words = [f"{count} left by {sender}" for (_, sender), count in lying]
    timeline.log(time_s, "site/names/drops", names(where, words, tints, 6.0 * size_m))


def log_online_map(timeline: Timeline, run: Run) -> None:
    """Log tracks and nodes in degrees for the map view, which needs the internet for its tiles."""
    origin = run.mission.site.origin
    if origin is None:
        return
    nodes = [to_globe(x_m, y_m, origin) for x_m, y_m in node_positions(run.mission).values()]
    timeline.log_static("map/nodes", rr.GeoPoints(lat_lon=nodes, radii=rr.Radius.ui_points(4.0), colors=INK))
    for robot, color in robot_colors(run.mission).items():
        reports = run.telemetry[robot]
        if not reports:
            continue
        times, places = local_track(run, robot)
        kept = moves(places, frame(run.mission).marker_m / 8)
        degrees = np.array([(reports[index].lat_deg, reports[index].lon_deg) for index in kept])
        timeline.log_static(
            f"map/{robot}", rr.GeoPoints.from_fields(colors=color, radii=rr.Radius.ui_points(8.0))
        )
        timeline.send(times[kept], f"map/{robot}", rr.GeoPoints.columns(positions=degrees))
        timeline.log_static(
            f"map/{robot}/track",
            rr.GeoLineStrings(lat_lon=[degrees], colors=color, radii=rr.Radius.ui_points(1.5)),
        )
