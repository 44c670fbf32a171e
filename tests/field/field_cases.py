"""Random small fields, as strategies and as plain arrays."""

from __future__ import annotations

from typing import Literal

import numpy as np
from hypothesis import strategies as st

from malipp_field.field import FloatArray, Information, covariance
from malipp_field.mission.schema import Kernel

Family = Literal["rbf", "matern32", "matern52"]
FAMILIES: tuple[Family, ...] = ("rbf", "matern32", "matern52")


def information_of(kernel: Kernel, v: FloatArray, t: FloatArray, weights: FloatArray) -> Information:
    """J for candidates ``v`` (V, 2) and test points ``t`` (T, 2), in metres."""
    return Information(
        k_vv=covariance(kernel, v, v),
        k_tv=covariance(kernel, t, v),
        k_tt=np.full(len(t), kernel.variance),
        weights=weights,
    )


@st.composite
def kernels(draw: st.DrawFn) -> Kernel:
    return Kernel(
        family=draw(st.sampled_from(FAMILIES)),
        length_scale_m=draw(st.floats(0.5, 20.0)),
        variance=draw(st.floats(0.1, 5.0)),
    )


@st.composite
def fields(draw: st.DrawFn) -> Information:
    """J of a random field; now and then two candidates lie at the same place, so that K_VV is singular."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    v = rng.uniform(0.0, 20.0, (draw(st.integers(1, 7)), 2))
    if draw(st.booleans()):
        v = np.vstack([v, v[:1]])
    t = rng.uniform(0.0, 20.0, (draw(st.integers(1, 6)), 2))
    return information_of(draw(kernels()), v, t, rng.uniform(0.0, 3.0, len(t)))


def precisions(model: Information, seed: int) -> FloatArray:
    """A random precision at every candidate; about a third of them are not sampled at all."""
    rng = np.random.default_rng(seed)
    drawn: FloatArray = rng.uniform(0.0, 50.0, len(model.k_vv)) * (rng.random(len(model.k_vv)) > 0.3)
    return drawn


def weighted_error(model: Information, A: FloatArray, precision: FloatArray) -> float:
    """The estimator form (eq:generic_llse); coefficients of nodes that are not sampled must be zero."""
    sampled = precision > 0
    noise = np.divide(1.0, precision, where=sampled, out=np.zeros_like(precision))
    quadratic = np.einsum("tu,uv,tv->t", A, model.k_vv, A) + (A**2) @ noise
    linear = np.sum(model.k_tv * A, axis=1)
    return float(model.weights @ (quadratic - 2.0 * linear + model.k_tt))
