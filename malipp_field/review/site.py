"""The site as the review draws it: in true metres east and north, with one colour for every robot.

Everything on the map is logged in the site's own frame, x east and y north. Rerun's 2D views draw y
downwards and cannot be told otherwise (rerun issue 1387), so the entity ``site`` carries the one transform
that mirrors y for display: north is up, and the numbers below ``site`` stay those of the mission file.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import rerun as rr
from shapely.geometry import Polygon

from malipp_field.mission import Mission, keep_out_polygons, node_positions

Color = tuple[int, int, int]
Position = tuple[float, float]

# Okabe and Ito's colours, which people with any colour vision can tell apart, brightened for a dark ground.
_ROBOT_COLORS: tuple[Color, ...] = (
    (240, 180, 20), (86, 190, 245), (235, 105, 60), (60, 200, 140),
    (225, 135, 190), (250, 235, 80), (110, 140, 255), (190, 190, 190),
)  # fmt: skip
INK: Color = (205, 210, 215)
FAINT: Color = (112, 120, 128)
ROAD: Color = (66, 74, 82)
KEEP_OUT: Color = (142, 128, 122)
BACKGROUND: Color = (16, 20, 24)

# Of the site's longer side: the margin around it, and the size of a candidate's marker.
_MARGIN = 0.1
_MARKER = 0.008
# In markers: keep-outs narrower than this are drawn without their names.
_NAMED_FROM = 15.0


@dataclass(frozen=True)
class Frame:
    """The part of the plane that is drawn, in metres east and north."""

    west_m: float
    south_m: float
    east_m: float
    north_m: float

    @property
    def span_m(self) -> float:
        """The longer side."""
        return max(self.east_m - self.west_m, self.north_m - self.south_m)

    @property
    def marker_m(self) -> float:
        """Radius of a candidate's marker; all other sizes follow from it."""
        return self.span_m * _MARKER


def frame(mission: Mission) -> Frame:
    """Return the frame around everything the mission file places."""
    outlines = [polygon.exterior.coords for polygon in keep_out_polygons(mission).values()]
    places = np.array([*node_positions(mission).values(), *(xy for outline in outlines for xy in outline)])
    (west, south), (east, north) = places.min(axis=0), places.max(axis=0)
    margin = _MARGIN * max(east - west, north - south, 1.0)
    return Frame(west - margin, south - margin, east + margin, north + margin)


def robot_colors(mission: Mission) -> dict[str, Color]:
    """Return the colour of each robot, the same in every view."""
    return {
        robot.id: _ROBOT_COLORS[index % len(_ROBOT_COLORS)] for index, robot in enumerate(mission.team.robots)
    }


def log_site(recording: rr.RecordingStream, mission: Mission) -> None:
    """Log what does not change: the mirror, roads, keep-outs and nodes by role."""
    size_m = frame(mission).marker_m
    places = node_positions(mission)
    recording.log("site", rr.Transform3D(scale=(1.0, -1.0, 1.0)), static=True)
    recording.log("site/roads", _roads(mission, size_m), static=True)
    recording.log("site/keep_outs", _keep_outs(mission, size_m), static=True)
    for role, radius, color in (("via", 0.3, ROAD), ("start", 1.0, INK), ("candidate", 0.9, FAINT)):
        ids = [node.id for node in mission.site.nodes if node.role == role]
        points = rr.Points2D(
            [places[node] for node in ids], radii=radius * size_m, colors=color, draw_order=20.0
        )
        recording.log(f"site/nodes/{role}", points, static=True)
    named = [node.id for node in mission.site.nodes if node.role in ("candidate", "start")]
    beneath = [places[node] for node in named]
    recording.log("site/names/nodes", names(beneath, named, INK, -1.2 * size_m), static=True)
    outlines = {name: area for name, area in keep_out_polygons(mission).items() if _has_room(area, size_m)}
    inside = [polygon.representative_point() for polygon in outlines.values()]
    centres = [(point.x, point.y) for point in inside]
    recording.log("site/names/keep_outs", names(centres, list(outlines), KEEP_OUT, 0.0), static=True)


def names(
    places_m: Sequence[Position], texts: Sequence[str], colors: Color | Sequence[Color], north_m: float
) -> rr.Points2D:
    """Return labels that stand ``north_m`` north of their places; the points themselves are not seen."""
    return rr.Points2D(
        [(x_m, y_m + north_m) for x_m, y_m in places_m],
        labels=list(texts),
        colors=colors,
        radii=0.0,
        show_labels=True,
        draw_order=50.0,
    )


def _has_room(area: Polygon, size_m: float) -> bool:
    """Whether a keep-out is wide enough for its name; over a small one it would hide the roads around."""
    west, _, east, _ = area.bounds
    return bool(east - west >= _NAMED_FROM * size_m)


def _roads(mission: Mission, size_m: float) -> rr.LineStrips2D:
    places = node_positions(mission)
    strips = [np.array([places[edge.from_], places[edge.to]]) for edge in mission.site.edges]
    return rr.LineStrips2D(strips, colors=ROAD, radii=0.22 * size_m, draw_order=5.0)


def _keep_outs(mission: Mission, size_m: float) -> rr.LineStrips2D:
    polygons = keep_out_polygons(mission)
    return rr.LineStrips2D(
        [np.array(polygon.exterior.coords) for polygon in polygons.values()],
        colors=KEEP_OUT,
        radii=0.3 * size_m,
        draw_order=6.0,
    )
