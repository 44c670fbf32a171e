"""The posterior estimate: against a direct dense computation, against J, and as samples come in."""

from __future__ import annotations

import numpy as np
import pytest
from field_cases import information_of, kernels
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from malipp_field.field import FloatArray, Observation, covariance, posterior
from malipp_field.mission.schema import Kernel

SEEDS = st.integers(0, 2**32 - 1)


def observations(seed: int, count: int) -> list[Observation]:
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(0.0, 15.0, (2, count))
    value, noise_variance = rng.normal(size=count), rng.uniform(0.01, 1.0, count)
    return [Observation(*map(float, row)) for row in zip(x, y, value, noise_variance, strict=True)]


def dense(kernel: Kernel, taken: list[Observation], places: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Condition the joint covariance of field and measurements by its inverse."""
    x = np.array([(o.x_m, o.y_m) for o in taken])
    everywhere = np.vstack([x, places])
    joint = covariance(kernel, everywhere, everywhere)
    n = len(x)
    joint[:n, :n] += np.diag([o.noise_variance for o in taken])
    gain = joint[n:, :n] @ np.linalg.inv(joint[:n, :n])
    left = joint[n:, n:] - gain @ joint[:n, n:]
    return gain @ np.array([o.value for o in taken]), np.sqrt(np.maximum(np.diag(left), 0.0))


@given(kernels(), SEEDS, st.integers(1, 8))
def test_the_posterior_is_the_conditioned_joint_distribution(kernel: Kernel, seed: int, count: int) -> None:
    taken = observations(seed, count)
    places = np.random.default_rng(seed + 1).uniform(0.0, 15.0, (5, 2))
    mean, std = posterior(kernel, taken, places)
    expected_mean, expected_std = dense(kernel, taken, places)
    assert_allclose(mean, expected_mean, rtol=1e-6, atol=1e-8)
    assert_allclose(std**2, expected_std**2, rtol=1e-6, atol=1e-9)


@given(kernels(), SEEDS, st.integers(1, 6))
def test_every_sample_shrinks_what_is_unknown(kernel: Kernel, seed: int, count: int) -> None:
    taken = observations(seed, count)
    places = np.random.default_rng(seed + 1).uniform(0.0, 15.0, (6, 2))
    before = np.sqrt(np.full(len(places), kernel.variance))
    for known in range(count + 1):
        _, std = posterior(kernel, taken[:known], places)
        assert np.all(std <= before + 1e-7)
        before = std


@given(kernels(), SEEDS)
def test_the_weighted_variance_is_the_information_objective(kernel: Kernel, seed: int) -> None:
    taken = observations(seed, 5)
    t = np.random.default_rng(seed + 1).uniform(0.0, 15.0, (4, 2))
    v = np.array([(o.x_m, o.y_m) for o in taken])
    weights = np.array([1.0, 0.0, 2.0, 0.5])
    model = information_of(kernel, v, t, weights)
    _, std = posterior(kernel, taken, t)
    expected = model.value(np.array([1.0 / o.noise_variance for o in taken]))
    assert weights @ std**2 == pytest.approx(expected, rel=1e-7, abs=1e-9)


def test_several_samples_at_one_place_are_averaged_by_their_precision() -> None:
    kernel = Kernel(family="rbf", length_scale_m=3.0)
    apart = [Observation(1.0, 1.0, 2.0, 0.1), Observation(1.0, 1.0, 5.0, 0.2)]
    one = [Observation(1.0, 1.0, (2.0 / 0.1 + 5.0 / 0.2) / 15.0, 1.0 / 15.0)]
    places = [[0.0, 0.0], [1.0, 1.0], [4.0, -2.0]]
    for ours, theirs in zip(posterior(kernel, apart, places), posterior(kernel, one, places), strict=True):
        assert_allclose(ours, theirs, rtol=1e-10)


def test_a_precise_sample_is_believed_and_far_away_the_prior_stays() -> None:
    kernel = Kernel(family="matern52", length_scale_m=2.0, variance=4.0)
    mean, std = posterior(kernel, [Observation(0.0, 0.0, 3.0, 1e-9)], [[0.0, 0.0], [500.0, 0.0]])
    assert_allclose(mean, [3.0, 0.0], atol=1e-6)
    assert_allclose(std, [0.0, 2.0], atol=1e-3)


def test_without_samples_the_prior_is_all_there_is() -> None:
    mean, std = posterior(
        Kernel(family="rbf", length_scale_m=2.0, variance=9.0), [], [[0.0, 0.0], [1.0, 1.0]]
    )
    assert_allclose(mean, 0.0)
    assert_allclose(std, 3.0)
