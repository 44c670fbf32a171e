"""Rows of the asynchronous dead-drop timing, with big-M constants from a horizon."""

from __future__ import annotations

from malipp_field.planner.exact.milp import TeamModel
from malipp_field.planner.problem import Problem


def horizon_s(problem: Problem) -> float:
    """Return a time by which every plan worth having is over, whoever waits for whom.

    An earliest-start schedule never has all robots wait: the last of them ends after at most every drive,
    service and clearance one after the other, begun when the last robot and the last stock are ready.
    """
    ready = [robot.ready_s for robot in problem.robots] + [stock.available_s for stock in problem.stocks]
    total = max(ready)
    for r, robot in enumerate(problem.robots):
        slowest: dict[int, float] = {}
        for u, head in problem.arcs(r):
            leg_s = float(robot.closure.time_s[u, head % len(problem.nodes)])
            slowest[u] = max(slowest.get(u, 0.0), leg_s)
        visits = len(robot.places) + 1
        total += sum(slowest.values()) + visits * (problem.service_time_s + problem.clearance_s)
    return total


def add_timing(model: TeamModel, horizon: float) -> None:
    """Add eq:start_time to eq:deaddrop_sync, and eq:makespan, to a model that has none of them yet.

    Parameters
    ----------
    horizon
        Upper bound on every time, in seconds: `horizon_s`, or the makespan of a plan that is to be improved.
    """
    assert not model.timed
    model.timed = True
    problem, columns, row = model.problem, model.columns, model.linear.row
    n, beta = len(problem.nodes), problem.service_time_s
    for robot, t, x in zip(problem.robots, columns.t, columns.x, strict=True):
        # t of a stop that is not visited is left free within the horizon: it enters no other active row
        soonest = {
            v: robot.ready_s + beta
            + (0.0 if v == robot.start else float(robot.closure.time_s[robot.start, v % n]) + beta)
            for v in t
        }  # fmt: skip
        for v, column in t.items():
            earliest = soonest[v] if v == robot.start else min(soonest[robot.start], horizon)
            row([(column, 1.0)], earliest, horizon)  # eq:start_time
        for (u, v), column in x.items():  # eq:time_propagation
            leg_s = float(robot.closure.time_s[u, v % n]) + beta
            big = horizon + leg_s - soonest[robot.start]
            row([(t[v], 1.0), (t[u], -1.0), (column, -big)], lower=leg_s - big)
        for v in t:
            if v >= n:
                row([(columns.end, 1.0), (t[v], -1.0)], lower=0)  # eq:makespan
    for (r, o, v), column in columns.delta.items():  # eq:deaddrop_sync
        wait_s = beta + problem.clearance_s
        big = horizon + wait_s - problem.robots[o].ready_s
        row([(columns.t[o][v], 1.0), (columns.t[r][v], -1.0), (column, -big)], lower=wait_s - big)
    for (r, s), column in columns.fetches.items():  # eq:deaddrop_sync with a drop made before the plan began
        stock = problem.stocks[s]
        if stock.available_s > 0:
            row([(columns.t[r][stock.node], 1.0), (column, -(stock.available_s + beta))], lower=0)
