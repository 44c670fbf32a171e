"""A recorded mission as a Rerun recording, from the MCAP file alone.

=================================  ===================================================================
entity                             what it shows
=================================  ===================================================================
``site/...``                       the map, in metres east and north (see `malipp_field.review.site`)
``site/field/mean``, ``/std``      the field estimate as images, after each confirmed sample
``site/samples``                   where samples were taken, in the colour of the robot that did
``site/drops``, ``site/depots``    what lies or lay at dead drops, and the tally of each depot
``site/team/ROBOT/...``            route planned (a new one with every plan), track, position and load
``series/...``                     energy, load and J over time
``states/ROBOT``, ``/plan``        what the robot was doing, and which plan was in force
``log/...``                        events, replans and payload actions in words
``map/...``                        positions in degrees, for the online map
=================================  ===================================================================

Timelines: ``mission_time`` (since mission time 0) and ``utc``.
"""

from __future__ import annotations

from pathlib import Path

import rerun as rr

from malipp_field.documents import whole_file
from malipp_field.record import Run
from malipp_field.review import map_log, series_log
from malipp_field.review.blueprint import blueprint
from malipp_field.review.field_images import Estimate, Grid, estimates, grid, value_ranges
from malipp_field.review.site import log_site
from malipp_field.review.timeline import Timeline

APPLICATION = "malipp"


def write_review(run: Run, path: Path) -> None:
    """Write a Rerun recording of a run, with its blueprint.

    Raises
    ------
    InputError
        When the file cannot be written.
    """
    with whole_file(path) as partial:
        _write(run, partial)


def _write(run: Run, path: Path) -> None:
    cells = grid(run)
    images = list(estimates(run, cells))
    recording = rr.RecordingStream(APPLICATION, recording_id=f"{run.mission.name}-{run.start_s:.3f}")
    recording.save(path, default_blueprint=blueprint(run, images))
    recording.set_log_time_enabled(False)
    recording.set_log_tick_enabled(False)
    timeline = Timeline(recording, run.start_s)
    log_site(recording, run.mission)
    _log_field(timeline, cells, images)
    map_log.log_team(timeline, run)
    map_log.log_custody(timeline, run)
    map_log.log_online_map(timeline, run)
    series_log.log_series(timeline, run)
    series_log.log_words(timeline, run)
    recording.flush()
    recording.disconnect()


def _log_field(timeline: Timeline, cells: Grid, images: list[Estimate]) -> None:
    """Log the estimates, cell by cell where they belong: row 0 is the northern edge of the frame."""
    place = rr.Transform3D(
        translation=(cells.area.west_m, cells.area.north_m, 0.0), scale=(cells.cell_m, -cells.cell_m, 1.0)
    )
    ranges = value_ranges(images)
    for what, colormap in (("mean", "Viridis"), ("std", "Magma")):
        if what not in ranges:
            continue
        timeline.log_static(f"site/field/{what}", place)
        for estimate in images:
            image = estimate.mean if what == "mean" else estimate.std
            if image is not None:
                picture = rr.DepthImage(
                    image, colormap=colormap, depth_range=ranges[what], magnification_filter="Linear"
                )
                timeline.log(estimate.time_s, f"site/field/{what}", picture)
