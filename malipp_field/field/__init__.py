"""The Gaussian-process field: covariance, the information objective J, and the estimate from samples."""

from malipp_field.field.estimate import Observation, posterior
from malipp_field.field.information import Information, candidate_ids, information_model
from malipp_field.field.kernel import FloatArray, covariance

__all__ = [
    "FloatArray",
    "Information",
    "Observation",
    "candidate_ids",
    "covariance",
    "information_model",
    "posterior",
]
