"""Energy budgets tuned so that Seq-LIPP samples a given share of the candidates.

The paper keeps "baseline sampling coverage near 53-56 %". One factor scales all budgets of an instance; it is
found by bisection with Seq-LIPP itself. Where no whole number of candidates lies in that range (n = 10: 5 are
50 %, 6 are 60 %), the nearest number to 54.5 % is the target. Coverage need not rise with the budget one by
one; where the target is stepped over, the nearest coverage met is taken. Tuning is as deterministic as
Seq-LIPP is: a stage of it that runs into its time limit is not.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

from malipp_field.bench.instances import Specification, build, write_mission
from malipp_field.errors import InputError
from malipp_field.mission import Mission, read_mission
from malipp_field.plan import Plan
from malipp_field.planner import solve

FIRST_BUDGET_J = 30.0
_STRETCH = 1.5
"""Between budgets tried before the target is bracketed."""
_STEPS = 16
_NARROW = 1.002
"""A bracket as narrow as this holds no coverage of its own worth finding."""
_TIME_LIMIT_S = 600.0
"""For one Seq-LIPP plan; far above what it takes at these sizes."""


def sampled_nodes(plan: Plan) -> int:
    """Return how many candidates the team samples, by however many robots."""
    return len({stop.node for robot in plan.robots for stop in robot.route if stop.collect})


def sequential_coverage(mission: Mission) -> int:
    """Return how many candidates the Seq-LIPP plan samples: the one place where tuning meets a solver."""
    return sampled_nodes(solve(mission, method="seq", time_limit_s=_TIME_LIMIT_S))


def tune(
    specification: Specification, coverage: Callable[[Mission], int] = sequential_coverage
) -> tuple[Mission, int]:
    """Return the instance with tuned budgets, and how many candidates are sampled with them.

    Parameters
    ----------
    coverage
        Tells how many candidates are sampled in a mission.
    """
    target = specification.target
    low, high = 0.0, math.inf
    budget_j = FIRST_BUDGET_J
    nearest: tuple[Mission, int] | None = None
    for _ in range(_STEPS):
        mission = build(specification, float(f"{budget_j:.6g}"))
        sampled = coverage(mission)
        if nearest is None or abs(sampled - target) < abs(nearest[1] - target):
            nearest = mission, sampled
        if sampled == target:
            break
        low, high = (budget_j, high) if sampled < target else (low, budget_j)
        if high < low * _NARROW:
            break
        budget_j = _between(low, high)
    assert nearest is not None
    return nearest


def tuned_mission(
    specification: Specification,
    folder: Path,
    coverage: Callable[[Mission], int] = sequential_coverage,
) -> Mission:
    """Return the tuned instance from its file in ``folder``, or make it and write that file.

    A file that is not of this specification and this generator (all but the budgets is compared) is replaced.

    Raises
    ------
    InputError
        When the file cannot be written.
    """
    path = folder / f"{specification.name}.yaml"
    known = _known(path)
    if known is not None and _without_budgets(known) == _without_budgets(
        build(specification, FIRST_BUDGET_J)
    ):
        return known
    mission, _ = tune(specification, coverage)
    write_mission(mission, path)
    return mission


def _between(low: float, high: float) -> float:
    """Return the next budget to try."""
    if low == 0.0:
        return high / _STRETCH
    return low * _STRETCH if math.isinf(high) else math.sqrt(low * high)


def _known(path: Path) -> Mission | None:
    try:
        return read_mission(path)
    except InputError:
        return None


def _without_budgets(mission: Mission) -> Mission:
    robots = tuple(robot.model_copy(update={"energy_budget_j": 0.0}) for robot in mission.team.robots)
    return mission.model_copy(update={"team": mission.team.model_copy(update={"robots": robots})})
