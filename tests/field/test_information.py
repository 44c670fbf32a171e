"""J and its gradient: finite differences, the estimator form, convexity, and the awkward cases."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
from field_cases import fields, information_of, precisions, weighted_error
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from malipp_field.field import Information, candidate_ids, information_model
from malipp_field.mission import parse_mission
from malipp_field.mission.schema import Kernel

SEEDS = st.integers(0, 2**32 - 1)


def scale(model: Information) -> float:
    """What rounding errors of J are in proportion to."""
    return max(model.prior, 1e-3)


@given(fields(), SEEDS)
def test_the_gradient_is_that_of_finite_differences(model: Information, seed: int) -> None:
    p = precisions(model, seed) + 1.0
    _, gradient = model.value_and_gradient(p)
    step = 1e-4
    for v in range(len(p)):
        shift = np.eye(len(p))[v] * step
        difference = (model.value(p + shift) - model.value(p - shift)) / (2.0 * step)
        assert difference == pytest.approx(gradient[v], rel=1e-4, abs=1e-7 * scale(model))


@given(fields())
def test_the_gradient_at_zero_is_that_of_one_sided_differences(model: Information) -> None:
    nothing = np.zeros(len(model.k_vv))
    value, gradient = model.value_and_gradient(nothing)
    assert value == pytest.approx(model.prior)
    assert_allclose(gradient, -(model.weights @ model.k_tv**2), rtol=1e-12, atol=1e-15)
    step = 1e-7
    for v in range(len(nothing)):
        difference = (model.value(np.eye(len(nothing))[v] * step) - value) / step
        assert difference == pytest.approx(gradient[v], rel=1e-4, abs=1e-7 * scale(model))


@given(fields(), SEEDS)
def test_the_value_is_the_smallest_error_of_any_estimator(model: Information, seed: int) -> None:
    p = precisions(model, seed)
    sampled = np.flatnonzero(p)
    # the normal equations of min over A of eq:generic_llse, over the nodes sampled
    A = np.zeros_like(model.k_tv)
    if len(sampled):
        normal = model.k_vv[np.ix_(sampled, sampled)] + np.diag(1.0 / p[sampled])
        A[:, sampled] = np.linalg.lstsq(normal, model.k_tv[:, sampled].T, rcond=None)[0].T
    assert model.value(p) == pytest.approx(weighted_error(model, A, p), abs=1e-9 * scale(model))
    rng = np.random.default_rng(seed)
    for size in (1e-3, 1e-1, 10.0):
        other = A.copy()
        other[:, sampled] += size * rng.normal(size=(len(A), len(sampled)))
        assert weighted_error(model, other, p) >= model.value(p) - 1e-9 * scale(model)


@given(fields(), SEEDS, SEEDS, st.floats(0.0, 1.0))
def test_the_value_is_convex(model: Information, seed: int, other: int, share: float) -> None:
    p, q = precisions(model, seed), precisions(model, other)
    chord = share * model.value(p) + (1.0 - share) * model.value(q)
    assert model.value(share * p + (1.0 - share) * q) <= chord + 1e-10 * scale(model)


@given(fields(), SEEDS, SEEDS)
def test_a_tangent_never_exceeds_the_value(model: Information, seed: int, other: int) -> None:
    p, q = precisions(model, seed), precisions(model, other)
    value, gradient = model.value_and_gradient(q)
    assert value + gradient @ (p - q) <= model.value(p) + 1e-9 * scale(model)


@given(fields(), SEEDS, SEEDS)
def test_more_precision_never_raises_the_value(model: Information, seed: int, other: int) -> None:
    p = precisions(model, seed)
    value, gradient = model.value_and_gradient(p)
    assert np.all(gradient <= 0.0)
    assert model.value(p + precisions(model, other)) <= value + 1e-10 * scale(model)
    assert -1e-10 * scale(model) <= value <= model.prior + 1e-10 * scale(model)


def test_precision_at_two_candidates_of_one_place_adds_up() -> None:
    kernel = Kernel(family="rbf", length_scale_m=3.0, variance=1.5)
    v = np.array([[0.0, 0.0], [4.0, 1.0], [4.0, 1.0]])
    model = information_of(kernel, v, np.array([[2.0, 2.0], [5.0, 0.0]]), np.array([1.0, 2.0]))
    assert np.linalg.matrix_rank(model.k_vv) == 2
    apart, gradient = model.value_and_gradient(np.array([2.0, 3.0, 4.0]))
    assert apart == pytest.approx(model.value(np.array([2.0, 7.0, 0.0])), rel=1e-12)
    assert gradient[1] == pytest.approx(gradient[2], rel=1e-12)


def test_a_field_known_exactly_where_it_counts_has_no_error_left() -> None:
    kernel = Kernel(family="matern52", length_scale_m=3.0, variance=2.0)
    places = np.array([[0.0, 0.0], [9.0, 0.0]])
    model = information_of(kernel, places, places, np.array([1.0, 1.0]))
    assert model.value(np.full(2, 1e9)) == pytest.approx(0.0, abs=1e-8)


def test_one_sample_leaves_the_variance_of_a_textbook() -> None:
    kernel = Kernel(family="rbf", length_scale_m=2.0, variance=3.0)
    model = information_of(kernel, np.zeros((1, 2)), np.array([[2.0, 0.0]]), np.array([2.0]))
    covered = 3.0 * np.exp(-0.5)
    assert model.value(np.array([1.0 / 0.5])) == pytest.approx(
        2.0 * (3.0 - covered**2 / (3.0 + 0.5)), rel=1e-12
    )


def site(*nodes: dict[str, Any]) -> str:
    solo = {
        "id": "solo", "start": "base", "depots": ["base"], "empty_mass_kg": 1.0, "energy_budget_j": 1.0,
        "payload_capacity": 1, "samples_per_node": 1, "noise_variance": 0.1, "energy_per_kg_m": 1.0,
        "speed_m_s": 1.0,
    }  # fmt: skip
    return json.dumps(
        {
            "format": "malipp-mission/1",
            "name": "small",
            "site": {"nodes": list(nodes), "complete": True},
            "field": {
                "kernel": {"family": "matern32", "length_scale_m": 5.0, "variance": 0.5},
                "test_points": [{"x_m": 1.0, "y_m": 1.0, "weight": 3.0}, {"x_m": 8.0, "y_m": 0.0}],
            },
            "team": {"sample_mass_kg": 1.0, "robots": [solo]},
        }
    )


def test_a_mission_gives_its_candidates_and_weighted_test_points() -> None:
    mission = parse_mission(
        site(
            {"id": "base", "x_m": 0.0, "y_m": 0.0, "role": "depot"},
            {"id": "far", "x_m": 6.0, "y_m": 0.0},
            {"id": "gate", "x_m": 3.0, "y_m": 0.0, "role": "via"},
            {"id": "near", "x_m": 2.0, "y_m": 1.0},
        )
    )
    model = information_model(mission)
    assert candidate_ids(mission) == ["far", "near"]
    assert model.prior == pytest.approx(0.5 * 4.0)
    assert model.k_vv.shape == (2, 2)
    scaled = np.sqrt(3.0) * 1.0 / 5.0  # the first test point is 1 m from near
    assert model.k_tv[0, 1] == pytest.approx(0.5 * (1.0 + scaled) * np.exp(-scaled), rel=1e-12)
    assert_allclose(model.weights, [3.0, 1.0])


def test_a_site_without_candidates_can_only_keep_the_prior() -> None:
    mission = parse_mission(
        site(
            {"id": "base", "x_m": 0.0, "y_m": 0.0, "role": "depot"},
            {"id": "gate", "x_m": 1.0, "y_m": 0.0, "role": "via"},
        )
    )
    model = information_model(mission)
    assert model.value(np.zeros(0)) == pytest.approx(model.prior)
