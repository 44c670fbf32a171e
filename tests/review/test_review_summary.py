"""The figures of the synthetic mission, recomputed by hand."""

from __future__ import annotations

import dataclasses
import io
import math
from itertools import pairwise

import numpy as np
import pytest
import synthetic_plan
import synthetic_run
from rich.console import Console

from malipp_field.field import covariance
from malipp_field.mission import node_positions
from malipp_field.record import Run, read_run
from malipp_field.review import Summary, print_summary, summarise
from malipp_field.review.prediction import energy_used, predicted_energy
from malipp_field.review.tracks import driven_m
from malipp_field.vehicle.steps import Action

DRIVEN = {
    "lark": "base w1 w3 w4 w5 w2 w1 base",
    "kite": "camp e2 e3 e4 e5 e4 camp",
    "mule": "base w6 gate pass e1 pass e3 pass gate w6 base",
}
LOADS = {"lark": [0, 1, 2, 3, 4, 4, 4], "kite": [0, 1, 0, 1, 2, 2], "mule": [0, 1, 1, 1, 2, 2, 4, 4, 4, 4]}
"""Samples on board on each leg of `DRIVEN`."""


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    return read_run(synthetic_run.record(tmp_path_factory.mktemp("recording") / "twin-pits.mcap"))


@pytest.fixture(scope="module")
def summary(run: Run) -> Summary:
    return summarise(run)


def _legs(robot: str) -> list[float]:
    places = node_positions(synthetic_plan.mission())
    return [math.dist(places[a], places[b]) for a, b in pairwise(DRIVEN[robot].split())]


@pytest.mark.parametrize("robot", ["lark", "kite", "mule"])
def test_energy_time_and_distance_of_each_robot(summary: Summary, robot: str) -> None:
    figures = next(r for r in summary.robots if r.robot == robot)
    mass_kg = {"lark": 4.0, "kite": 4.0, "mule": 12.0}[robot]
    hungry = synthetic_run.HUNGRY if robot == "mule" else 1.0
    energy_j = sum(
        length * (mass_kg + load) * hungry for length, load in zip(_legs(robot), LOADS[robot], strict=True)
    )
    assert figures.energy_used_j == pytest.approx(energy_j, rel=1e-9)
    assert figures.distance_m == pytest.approx(sum(_legs(robot)), abs=0.5)
    first = synthetic_plan.plan(1).robot(robot)
    assert figures.energy_planned_j == pytest.approx(first.energy_j)
    assert figures.time_planned_s == first.route[-1].depart_s


def test_a_robot_that_meets_no_surprise_takes_the_time_its_last_plan_said(summary: Summary) -> None:
    taken = {r.robot: r.time_taken_s for r in summary.robots}
    assert taken["lark"] == pytest.approx(synthetic_plan.plan(2).robot("lark").route[-1].depart_s, abs=0.5)
    # mule drives 0.55 as fast as planned and serves five stops, of which the wait at e3 costs nothing
    mule_s = sum(_legs("mule")) / (1.4 * synthetic_run.SLOW) + 5 * synthetic_plan.SERVICE_S
    assert taken["mule"] == pytest.approx(mule_s, abs=1e-3)


def test_information_planned_and_achieved(summary: Summary) -> None:
    j = summary.information
    assert j.prior == 7.0  # six test points of variance 1, one of them with weight 2
    assert j.planned == pytest.approx(_by_estimator(synthetic_plan.PLANNED_SAMPLES[1]))
    assert j.last_planned == pytest.approx(_by_estimator(synthetic_plan.PLANNED_SAMPLES[2]))
    assert j.achieved == pytest.approx(_by_estimator(synthetic_plan.PLANNED_SAMPLES[2]))


def _by_estimator(samplers: dict[str, str]) -> float:
    """Return J by the textbook formula over the sampled nodes alone."""
    mission = synthetic_plan.mission()
    kernel, places = mission.field.kernel, node_positions(mission)
    v = np.array([places[node] for node in samplers])
    t = np.array([(point.x_m, point.y_m) for point in mission.field.test_points])
    noise = np.diag([mission.robot(robot).noise_variance for robot in samplers.values()])
    k_tv = covariance(kernel, t, v)
    posterior = covariance(kernel, t, t) - k_tv @ np.linalg.inv(covariance(kernel, v, v) + noise) @ k_tv.T
    return float(np.diag(posterior) @ [point.weight for point in mission.field.test_points])


def test_counts_and_replans(summary: Summary) -> None:
    assert {r.robot: (r.collected, r.delivered) for r in summary.robots} == {
        "lark": (4, 4), "kite": (4, 2), "mule": (2, 4),
    }  # fmt: skip
    assert (len(summary.samples), summary.delivered) == (10, 10)
    (replan,) = summary.replans
    assert (replan.version, replan.reason) == (2, synthetic_run.REASON)
    assert replan.time_s == pytest.approx(synthetic_plan.REPLAN_S)
    assert replan.vehicles == ("lark", "kite", "mule")


def test_the_chain_of_custody_of_a_sample_that_was_handed_over(summary: Summary) -> None:
    sample = next(s for s in summary.samples if s.node == "e2")
    assert sample.sampler == "kite"
    assert [(hand.action, hand.robot, hand.node) for hand in sample.hands] == [
        (Action.COLLECT, "kite", "e2"),
        (Action.DROP, "kite", "e3"),
        (Action.PICK, "mule", "e3"),
        (Action.UNLOAD, "mule", "base"),
    ]
    assert (sample.state, sample.holder) == ("delivered", "base")
    assert sample.delivered_s is not None
    assert sample.delivered_s > sample.taken_s > 0.0


def test_a_recording_that_ends_early_says_where_each_sample_is(run: Run) -> None:
    early = dataclasses.replace(
        run,
        complete=False,
        confirmations=tuple(c for c in run.confirmations if c.time_s < run.start_s + 90.0),
        ledgers=tuple(ledger for ledger in run.ledgers if ledger.time_s < run.start_s + 90.0),
    )
    samples = {s.node: s for s in summarise(early).samples}
    assert (samples["e2"].state, samples["e2"].holder, samples["e2"].delivered_s) == ("cached", "e3", None)
    assert (samples["w1"].state, samples["w1"].holder) == ("on_board", "lark")
    assert "e1" not in samples
    text = _printed(summarise(early))
    assert "The recording was cut off" in text
    assert "lying at e3" in text
    assert "on board lark" in text


def test_a_failed_collection_gains_nothing(run: Run) -> None:
    failed = dataclasses.replace(
        run,
        confirmations=tuple(
            c.model_copy(update={"ok": False}) if c.node == "w3" else c for c in run.confirmations
        ),
    )
    without = {node: r for node, r in synthetic_plan.PLANNED_SAMPLES[2].items() if node != "w3"}
    assert summarise(failed).information.achieved == pytest.approx(_by_estimator(without))


def test_before_any_plan_there_is_nothing_to_compare_with(run: Run) -> None:
    bare = dataclasses.replace(
        run, plans=(), telemetry=dict.fromkeys(run.telemetry, ()), confirmations=(), events=(), ledgers=()
    )
    figures = summarise(bare)
    assert figures.information.planned is None
    assert figures.information.achieved == figures.information.prior
    assert all(r.energy_used_j is None and r.energy_planned_j is None for r in figures.robots)
    assert "Replans" not in _printed(figures)


def test_a_new_plan_predicts_from_what_was_measured(run: Run) -> None:
    times, used = energy_used(run, "mule")
    first, second = predicted_energy(run, "mule")
    measured = np.interp(synthetic_plan.REPLAN_S, times, used)
    assert second[0][0] == pytest.approx(synthetic_plan.REPLAN_S)
    assert second[1][0] == pytest.approx(measured)
    assert first[1][-1] == pytest.approx(synthetic_plan.plan(1).robot("mule").energy_j)
    # it left w6 (38, 14) at 60.65 s, 0.77 m/s towards the gate (54, 30), with one sample on board
    w6_s = 4.0 + math.hypot(38.0, 14.0) / 0.77 + 4.0
    gone_m = (synthetic_plan.REPLAN_S - w6_s) * 0.77 / math.sqrt(2.0)
    committed = 13.0 * math.dist((38.0 + gone_m, 14.0 + gone_m), (92.0, 12.0))
    own = synthetic_plan.plan(2).robot("mule").energy_j
    assert second[1][-1] == pytest.approx(measured + committed + own, abs=0.5)
    assert np.all(np.diff(second[1]) >= 0.0)
    assert np.all(np.diff(second[0]) >= 0.0)


def test_standing_still_is_no_driving() -> None:
    rng = np.random.default_rng(3)
    jitter = rng.uniform(-0.06, 0.06, size=(500, 2))
    assert driven_m(jitter) == 0.0
    line = np.stack([np.linspace(0.0, 30.0, 301), np.zeros(301)], axis=1)
    assert driven_m(line) == pytest.approx(30.0, abs=0.2)
    assert driven_m(np.empty((0, 2))) == 0.0


def _printed(summary: Summary) -> str:
    out = io.StringIO()
    print_summary(summary, Console(file=out))
    return out.getvalue()


def test_the_tables_fit_a_hundred_columns_when_not_on_a_terminal(summary: Summary) -> None:
    text = _printed(summary)
    assert max(len(line) for line in text.splitlines()) <= 100
    assert "\x1b" not in text
    assert "…" not in text
    for expected in ("twin-pits", "7.000", "1.143", "4,660", "262", synthetic_run.REASON):
        assert expected in text
    assert "left at e3 by kite, 0:41" in text
    assert "fetched at e3 by mule, 3:32" in text


def test_the_tables_use_colour_and_width_of_a_terminal(summary: Summary) -> None:
    out = io.StringIO()
    print_summary(summary, Console(file=out, force_terminal=True, width=160))
    assert "\x1b" in out.getvalue()
