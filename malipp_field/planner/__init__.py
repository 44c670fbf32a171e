"""Planning: exact and fast plans, the paper's baselines, bounds, and the verifier of all plans."""

from malipp_field.planner.choice import method_for
from malipp_field.planner.progress import Progress
from malipp_field.planner.solve import solve
from malipp_field.planner.verifier.rules import Violation, check, verify

__all__ = ["Progress", "Violation", "check", "method_for", "solve", "verify"]
