"""Small teams with all schedules listed, and a plain loop over the master's cuts and columns."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from random_missions import tiny_mission

from malipp_field.mission import Mission, TeamState
from malipp_field.plan import Plan
from malipp_field.planner.exact.columns import Branch, Point
from malipp_field.planner.exact.master import Master
from malipp_field.planner.exact.realise import realise
from malipp_field.planner.exact.schedules import Codes, Robot, robots_of
from malipp_field.planner.extract import TeamPlan
from malipp_field.planner.linear import Effort
from malipp_field.planner.problem import Problem, build_problem, in_units
from malipp_field.planner.progress import Progress, Search

MISSING = 1e-6
"""Shares of schedules that do not exist, from which on there is no solution."""


def search(
    *, gap: float = 1e-6, limit_s: float = 60.0, work: int | None = None, seed: int = 0,
    on_progress: Callable[[Progress], None] = lambda _: None, cancelled: Callable[[], bool] = lambda: False,
) -> Search:  # fmt: skip
    return Search(
        effort=Effort(time.monotonic() + limit_s, cancelled), gap=gap, seed=seed, work=work,
        on_progress=on_progress,
    )  # fmt: skip


def quickest(run: Callable[[], Plan], limit_s: float) -> tuple[Plan, float]:
    """Return a plan and the seconds it took; tried thrice at most: other work only ever makes it slower."""
    for _ in range(3):
        started = time.monotonic()
        plan = run()
        took_s = time.monotonic() - started
        if took_s < limit_s:
            break
    return plan, took_s


def scaled(mission: Mission, state: TeamState | None = None, **options: Any) -> tuple[Problem, float]:
    return in_units(build_problem(mission, state, **options))


def alike(seed: int, *, robots: int = 2, candidates: int = 3, **changes: Any) -> Mission:
    """Return a tiny mission whose robots are the same in everything, and long enough to be worth it."""
    record = tiny_mission(seed, robots=robots, candidates=candidates).model_dump(
        mode="json", by_alias=True, exclude_none=True
    )
    record["site"]["edges"] = []
    one = record["team"]["robots"][0] | {
        "energy_budget_j": 18.0,
        "payload_capacity": 2,
        "samples_per_node": 1,
    }
    record["team"]["robots"] = [one | {"id": f"r{r}"} | changes for r in range(robots)]
    return Mission.model_validate(record)


def listed(problem: Problem) -> list[Robot]:
    """Return the team with all schedules that no other one beats."""
    robots = robots_of(problem)
    for robot in robots:
        assert robot.list_all(np.zeros((len(robot.places), robot.width)), -1e300)
    return robots


def nothing_forbidden(robots: Sequence[Robot]) -> Branch:
    return Branch([np.zeros((len(robot.places), robot.width), dtype=np.bool_) for robot in robots])


def lowest(master: Master, branch: Branch, rounds: int = 60) -> tuple[float, Point | None]:
    """Return the master's optimum over all columns after cutting; infinite where it has no solution."""
    master.impose(branch)
    while True:
        point = master.solve()
        if point is None:
            return np.inf, None
        if _grow(master, branch, point):
            continue
        rounds -= 1
        if not rounds or not master.cut(point, 1e-7):
            return (np.inf if point.missing > MISSING else point.value), point


def _grow(master: Master, branch: Branch, point: Point) -> bool:
    added = False
    for r, robot in enumerate(master.robots):
        gain = np.where(branch.forbidden[r], -np.inf, master.gains(point.dual, r))
        least = master.least_value(point.dual, r) + 1e-9
        exact_load = r in branch.exact_load
        _, found = robot.price(gain, master.pair_gains(point.dual, r), least, exact_load=exact_load)
        for codes in found:
            added |= master.add(r, codes)
    return added


def some_teams(
    problem: Problem, robots: list[Robot], many: int, seed: int
) -> list[tuple[list[Codes], TeamPlan | None]]:
    """Return random teams of listed schedules, with their plans where one was found."""
    rng, found = np.random.default_rng(seed), []
    for _ in range(many):
        chosen = []
        for robot in robots:
            assert robot.pool is not None
            chosen.append(robot.pool.codes[int(rng.integers(len(robot.pool.codes)))])
        found.append((chosen, realise(problem, robots, chosen)))
    return found


def as_scheduled(robots: list[Robot], chosen: list[Codes], team: TeamPlan) -> bool:
    """Tell whether all drops of the schedules are made: what was never picked need not be dropped."""
    for robot, codes, route in zip(robots, chosen, team.routes, strict=True):
        dropped = {visit.node: sum(visit.drop.values()) for visit in route if visit.drop}
        exchange = robot.exchange_of[codes + robot.capacity]
        if dropped != {robot.places[w]: -int(exchange[w]) for w in np.flatnonzero(exchange < 0)}:
            return False
    return True
