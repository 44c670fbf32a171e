"""Planning: exact plans, Seq-LIPP, the no-handoff ablation, bounds, and the verifier of all plans."""

from malipp_field.planner.progress import Progress
from malipp_field.planner.solve import solve
from malipp_field.planner.verify import Violation, check, verify

__all__ = ["Progress", "Violation", "check", "solve", "verify"]
