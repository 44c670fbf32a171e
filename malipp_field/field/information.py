"""The information objective J of the paper and its gradient, as functions of the team precision.

A plan enters J only through the precision p_v = sum_r a_v^r / sigma_r^2 that the team gains at each
candidate (`eq:precision`). J is convex and decreasing in p: the posterior covariance is the matrix-convex
map p -> (K^-1 + diag(p))^-1 wherever K is invertible, and its continuous extension elsewhere.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from malipp_field.field.kernel import FloatArray, covariance
from malipp_field.mission import Mission, locate, node_positions


@dataclass(frozen=True)
class Information:
    """Weighted posterior variance at the test points, as a function of precision at the candidates.

    Attributes
    ----------
    k_vv : array, shape (V, V)
        Prior covariance between candidates.
    k_tv : array, shape (T, V)
        Prior covariance between test points and candidates.
    k_tt : array, shape (T,)
        Prior variance at the test points.
    weights : array, shape (T,)
        W_jj.
    """

    k_vv: FloatArray
    k_tv: FloatArray
    k_tt: FloatArray
    weights: FloatArray

    @property
    def prior(self) -> float:
        """J when nothing is sampled."""
        return float(self.weights @ self.k_tt)

    def posterior(self, precision: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return C_VV, shape (V, V), and C_TV, shape (T, V), given p, shape (V,) (`eq:generic_llse2`)."""
        root = np.sqrt(precision)
        b = np.eye(root.size) + root[:, None] * self.k_vv * root
        known = np.linalg.solve(b, root[:, None] * self.k_vv)
        return self.k_vv - (self.k_vv * root) @ known, self.k_tv - (self.k_tv * root) @ known

    def value(self, precision: FloatArray) -> float:
        """Return J(p) (`eq:generic_llse2`) for p of shape (V,), p >= 0."""
        p = np.asarray(precision, dtype=np.float64)
        sampled = np.flatnonzero(p > 0.0)  # the others add nothing, and there are many of them
        root = np.sqrt(p[sampled])
        b = np.eye(root.size) + root[:, None] * self.k_vv[np.ix_(sampled, sampled)] * root[None, :]
        scaled = self.k_tv[:, sampled] * root
        gain = np.linalg.solve(b, scaled.T).T
        return float(self.weights @ (self.k_tt - np.einsum("tv,tv->t", gain, scaled)))

    def value_and_gradient(self, precision: FloatArray) -> tuple[float, FloatArray]:
        """Return J(p) and dJ/dp, shape (V,).

        With S = diag(sqrt p) and B = I + S K_VV S, the posterior cross-covariance is
        C_TV = K_TV - K_TV S B^-1 S K_VV and dJ/dp_v = -sum_j W_jj C_jv^2. B is never singular, whatever
        K_VV is, and p = 0 is no special case.
        """
        root = np.sqrt(np.maximum(np.asarray(precision, dtype=np.float64), 0.0))
        b = np.eye(root.size) + root[:, None] * self.k_vv * root[None, :]
        scaled = self.k_tv * root  # K_TV S
        gain = np.linalg.solve(b, scaled.T).T  # K_TV S B^-1
        posterior = self.k_tt - np.einsum("tv,tv->t", gain, scaled)
        cross = self.k_tv - (gain * root) @ self.k_vv
        return float(self.weights @ posterior), -(self.weights @ cross**2)


def candidate_ids(mission: Mission) -> list[str]:
    """Return the ids of the nodes that may be sampled, in the order of the mission file."""
    return [node.id for node in mission.site.nodes if node.role == "candidate"]


def information_model(mission: Mission) -> Information:
    """Return J for a mission; V follows `candidate_ids`, T the mission's test points."""
    places = node_positions(mission)
    v = np.array([places[node] for node in candidate_ids(mission)], dtype=np.float64).reshape(-1, 2)
    t = np.array([locate(point, mission.site.origin) for point in mission.field.test_points])
    kernel = mission.field.kernel
    return Information(
        k_vv=covariance(kernel, v, v),
        k_tv=covariance(kernel, t, v),
        k_tt=np.full(len(t), kernel.variance),
        weights=np.array([point.weight for point in mission.field.test_points]),
    )
