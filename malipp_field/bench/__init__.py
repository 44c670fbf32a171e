"""Benchmark instances in the manner of the paper, and what runs, keeps and compares plans of them."""

from malipp_field.bench.budgets import sequential_coverage, tune, tuned_mission
from malipp_field.bench.compare import Comparison, compare
from malipp_field.bench.instances import Specification, build, write_mission
from malipp_field.bench.tasks import Results, Row, Task, run_task
from malipp_field.bench.worker import Worker

__all__ = [
    "Comparison",
    "Results",
    "Row",
    "Specification",
    "Task",
    "Worker",
    "build",
    "compare",
    "run_task",
    "sequential_coverage",
    "tune",
    "tuned_mission",
    "write_mission",
]
