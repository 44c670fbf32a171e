"""The plan file: what a plan says, and reading and writing it."""

from malipp_field.plan.files import parse_plan, plan_text, read_plan, write_plan
from malipp_field.plan.schema import Bound, Objective, Plan, RobotPlan, Stop

__all__ = [
    "Bound",
    "Objective",
    "Plan",
    "RobotPlan",
    "Stop",
    "parse_plan",
    "plan_text",
    "read_plan",
    "write_plan",
]
