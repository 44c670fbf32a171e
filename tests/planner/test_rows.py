"""Rows over what schedules do: the same whether a schedule or the row comes first, and whoever values it."""

from __future__ import annotations

import numpy as np
import pytest
from random_missions import tiny_mission
from team_cases import listed, scaled

from malipp_field.planner.exact.rows import Own, Rows
from malipp_field.planner.exact.schedules import Codes, Robot


def team(seed: int) -> list[Robot]:
    mission = tiny_mission(seed, candidates=3, samples_per_node=2, payload_capacity=2)
    return listed(scaled(mission, None)[0])


def random_rows(rng: np.random.Generator, robot: Robot, count: int) -> list[Own]:
    """Return rows of both kinds; idle codes count nothing at single places, pairs no more than that."""
    found = []
    for _ in range(count):
        w, x = (int(place) for place in rng.choice(len(robot.places), 2, replace=False))
        single = rng.normal(size=(2, robot.width))
        single[:, robot.capacity] = 0.0
        found.append(Own({w: single[0], x: single[1]}))
        found.append(Own(paired={(w, x): -rng.random((robot.width, robot.width))}))
    return found


def some_codes(robot: Robot) -> Codes:
    assert robot.pool is not None
    return robot.pool.codes[:: max(1, len(robot.pool.codes) // 20)]


@pytest.mark.parametrize("seed", [202, 14, 60])
def test_a_schedule_counts_the_same_whether_it_or_the_row_was_first(seed: int) -> None:
    rng = np.random.default_rng(seed)
    robot = team(seed)[0]
    rows, own = Rows(robot), random_rows(rng, robot, 12)
    for row, counted in enumerate(own):
        rows.add(row, counted)
    codes = some_codes(robot)
    matrix = np.array([counted.values(robot, codes) for counted in own])
    for column, schedule in zip(matrix.T, codes, strict=True):
        terms = dict(rows.terms(schedule))
        assert [terms.get(row, 0.0) for row in range(len(own))] == pytest.approx(column)


@pytest.mark.parametrize("seed", [202, 14, 60])
def test_the_scan_values_schedules_as_the_master_does(seed: int) -> None:
    rng = np.random.default_rng(seed)
    robot = team(seed)[0]
    assert robot.pool is not None
    rows, own = Rows(robot), random_rows(rng, robot, 12)
    for row, counted in enumerate(own):
        rows.add(2 * row + 1, counted)
    gone = np.arange(0, 2 * len(own), 2)
    rows.renumber(gone)
    dual = rng.random(len(own)) * (rng.random(len(own)) < 0.7)
    expected = sum(d * counted.values(robot, robot.pool.codes) for d, counted in zip(dual, own, strict=True))
    robot.price(rows.gains(dual), rows.pair_gains(dual), -1e9, exact_load=False)
    assert robot.pool.values == pytest.approx(expected)
