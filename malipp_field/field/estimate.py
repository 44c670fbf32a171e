"""The field as it is known after some samples: posterior mean and standard deviation anywhere."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from malipp_field.field.kernel import FloatArray, covariance
from malipp_field.mission.schema import Kernel


@dataclass(frozen=True)
class Observation:
    """One measured sample: place (m), value, and noise variance of the sensor that took it."""

    x_m: float
    y_m: float
    value: float
    noise_variance: float


def posterior(
    kernel: Kernel, observations: Sequence[Observation], places_m: ArrayLike
) -> tuple[FloatArray, FloatArray]:
    """Return the zero-mean GP posterior mean and standard deviation at ``places_m``.

    Parameters
    ----------
    kernel
        The field's covariance function.
    observations
        Samples so far; several at one place are averaged by their precision.
    places_m
        Shape (P, 2), local metres.

    Returns
    -------
    mean, std : arrays, shape (P,)
        Rasmussen and Williams, equations 2.23 and 2.24.
    """
    places = np.asarray(places_m, dtype=np.float64).reshape(-1, 2)
    prior = np.full(len(places), kernel.variance)
    if not observations:
        return np.zeros(len(places)), np.sqrt(prior)
    x = np.array([(o.x_m, o.y_m) for o in observations])
    noise = np.diag([o.noise_variance for o in observations])
    cross = covariance(kernel, places, x)
    gain = np.linalg.solve(covariance(kernel, x, x) + noise, cross.T).T
    mean = gain @ np.array([o.value for o in observations])
    variance = prior - np.einsum("pv,pv->p", cross, gain)
    return mean, np.sqrt(np.maximum(variance, 0.0))
