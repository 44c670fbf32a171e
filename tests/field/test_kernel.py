"""Covariance functions against their closed forms, and as covariances."""

from __future__ import annotations

import math

import numpy as np
import pytest
from field_cases import FAMILIES, Family, kernels
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from malipp_field.field import covariance
from malipp_field.mission.schema import Kernel


def closed_form(family: Family, distance_m: float, length_scale_m: float) -> float:
    r = distance_m / length_scale_m
    if family == "rbf":
        return math.exp(-(r**2) / 2.0)
    if family == "matern32":
        return (1.0 + math.sqrt(3.0) * r) * math.exp(-math.sqrt(3.0) * r)
    return (1.0 + math.sqrt(5.0) * r + 5.0 * r**2 / 3.0) * math.exp(-math.sqrt(5.0) * r)


@pytest.mark.parametrize("family", FAMILIES)
@pytest.mark.parametrize("distance_m", [0.0, 0.1, 1.0, 7.5, 400.0])
def test_the_covariance_is_the_closed_form(family: Family, distance_m: float) -> None:
    kernel = Kernel(family=family, length_scale_m=2.5, variance=1.7)
    # 3-4-5: the distance is along neither axis
    there = [[0.6 * distance_m, -0.8 * distance_m]]
    assert covariance(kernel, [[0.0, 0.0]], there)[0, 0] == pytest.approx(
        1.7 * closed_form(family, distance_m, 2.5), rel=1e-12, abs=1e-300
    )


@given(kernels(), st.integers(0, 2**32 - 1), st.integers(1, 12))
def test_the_covariance_is_symmetric_positive_semidefinite(kernel: Kernel, seed: int, size: int) -> None:
    places = np.random.default_rng(seed).uniform(-30.0, 30.0, (size, 2))
    places = np.vstack([places, places[: size // 2]])
    K = covariance(kernel, places, places)
    assert_allclose(K, K.T, rtol=0.0, atol=1e-15 * kernel.variance)
    assert_allclose(np.diag(K), kernel.variance, rtol=1e-15)
    assert np.linalg.eigvalsh(K)[0] >= -1e-10 * kernel.variance * len(places)


@given(kernels(), st.floats(0.0, 50.0), st.floats(0.001, 50.0))
def test_what_is_farther_is_less_alike(kernel: Kernel, near_m: float, more_m: float) -> None:
    near, far = covariance(kernel, [[0.0, 0.0]], [[near_m, 0.0], [near_m + more_m, 0.0]])[0]
    assert 0.0 <= far <= near <= kernel.variance


def test_rows_are_the_first_places_and_columns_the_second() -> None:
    kernel = Kernel(family="rbf", length_scale_m=1.0)
    assert covariance(kernel, np.zeros((2, 2)), np.zeros((3, 2))).shape == (2, 3)
    assert covariance(kernel, np.zeros((0, 2)), np.zeros((3, 2))).shape == (0, 3)
    assert covariance(kernel, (1.0, 2.0), (1.0, 2.0)).shape == (1, 1)
