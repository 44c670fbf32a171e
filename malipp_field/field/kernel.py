"""Covariance functions of the field and the observation model built on them."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from malipp_field.mission.schema import Kernel

FloatArray = NDArray[np.float64]


def covariance(kernel: Kernel, a_m: ArrayLike, b_m: ArrayLike) -> FloatArray:
    """Return k(a, b) for every pair of places.

    Parameters
    ----------
    kernel
        Family, length scale (m) and variance.
    a_m, b_m
        Places in local metres, shapes (A, 2) and (B, 2).

    Returns
    -------
    array, shape (A, B)
        Rasmussen and Williams, *Gaussian Processes for Machine Learning*, section 4.2.1.
    """
    a = np.asarray(a_m, dtype=np.float64).reshape(-1, 2)
    b = np.asarray(b_m, dtype=np.float64).reshape(-1, 2)
    apart_m = a[:, None, :] - b[None, :, :]
    d: FloatArray = np.hypot(apart_m[..., 0], apart_m[..., 1]) / kernel.length_scale_m
    if kernel.family == "rbf":
        shape: FloatArray = np.exp(-0.5 * d**2)
    elif kernel.family == "matern32":
        shape = (1.0 + np.sqrt(3.0) * d) * np.exp(-np.sqrt(3.0) * d)
    else:
        shape = (1.0 + np.sqrt(5.0) * d + 5.0 / 3.0 * d**2) * np.exp(-np.sqrt(5.0) * d)
    return kernel.variance * shape
