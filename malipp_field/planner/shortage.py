"""What is missing where a mission is proven to have no plan: the smallest change that would give it one.

Obstacles that concern one robot or one drop alone are found by `malipp_field.planner.feasibility`. What is
left shows only in the team: every sample could be fetched, but not all of them. Here the same arc model is
solved once more with budgets and capacities that may be exceeded, and what exceeds them is made least:

    min  sum_r e_r / B_r + k_r / K_r,   energy of r (eq:energy_budget) <= B_r + e_r,
                                        load of r (eq:payload, eq:cap_feasibility) <= K_r + k_r.

Nobody samples in it: what must come home (on board, or in drops) is all that can stand in the way.
"""

from __future__ import annotations

import math
import time
from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np

from malipp_field.field import FloatArray
from malipp_field.mission import Mission, TeamState, initial_state
from malipp_field.planner.exact.milp import TeamModel
from malipp_field.planner.exact.timing import add_timing, horizon_s
from malipp_field.planner.extract import Route, leg_energies, read_routes, team_plan
from malipp_field.planner.linear import Outcome
from malipp_field.planner.problem import Problem, RobotView, build_problem, prune
from malipp_field.planner.progress import Search

_LEAST_S = 0.5
"""Seconds for the question even where the proof has used up the time limit."""
_TIDINESS = 1e-5
"""Weight of the team's energy, as a share of all budgets: among equals no detours."""
_ROUNDING_J = 1e-6
"""Excess, as a share of a budget, that is the solver's rounding and not a shortage."""
_NO_ROUTES = "no set of routes brings every robot and every sample home within budgets and capacities"


@dataclass(frozen=True)
class Shortage:
    """What one robot lacks, and what it would do with it.

    Attributes
    ----------
    energy_j, room
        Joules and samples beyond its budget and its capacity.
    errand
        What it brings home, in words.
    """

    robot: RobotView
    energy_j: float
    room: int
    errand: str

    def __str__(self) -> str:
        needs, has = [], []
        if self.energy_j > 0.0:
            # rounded up: what is told is enough
            needs.append(f"{math.ceil(10.0 * self.energy_j) / 10.0:.1f} J more")
            has.append(f"its budget is {self.robot.budget_j:.1f} J")
        if self.room:
            needs.append(f"room for {_samples(self.room)} more")
            has.append(f"it can carry {self.robot.capacity}")
        return f"{self.robot.id} needs {' and '.join(needs)} ({', '.join(has)}) to bring home {self.errand}"


def shortage(
    mission: Mission,
    state: TeamState | None,
    search: Search,
    *,
    handoffs: bool = True,
    closed: Collection[str] = (),
) -> str:
    """Return in one line which robots lack how much, for a mission that is proven to have no plan.

    Parameters
    ----------
    state
        Where the team stands; the beginning of the mission where it is None.
    search
        Its effort limits the question (half a second it may always take); the seed is HiGHS's.
    handoffs, closed
        As for `malipp_field.planner.problem.build_problem`.
    """
    state = state or initial_state(mission)
    problem = build_problem(mission, state, handoffs=handoffs, closed=closed)
    generous = build_problem(*_generous(mission, state, problem), handoffs=handoffs, closed=closed)
    model, room = _elastic(problem, _errands_only(generous), search)
    outcome = _settle(model, search)
    if outcome.status == "infeasible":
        return (
            f"{_NO_ROUTES}, and no more energy or room would help: the ways or the order of drops forbid it"
        )
    if outcome.point is None:
        return f"{_NO_ROUTES} (proven; how much is missing was not found in time)"
    lacking = _lacking(problem, model, room, outcome.point)
    words = "the least that would do" if outcome.status == "optimal" else "this would do, perhaps less"
    return f"{_NO_ROUTES}; {words}: {'; '.join(map(str, lacking))}" if lacking else _NO_ROUTES


def _generous(mission: Mission, state: TeamState, problem: Problem) -> tuple[Mission, TeamState]:
    """Return a mission and state in which energy and room can stand in nobody's way."""
    must = sum(robot.on_board for robot in problem.robots) + sum(stock.count for stock in problem.stocks)
    energy = {robot.id: _enough_j(problem, robot, must) for robot in problem.robots}
    share = 1.0 - mission.planner.energy_reserve
    robots = tuple(
        robot.model_copy(update={"payload_capacity": max(robot.payload_capacity, must)})
        for robot in mission.team.robots
    )
    richer = tuple(
        robot.model_copy(update={"energy_left_j": max(robot.energy_left_j, energy[robot.id] / share)})
        for robot in state.robots
    )
    team = mission.team.model_copy(update={"robots": robots})
    return mission.model_copy(update={"team": team}), state.model_copy(update={"robots": richer})


def _enough_j(problem: Problem, robot: RobotView, must: int) -> float:
    """Return the energy of the dearest route there is: every place once, each left by its dearest leg."""
    cost = robot.closure.energy_per_kg
    dearest = np.where(np.isfinite(cost), cost, 0.0).max(axis=1)
    return float(dearest.sum()) * (robot.empty_mass_kg + must * problem.sample_mass_kg)


def _errands_only(problem: Problem) -> Problem:
    robots = tuple(replace(robot, limits=np.zeros_like(robot.limits)) for robot in problem.robots)
    return prune(replace(problem, robots=robots))


def _elastic(problem: Problem, generous: Problem, search: Search) -> tuple[TeamModel, list[int]]:
    """Return the generous model that minimises what it uses beyond ``problem``, and the columns k_r."""
    model = TeamModel(generous, precision=problem.gained, seed=search.seed)
    total_j = max(sum(robot.budget_j for robot in problem.robots), 1.0)
    costs = [(column, _TIDINESS * value / total_j) for column, value in model.energy_terms()]
    room = []
    for r, robot in enumerate(problem.robots):
        ample = generous.robots[r]
        more_j = _energy_row(model, r, robot.budget_j / max(ample.budget_j, 1e-9))
        room.append(model.linear.column(0, max(0, ample.capacity - robot.capacity), integer=True))
        _load_rows(model, r, robot.capacity, room[r])
        reference_j = robot.budget_j or total_j / len(problem.robots)
        costs += [(more_j, ample.budget_j / reference_j), (room[r], 1.0 / max(robot.capacity, 1))]
    model.linear.objective(costs)
    return model, room


def _energy_row(model: TeamModel, r: int, share: float) -> int:
    """Add eq:energy_budget with a slack; return its column e_r, a share of the generous budget."""
    more = model.linear.column(0, 1)
    n = len(model.problem.nodes)
    arrived = [(column, 1.0) for (_, head), column in model.columns.spent[r].items() if head >= n]
    model.linear.row([*arrived, (more, -1.0)], upper=share)
    return more


def _load_rows(model: TeamModel, r: int, capacity: int, more: int) -> None:
    """Add eq:payload and, where the robot starts loaded, eq:cap_feasibility with the slack k_r."""
    for column in model.columns.load[r].values():
        model.linear.row([(column, 1.0), (more, -1.0)], upper=capacity)
    robot, unloads = model.problem.robots[r], model.columns.g[r]
    unloaded = [(unloads[robot.start], -1.0)] if robot.start in unloads else []
    model.linear.row([*unloaded, (more, -1.0)], upper=capacity - robot.on_board)


def _settle(model: TeamModel, search: Search) -> Outcome:
    """Solve; where drops wait for each other in a circle, once more with timing."""
    effort = replace(search.effort, deadline=max(search.effort.deadline, time.monotonic() + _LEAST_S))
    outcome = model.linear.solve(effort, gap=1e-6)
    if outcome.point is not None and team_plan(model.problem, read_routes(model, outcome.point)) is None:
        add_timing(model, horizon_s(model.problem))
        outcome = model.linear.solve(effort, gap=1e-6)
    return outcome


def _lacking(problem: Problem, model: TeamModel, room: list[int], point: FloatArray) -> list[Shortage]:
    """Return what the routes at a point use beyond what the robots of ``problem`` have."""
    found = []
    for r, (robot, route) in enumerate(zip(problem.robots, read_routes(model, point), strict=True)):
        spent_j = sum(leg_energies(model.problem, robot, route))
        more_j = max(0.0, spent_j - robot.budget_j - _ROUNDING_J * max(robot.budget_j, 1.0))
        more_room = round(float(point[room[r]]))
        if more_j or more_room:
            found.append(Shortage(robot, more_j, more_room, _errand(problem, robot, route)))
    return found


def _errand(problem: Problem, robot: RobotView, route: Route) -> str:
    """Return what a robot brings home, or on its way, on a route."""
    parts = [f"the {_samples(robot.on_board)} it has on board"] if robot.on_board else []
    for visit in route:
        where = problem.nodes[visit.node]
        for s, count in visit.fetch.items():
            parts.append(f"the {_samples(count)} of {problem.stocks[s].sender} lying at {where}")
        for o, count in visit.pick.items():
            parts.append(f"the {_samples(count)} that {problem.robots[o].id} drops for it at {where}")
    return " and ".join(parts) or "itself"


def _samples(count: int) -> str:
    return "1 sample" if count == 1 else f"{count} samples"
