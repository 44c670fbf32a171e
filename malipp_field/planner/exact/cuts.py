"""Linear bounds on the information objective that are tight at every sampling plan.

A tangent of J in the precision p is weak away from its point: the first sample of a precise sensor moves p
far along a curve that flattens at once. Part of the prior covariance is therefore moved into the noise: for
any diagonal 0 <= D <= K_VV,

    K_VV + P^-1 = (K_VV - D) + (P^-1 + D),

so J is the same function of (K_VV - D, q) as of (K_VV, p), with q_v = p_v / (1 + d_v p_v). It is convex in q
for the same reason as in p (parallel sums of positive matrices are concave), and since q_v takes one known
value for each precision level, q is linear in the selectors z of `eq:precision_select`. Tangents in q are
exact where they touch and much steeper elsewhere; D = 0 gives those of the paper's p.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from malipp_field.field import FloatArray, Information

_SLACK = 1e-9
"""Share of the largest prior variance that keeps K_VV - D positive semidefinite in spite of rounding."""
_BARRIERS = (1e-1, 1e-2, 1e-3, 1e-4)
_MAX_GROUPS = 16


@dataclass(frozen=True)
class Group:
    """J restricted to some test points, as a function of its own scaled precision q.

    Attributes
    ----------
    information : Information
        The field with K_VV - D.
    share : array, shape (V,)
        The diagonal of D.
    """

    information: Information
    share: FloatArray

    def scaled(self, precision: FloatArray) -> FloatArray:
        """Return q(p), shape (V,)."""
        return precision / (1.0 + self.share * precision)


def split_information(
    information: Information, free: NDArray[np.bool_], precision: float
) -> tuple[Group, ...]:
    """Return J as a sum over groups of test points, each with the D that suits it.

    Parameters
    ----------
    free : array, shape (V,)
        Where D may differ from zero: the candidates whose precision levels have selectors.
    precision
        That of one good sample, 1 / sigma^2: D is chosen to shorten the first step from it.
    """
    groups = []
    for tests in _groups(information):
        k_tv, weights = information.k_tv[tests], information.weights[tests]
        share = diagonal_share(information.k_vv, weights @ k_tv**2, free, precision)
        rest = information.k_vv - np.diag(share)
        groups.append(Group(Information(rest, k_tv, information.k_tt[tests], weights), share))
    return tuple(groups)


def diagonal_share(
    k_vv: FloatArray, weights: FloatArray, free: NDArray[np.bool_], precision: float
) -> FloatArray:
    """Return the diagonal D, 0 <= D <= K_VV, that minimises sum_v w_v p / (1 + d_v p).

    A damped Newton method on the logarithmic barrier of both constraints; entries that are not ``free`` stay
    zero. Zero altogether where K_VV is singular up to rounding: every such D is valid, only less sharp.
    """
    share = np.zeros(len(k_vv))
    base = k_vv - _SLACK * float(np.diag(k_vv).max(initial=0.0)) * np.eye(len(k_vv))
    index = np.flatnonzero(free)
    if index.size == 0 or np.linalg.eigvalsh(base)[0] <= 0.0:
        return share
    share[index] = 0.5 * np.linalg.eigvalsh(base)[0]
    w = weights[index] / max(float(weights.max()), 1e-300) + 1e-3
    for mu in _BARRIERS:
        for _ in range(12):
            d = share[index]
            inverse = np.linalg.inv(base - np.diag(share))[np.ix_(index, index)]
            step_scale = precision / (1.0 + d * precision)
            gradient = w * step_scale**2 / precision - mu * np.diag(inverse) + mu / d
            curvature = 2.0 * w * step_scale**3 / precision + mu / d**2
            step = np.linalg.solve(mu * inverse**2 + np.diag(curvature), gradient)
            length = _step_length(base, share, index, step)
            share[index] += length * step
            if float(gradient @ step) < 1e-6:
                break
    return share


def _step_length(base: FloatArray, share: FloatArray, index: NDArray[np.int64], step: FloatArray) -> float:
    """Return the longest of 1, 1/2, 1/4 ... that stays inside both constraints with some room."""
    length = 1.0
    while length > 1e-9:
        moved = share.copy()
        moved[index] += length * step
        if moved[index].min() > 0.0 and np.linalg.eigvalsh(base - np.diag(moved))[0] > 0.0:
            return length if length == 1.0 else 0.9 * length
        length *= 0.5
    return 0.0


def _groups(information: Information) -> list[NDArray[np.int64]]:
    """Return test points grouped by the candidate that tells most about them."""
    tests = np.arange(len(information.k_tt))
    if information.k_tv.shape[1] == 0:
        return [tests]
    nearest = np.argmax(np.abs(information.k_tv), axis=1)
    found = [np.flatnonzero(nearest == v) for v in np.unique(nearest)]
    while len(found) > _MAX_GROUPS:
        found.sort(key=len)
        found = [np.sort(np.concatenate(found[:2])), *found[2:]]
    return found
