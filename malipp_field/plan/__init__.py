"""The plan file: what a plan says, and reading and writing it."""

from malipp_field.plan.files import parse_plan, plan_text, read_plan, read_plan_of, write_plan
from malipp_field.plan.progress import advance, rest_of, stops_done
from malipp_field.plan.schema import Bound, Objective, Plan, RobotPlan, Stop

__all__ = [
    "Bound",
    "Objective",
    "Plan",
    "RobotPlan",
    "Stop",
    "advance",
    "parse_plan",
    "plan_text",
    "read_plan",
    "read_plan_of",
    "rest_of",
    "stops_done",
    "write_plan",
]
