"""How the review looks when it is opened: the map in the middle of everything, the field beside it."""

from __future__ import annotations

import rerun.blueprint as rrb
from rerun.blueprint.encodings import TimelineColumn

from malipp_field.record import Run
from malipp_field.review.field_images import Estimate, value_ranges
from malipp_field.review.site import BACKGROUND, Frame, frame
from malipp_field.review.timeline import MISSION_TIME

_MAP = ["/site/**", "- /site/field/**"]
_UNDER_FIELD = ["/site/keep_outs", "/site/samples"]


def blueprint(run: Run, images: list[Estimate]) -> rrb.Blueprint:
    """Return the layout of a run's review."""
    area = frame(run.mission)
    bounds = rrb.VisualBounds2D(x_range=(area.west_m, area.east_m), y_range=(-area.north_m, -area.south_m))
    return rrb.Blueprint(
        rrb.Vertical(
            rrb.Horizontal(_maps(run, bounds), _field(area, images, bounds), column_shares=[2.0, 1.0]),
            rrb.Horizontal(*_series(run), _words(), column_shares=[1.25, 1.0, 1.25]),
            row_shares=[2.0, 1.0],
        ),
        rrb.TimePanel(state="collapsed", timeline=MISSION_TIME, play_state="following"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.BlueprintPanel(state="collapsed"),
        auto_views=False,
        auto_layout=False,
    )


def _maps(run: Run, bounds: rrb.VisualBounds2D) -> rrb.Container | rrb.View:
    site = rrb.Spatial2DView(
        origin="/", contents=_MAP,
        name="Site: planned (thin), driven (bold), drops (ring: left by, disc: fetched by)",
        background=BACKGROUND, visual_bounds=bounds,
    )  # fmt: skip
    if run.mission.site.origin is None:
        return site
    online = rrb.MapView(origin="/map", name="Online map")
    return rrb.Tabs(site, online, active_tab=0)


def _field(area: Frame, images: list[Estimate], bounds: rrb.VisualBounds2D) -> rrb.Container | rrb.View:
    """Return the field's views, stacked where the site is wide and side by side where it is tall."""
    ranges = value_ranges(images)
    views = [
        rrb.Spatial2DView(
            origin="/", contents=[f"/site/field/{what}", *_UNDER_FIELD],
            name=f"Field: {title}, {ranges[what][0]:.2g} to {ranges[what][1]:.2g}",
            background=BACKGROUND, visual_bounds=bounds,
        )
        for what, title in (("mean", "mean"), ("std", "standard deviation"))
        if what in ranges
    ]  # fmt: skip
    wide = area.east_m - area.west_m > area.north_m - area.south_m
    return rrb.Vertical(*views) if wide else rrb.Horizontal(*views)


def _series(run: Run) -> list[rrb.Container | rrb.View]:
    whole = rrb.TimeRange(
        start=rrb.TimeRangeBoundary.absolute(seconds=0.0),
        end=rrb.TimeRangeBoundary.absolute(seconds=run.end_s - run.start_s),
    )
    energy, payload, information = (
        rrb.TimeSeriesView(
            origin=f"/series/{what}", name=name, axis_x=rrb.TimeAxis(view_range=whole), plot_legend=legend
        )
        for what, name, legend in (
            ("energy", "Energy, % of budget: used (bold), planned", rrb.PlotLegend(visible=False)),
            ("payload", "Samples on board", rrb.PlotLegend("RightTop")),
            ("information", "J", rrb.PlotLegend("RightTop")),
        )
    )
    return [energy, rrb.Tabs(payload, information, active_tab=0)]


def _words() -> rrb.Container:
    return rrb.Tabs(
        rrb.TextLogView(
            origin="/log",
            name="Events",
            # The texts begin with the mission time in minutes and seconds, which is easier to read.
            columns=rrb.TextLogColumns(
                timeline_columns=[TimelineColumn(timeline=MISSION_TIME, visible=False)],
                text_log_columns=["LogLevel", "Body"],
            ),
        ),
        rrb.StateTimelineView(origin="/states", name="What each robot was doing"),
        active_tab=0,
    )
