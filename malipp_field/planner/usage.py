"""What a plan uses of what its robots have, and what is left of it without its drops; nothing is searched."""

from __future__ import annotations

from collections.abc import Collection

from malipp_field.mission import Mission, TeamState
from malipp_field.plan import Plan, RobotPlan
from malipp_field.planner.draft import COLLECTED, draft_of
from malipp_field.planner.explanation import Usage
from malipp_field.planner.extract import Verdict, plan_file, routes_of, team_plan
from malipp_field.planner.problem import build_problem


def usage(mission: Mission, plan: Plan, state: TeamState, robot_id: str) -> tuple[Usage, Usage, Usage]:
    """Return what a robot uses of its energy, its room and its sample slots."""
    robot, begin, route = mission.robot(robot_id), state.robot(robot_id), plan.robot(robot_id)
    usable_j = begin.energy_left_j * (1.0 - mission.planner.energy_reserve)
    taken = dict(begin.collected)
    sampled = {stop.node for stop in route.route if stop.collect}
    for stop in route.route:
        taken[stop.node] = taken.get(stop.node, 0) + stop.collect
    most = max((taken[node] for node in sampled), default=0)
    full = sum(taken[node] == robot.samples_per_node for node in sampled)
    return (
        Usage(robot_id, "energy", usable_j, route.energy_j),
        Usage(robot_id, "room", robot.payload_capacity, most_on_board(route, begin.on_board)),
        Usage(robot_id, "slots", robot.samples_per_node, most, full, len(sampled)),
    )


def most_on_board(route: RobotPlan, on_board: int) -> int:
    """Return the most samples on board at any moment: on a leg, or between taking and handing over."""
    load = most = on_board
    for stop in route.route:
        most = max(most, load + stop.collect - stop.unload, stop.payload)
        load = stop.payload
    return most


def drops_by_node(plan: Plan) -> dict[str, tuple[tuple[str, str, int], ...]]:
    """Return (sender, receiver, samples) of the drops of a plan, by node."""
    handed: dict[str, tuple[tuple[str, str, int], ...]] = {}
    for route in plan.robots:
        for stop in route.route:
            for receiver, count in stop.drop.items():
                handed[stop.node] = (*handed.get(stop.node, ()), (route.id, receiver, count))
    return handed


def left_out(mission: Mission, plan: Plan, state: TeamState, nodes: Collection[str]) -> Plan | None:
    """Return the plan without the samples that are handed over at ``nodes``, all else as it was.

    None where one of them was taken before the plan began: it must come home.
    """
    problem = build_problem(mission, state)
    team = team_plan(problem, routes_of(problem, plan))
    assert team is not None, "a verified plan keeps budgets and order"
    draft = draft_of(problem, team)
    closed = {problem.nodes.index(node) for node in nodes}
    for sample in [s for s in draft.samples if closed & {node for node, _ in s.hops}]:
        if sample.kind != COLLECTED:
            return None
        draft.remove(sample)
    draft.tidy()
    rest = team_plan(problem, draft.visits())
    verdict = Verdict("left-out", "feasible", None, None, 0.0, plan.seed, plan.version)
    return None if rest is None else plan_file(mission.name, problem, rest, verdict)
