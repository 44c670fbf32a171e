"""Why there can be no plan, in words a person can act on; found before any model is built."""

from __future__ import annotations

import numpy as np

from malipp_field.planner.problem import Problem, RobotView, Stock, within


def obstacle(problem: Problem, depots: dict[str, tuple[int, ...]]) -> str | None:
    """Return what makes every plan impossible, or None where nothing simple does.

    Parameters
    ----------
    depots
        D_r of every robot by its id, reachable or not.
    """
    for robot in problem.robots:
        found = _cannot_end(problem, robot, depots[robot.id]) or _cannot_carry(robot)
        if found:
            return f"{robot.id}: {found}"
    for stock in problem.stocks:
        found = _cannot_fetch(problem, stock)
        if found:
            return f"samples of {stock.sender} at {problem.nodes[stock.node]}: {found}"
    return None


def _cannot_end(problem: Problem, robot: RobotView, depots: tuple[int, ...]) -> str | None:
    """Tell what keeps a robot from driving, empty if it may hand over, from its start to a depot."""
    start, names = problem.nodes[robot.start], " or ".join(problem.nodes[d] for d in depots)
    cheapest = float(robot.closure.energy_per_kg[robot.start, list(depots)].min())
    if not np.isfinite(cheapest):
        return f"there is no way from {start} to {names} that it may drive"
    load = 0 if problem.handoffs and robot.start not in robot.depots else robot.on_board
    load = 0 if robot.start in robot.depots else load
    needed = cheapest * (robot.empty_mass_kg + load * problem.sample_mass_kg)
    if within(needed, robot.budget_j):
        return None
    loaded = f" with {load} samples on board" if load else ""
    return (
        f"the cheapest way from {start} to a depot ({names}){loaded} needs {needed:.1f} J, "
        f"{needed - robot.budget_j:.1f} J more than there is: its budget is {robot.budget_j:.1f} J"
    )


def _cannot_carry(robot: RobotView) -> str | None:
    if robot.on_board > robot.capacity and robot.start not in robot.depots:
        return f"it has {robot.on_board} samples on board and room for {robot.capacity}"
    return None


def _cannot_fetch(problem: Problem, stock: Stock) -> str | None:
    """Tell what keeps the team from bringing home a single sample of a stock."""
    v, reachable, room = stock.node, False, 0
    nearest: tuple[float, str] | None = None
    for robot in problem.robots:
        cost = robot.closure.energy_per_kg
        there = float(cost[robot.start, v])
        home = float(cost[v, list(robot.depots)].min()) if robot.depots else float("inf")
        empty = robot.empty_mass_kg
        load = 0.0 if problem.handoffs else problem.sample_mass_kg
        needed = there * empty + home * (empty + load)
        if not np.isfinite(needed):
            continue
        reachable = True
        if within(needed, robot.budget_j):
            room += robot.capacity
        short = needed - robot.budget_j
        if nearest is None or short < nearest[0]:
            nearest = (
                short,
                f"{robot.id} needs {needed:.1f} J to fetch one, {short:.1f} J more than there is: "
                f"its budget is {robot.budget_j:.1f} J",
            )
    if not reachable:
        return "no robot can drive there and on to one of its depots"
    if room == 0 and nearest is not None:
        return (
            f"no robot can fetch them: {nearest[1]}"
            if nearest[0] > 0
            else "no robot that can has any capacity"
        )
    if room < stock.count:
        return (
            f"{stock.count} lie there, robots that can fetch them carry {room} at most, and stop there once"
        )
    return None
