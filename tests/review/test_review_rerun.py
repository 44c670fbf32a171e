"""The Rerun recording made from the synthetic mission's MCAP file, read back."""

from __future__ import annotations

import dataclasses
import math
from collections import defaultdict
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import synthetic_plan
import synthetic_run
from rerun.chunk import RrdReader

from malipp_field.bus.messages import Telemetry
from malipp_field.errors import InputError
from malipp_field.field import Observation, posterior
from malipp_field.mission import node_positions
from malipp_field.record import Run, read_run
from malipp_field.review import Summary, review, summarise, write_review
from malipp_field.review.field_images import Grid, estimates, grid
from malipp_field.review.site import Frame, frame

Rows = dict[str, list[dict[str, Any]]]


def _rows(rrd: Path) -> Rows:
    """Return the rows of every entity of the recording in the order of mission time, in seconds."""
    rows: Rows = defaultdict(list)
    for chunk in RrdReader(rrd).stream().to_chunks():
        batch = chunk.to_record_batch()
        columns = {
            name: (column.cast("int64").to_numpy() / 1e9).tolist()
            if name in ("mission_time", "utc")
            else column.to_pylist()
            for name, column in zip(batch.schema.names, batch.columns, strict=True)
        }
        rows[chunk.entity_path] += [
            dict(zip(columns, values, strict=True)) for values in zip(*columns.values(), strict=True)
        ]
    for found in rows.values():
        found.sort(key=lambda row: float(row.get("mission_time", -math.inf)))
    return rows


def _timed(rows: Rows, entity: str, component: str) -> list[tuple[float, Any]]:
    """Return (mission time in seconds, value) of one component."""
    return [
        (row["mission_time"], row[component])
        for row in rows[entity]
        if "mission_time" in row and row.get(component) is not None
    ]


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Summary]:
    directory = tmp_path_factory.mktemp("review")
    mcap = synthetic_run.record(directory / "twin-pits.mcap")
    return directory / "twin-pits.rrd", review(mcap, directory / "twin-pits.rrd")


@pytest.fixture(scope="module")
def rows(made: tuple[Path, Summary]) -> Rows:
    return _rows(made[0])


@pytest.fixture(scope="module")
def run(made: tuple[Path, Summary]) -> Run:
    return read_run(made[0].with_suffix(".mcap"))


def test_one_recording_with_its_blueprint_and_the_summary(made: tuple[Path, Summary], run: Run) -> None:
    reader = RrdReader(made[0])
    assert [entry.application_id for entry in reader.recordings()] == ["malipp"]
    assert len(reader.blueprints()) == 1
    assert made[1] == summarise(run)
    assert not list(made[0].parent.glob("*.partial"))


def test_every_moment_has_both_times(rows: Rows) -> None:
    timed = [row for found in rows.values() for row in found if "mission_time" in row]
    assert len(timed) > 1000
    for row in timed:
        assert row["utc"] - row["mission_time"] == pytest.approx(synthetic_run.START_S, abs=1e-3)
    names = {name for found in rows.values() for row in found for name in row}
    assert not names & {"log_time", "log_tick"}


def test_the_map_keeps_true_metres_and_is_mirrored_once(rows: Rows) -> None:
    (mirror,) = [row for row in rows["/site"] if "Transform3D:scale" in row]
    assert list(mirror["Transform3D:scale"][0]) == [1.0, -1.0, 1.0]
    places = node_positions(synthetic_plan.mission())
    (candidates,) = rows["/site/nodes/candidate"]
    drawn = {tuple(np.round(xy, 3)) for xy in candidates["Points2D:positions"]}
    ids = [node.id for node in synthetic_plan.mission().site.nodes if node.role == "candidate"]
    assert drawn == {places[node] for node in ids}
    (names,) = rows["/site/names/nodes"]
    assert names["Points2D:labels"] == ids


def test_energy_in_percent_of_the_budget_against_both_plans(rows: Rows, run: Run) -> None:
    used = _timed(rows, "/series/energy/mule/used", "Scalars:scalars")
    reports = run.telemetry["mule"]
    assert len(used) == len(reports)
    assert used[-1][1][0] == pytest.approx(
        100.0 * (reports[-1].energy_used_j - synthetic_run.IDLE_J) / 6500.0
    )
    first = _timed(rows, "/series/energy/mule/plan_1", "Scalars:scalars")
    assert first[-1][1][0] == pytest.approx(100.0 * synthetic_plan.plan(1).robot("mule").energy_j / 6500.0)
    assert _timed(rows, "/series/energy/mule/plan_2", "Scalars:scalars")[0][0] == synthetic_plan.REPLAN_S


def test_the_load_is_seen_as_a_number_an_area_and_a_label(rows: Rows) -> None:
    loads = [value[0] for _, value in _timed(rows, "/series/payload/mule", "Scalars:scalars")]
    assert loads == [0, 1, 2, 3, 4, 3, 2, 1, 0, 0]
    labels = [value[0] for _, value in _timed(rows, "/site/team/mule/name", "Points2D:labels")]
    assert labels == ["mule", "mule 1", "mule 2", "mule 3", "mule 4", "mule 3", "mule 2", "mule 1", "mule"]
    radii = [value[0] for _, value in _timed(rows, "/site/team/mule/position", "Points2D:radii")]
    assert radii[4] / radii[0] == pytest.approx(math.sqrt(5.0), rel=1e-5)


def test_track_and_routes(rows: Rows) -> None:
    places = node_positions(synthetic_plan.mission())
    stages = _timed(rows, "/site/team/lark/track", "LineStrips2D:strips")
    assert all(len(a[1][0]) < len(b[1][0]) for a, b in pairwise(stages))
    assert np.allclose(stages[-1][1][0][0], places["base"], atol=0.2)
    assert np.allclose(stages[-1][1][0][-1], places["base"], atol=0.5)
    first, second = _timed(rows, "/site/team/kite/route", "LineStrips2D:strips")
    assert (first[0], second[0]) == (-1.0, synthetic_plan.REPLAN_S)
    assert len(first[1][0]) == 9  # camp e2 e3 e4 e5 e6 e5 e4 camp
    assert len(second[1][0]) == 4  # from where it was: e5 e4 camp


def test_drops_say_who_left_and_who_fetched_and_depots_count(rows: Rows) -> None:
    lying = [value for _, value in _timed(rows, "/site/names/drops", "Points2D:labels")]
    assert lying == [["1 left by kite"], ["2 left by kite"], ["1 left by kite"], []]
    fetched = [value for _, value in _timed(rows, "/site/drops/fetched", "Points2D:labels")]
    assert fetched == [[], [], ["1 from kite to mule"], ["2 from kite to mule"]]
    colors = {
        robot: _timed(rows, f"/site/drops/{what}", "Points2D:colors")[-1][1][0]
        for robot, what in (("kite", "left"), ("mule", "fetched"))
    }
    (track,) = [row for row in rows["/site/team/kite/track"] if row.get("LineStrips2D:colors")]
    assert colors["kite"] == track["LineStrips2D:colors"][0]
    assert colors["mule"] != colors["kite"]
    tallies = _timed(rows, "/site/names/depots", "Points2D:labels")
    assert tallies[0] == (0.0, ["base: 0 in", "camp: 0 in"])
    assert tallies[-1][1] == ["base: 8 in", "camp: 2 in"]


def test_the_field_improves_with_every_sample_and_lies_north_up(rows: Rows, run: Run) -> None:
    cells = grid(run)
    area = frame(run.mission)
    (place,) = [row for row in rows["/site/field/std"] if row.get("Transform3D:scale")]
    assert np.allclose(place["Transform3D:translation"][0][:2], (area.west_m, area.north_m))
    assert np.allclose(place["Transform3D:scale"][0][:2], (cells.cell_m, -cells.cell_m))
    stds = _timed(rows, "/site/field/std", "DepthImage:buffer")
    means = _timed(rows, "/site/field/mean", "DepthImage:buffer")
    assert (len(stds), len(means)) == (11, 10)  # the prior has no mean to show
    images = [_image(buffer, cells) for _, buffer in stds]
    assert np.all(images[0] == 1.0)
    assert all(np.all(after <= before + 1e-6) for before, after in pairwise(images))
    _assert_is_the_estimate(_image(means[-1][1], cells), cells, run)


def _image(buffer: Any, cells: Grid) -> Any:
    return np.frombuffer(bytes(buffer[0]), dtype=np.float32).reshape(cells.rows, cells.columns)


def _assert_is_the_estimate(mean: Any, cells: Grid, run: Run) -> None:
    """Compare with the posterior at two cells found by hand: the north-west corner and the one at w6."""
    places = node_positions(run.mission)
    observations = [
        Observation(*places[c.node], c.value, run.mission.robot(c.robot).noise_variance)
        for c in run.confirmations
        if c.value is not None
    ]
    area, size = cells.area, cells.cell_m
    corner = (area.west_m + size / 2, area.north_m - size / 2)
    row, column = int((area.north_m - places["w6"][1]) / size), int((places["w6"][0] - area.west_m) / size)
    there = (area.west_m + (column + 0.5) * size, area.north_m - (row + 0.5) * size)
    expected, _ = posterior(run.mission.field.kernel, observations, [corner, there])
    assert (mean[0, 0], mean[row, column]) == pytest.approx(tuple(expected), abs=1e-5)


def test_words_states_and_the_online_map(rows: Rows) -> None:
    events = [value[0] for _, value in _timed(rows, "/log/events", "TextLog:text")]
    assert len(events) == 5
    assert events[2] == "1:01  mule: 24 s late at w6"
    plans = [value[0] for _, value in _timed(rows, "/log/plans", "TextLog:text")]
    assert plans[1].startswith("1:05  plan 2 (J 1.143): mule will be")
    custody = [value[0] for _, value in _timed(rows, "/log/custody", "TextLog:text")]
    assert len(custody) == 24
    assert "0:41  kite left 1 at e3" in custody
    states = [value[0] for _, value in _timed(rows, "/states/mule", "StateChange:state")]
    assert states[0] == "ready"
    assert states[-1] == "finished"
    assert {"driving", "sampling", "picking", "unloading"} <= set(states)
    versions = _timed(rows, "/states/plan", "StateChange:state")
    assert versions == [(-1.0, ["plan 1"]), (synthetic_plan.REPLAN_S, ["plan 2"])]
    assert _timed(rows, "/map/mule", "GeoPoints:positions")


def test_without_values_only_the_uncertainty_is_shown(run: Run, tmp_path: Path) -> None:
    blind = dataclasses.replace(
        run, confirmations=tuple(c.model_copy(update={"value": None}) for c in run.confirmations)
    )
    write_review(blind, tmp_path / "blind.rrd")
    rows = _rows(tmp_path / "blind.rrd")
    assert "/site/field/mean" not in rows
    assert len(_timed(rows, "/site/field/std", "DepthImage:buffer")) == 11


def test_values_that_are_missing_do_not_bend_the_mean(run: Run) -> None:
    partly = dataclasses.replace(
        run,
        confirmations=tuple(
            c.model_copy(update={"value": None}) if c.robot == "kite" else c for c in run.confirmations
        ),
    )
    only = dataclasses.replace(run, confirmations=tuple(c for c in run.confirmations if c.robot != "kite"))
    cells = grid(run)
    last, other = list(estimates(partly, cells))[-1], list(estimates(only, cells))[-1]
    assert last.mean is not None
    assert other.mean is not None
    assert np.allclose(last.mean, other.mean)
    assert last.std.sum() < other.std.sum()


def test_a_mission_that_was_only_announced_can_be_reviewed(run: Run, tmp_path: Path) -> None:
    bare = dataclasses.replace(
        run, plans=(), telemetry=dict.fromkeys(run.telemetry, ()), confirmations=(), events=(), ledgers=()
    )
    write_review(bare, tmp_path / "bare.rrd")
    assert "/site/nodes/candidate" in _rows(tmp_path / "bare.rrd")


def test_an_abstract_site_has_no_online_map(run: Run, tmp_path: Path) -> None:
    site = run.mission.site.model_copy(update={"origin": None})
    abstract = dataclasses.replace(
        run,
        mission=run.mission.model_copy(update={"site": site}),
        telemetry={r: tuple(_at_null_island(t) for t in reports) for r, reports in run.telemetry.items()},
    )
    write_review(abstract, tmp_path / "abstract.rrd")
    assert not [entity for entity in _rows(tmp_path / "abstract.rrd") if entity.startswith("/map")]


def _at_null_island(report: Telemetry) -> Telemetry:
    return report.model_copy(update={"lat_deg": report.lat_deg - 46.5102, "lon_deg": report.lon_deg - 7.8421})


def test_the_frame_of_a_single_node_has_a_size() -> None:
    mission = synthetic_plan.mission()
    site = mission.site.model_copy(update={"nodes": mission.site.nodes[:1], "edges": (), "keep_outs": ()})
    area = frame(mission.model_copy(update={"site": site}))
    assert isinstance(area, Frame)
    assert area.span_m > 0.0


def test_bad_paths_end_in_one_line(tmp_path: Path, run: Run) -> None:
    with pytest.raises(InputError, match=r"none\.mcap: no such file$"):
        review(tmp_path / "none.mcap", tmp_path / "out.rrd")
    assert not (tmp_path / "out.rrd").exists()
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match=r"out\.rrd: cannot be written"):
        write_review(run, tmp_path / "file" / "out.rrd")
