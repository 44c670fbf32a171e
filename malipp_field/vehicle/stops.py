"""The stops of a plan, in an order in which they can be carried out."""

from __future__ import annotations

import graphlib
from collections.abc import Iterator
from itertools import pairwise

from malipp_field.errors import PlanError
from malipp_field.plan import Plan, Stop

Place = tuple[str, int]
"""A stop: robot and index in its route."""
Handoff = tuple[str, str, str]
"""Node, sender and receiver."""


def all_stops(plan: Plan) -> Iterator[tuple[Place, Stop]]:
    """Yield every stop, robot by robot."""
    for robot in plan.robots:
        for index, stop in enumerate(robot.route):
            yield (robot.id, index), stop


def drops(plan: Plan) -> dict[Handoff, list[Place]]:
    """Return the stops at which the plan leaves something for each handoff."""
    found: dict[Handoff, list[Place]] = {}
    for place, stop in all_stops(plan):
        for receiver in stop.drop:
            found.setdefault((stop.node, place[0], receiver), []).append(place)
    return found


def in_order(plan: Plan) -> list[Place]:
    """Return all stops so that every drop precedes its pick; times may tie and cannot tell.

    Raises
    ------
    PlanError
        When handoffs wait for each other in a circle.
    """
    follows: dict[Place, list[Place]] = {place: [] for place, _ in all_stops(plan)}
    for robot in plan.robots:
        for before, after in pairwise(range(len(robot.route))):
            follows[robot.id, after].append((robot.id, before))
    senders = drops(plan)
    for place, stop in all_stops(plan):
        for sender in stop.pick:
            follows[place] += senders.get((stop.node, sender, place[0]), [])
    try:
        return list(graphlib.TopologicalSorter(follows).static_order())
    except graphlib.CycleError as fault:
        circle = " -> ".join(f"{robot} stop {index}" for robot, index in reversed(fault.args[1]))
        raise PlanError(f"the handoffs wait for each other in a circle: {circle}") from None
