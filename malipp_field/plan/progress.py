"""A plan that goes well until some moment: where the team stands then, and what is left of the plan."""

from __future__ import annotations

from malipp_field.mission import Cache, Mission, RobotState, TeamState, initial_state
from malipp_field.plan.schema import Plan, RobotPlan, Stop


def stops_done(plan: Plan, time_s: float) -> dict[str, int]:
    """Return how many stops each robot has finished by mission time ``time_s``; never its terminal."""
    return {robot.id: sum(stop.depart_s <= time_s for stop in robot.route[:-1]) for robot in plan.robots}


def advance(mission: Mission, plan: Plan, time_s: float, begin: TeamState | None = None) -> TeamState:
    """Return where the team stands when a plan has gone well until mission time ``time_s``.

    A robot that has not finished at a stop by then drives there (if it is not there yet), and its free part
    begins with what it is to do at that stop.

    Parameters
    ----------
    begin
        The state the plan begins with; the beginning of the mission where it is None.
    """
    begin, done = begin or initial_state(mission), stops_done(plan, time_s)
    robots = tuple(
        _robot(begin.robot(robot.id), plan.robot(robot.id).route, done[robot.id]) for robot in begin.robots
    )
    dropped = tuple(
        Cache(
            node=stop.node, sender=robot.id, count=count,
            available_s=stop.depart_s + mission.team.clearance_s,
        )
        for robot in plan.robots
        for stop in robot.route[: done[robot.id]]
        for receiver, count in stop.drop.items()
        if all(picked.node != stop.node for picked in plan.robot(receiver).route[: done[receiver]])
    )  # fmt: skip
    return TeamState(time_s=time_s, robots=robots, caches=(*_left(begin, plan, done), *dropped))


def rest_of(plan: Plan, time_s: float) -> Plan:
    """Return the stops from the state `advance` gives on: how the team would go on. Objectives are of old."""
    done = stops_done(plan, time_s)
    none = {"path": None, "arrive_s": None, "leg_energy_j": None}
    robots = tuple(
        RobotPlan(id=robot.id, route=(stops[0].model_copy(update=none), *stops[1:]))
        for robot in plan.robots
        if (stops := robot.route[done[robot.id] :])
    )
    return plan.model_copy(update={"robots": robots})


def _robot(begin: RobotState, route: tuple[Stop, ...], done: int) -> RobotState:
    before, now = route[:done], route[done]
    spent_j = sum(stop.leg_energy_j or 0.0 for stop in route[: done + 1])
    collected = dict(begin.collected)
    for stop in before:
        if stop.collect:
            collected[stop.node] = collected.get(stop.node, 0) + stop.collect
    return RobotState(
        id=begin.id,
        node=now.node,
        ready_s=now.arrive_s if now.arrive_s is not None else begin.ready_s,
        energy_left_j=max(0.0, begin.energy_left_j - spent_j),
        on_board=before[-1].payload if before else begin.on_board,
        collected=collected,
    )


def _left(begin: TeamState, plan: Plan, done: dict[str, int]) -> tuple[Cache, ...]:
    """Return what still lies there of what lay there when the plan began."""
    fetched: dict[tuple[str, str], int] = {}
    for robot in plan.robots:
        for stop in robot.route[: done[robot.id]]:
            for sender, count in stop.pick.items():
                dropped = sum(
                    s.drop.get(robot.id, 0) for s in plan.robot(sender).route if s.node == stop.node
                )
                fetched[stop.node, sender] = fetched.get((stop.node, sender), 0) + count - dropped
    caches = []
    for cache in begin.caches:
        gone = min(cache.count, fetched.get((cache.node, cache.sender), 0))
        fetched[cache.node, cache.sender] = fetched.get((cache.node, cache.sender), 0) - gone
        if cache.count > gone:
            caches.append(cache.model_copy(update={"count": cache.count - gone}))
    return tuple(caches)
