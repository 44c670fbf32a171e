"""What must hold of exact plans whatever the mission: what relaxes, what changes nothing, what bounds.

The exact planner runs with a relative gap of `_GAP`, so J is known to within that, and energy and makespan
to within rounding.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest
import weightless
from hypothesis import given, settings
from hypothesis import strategies as st
from missions_strategy import (
    Case,
    cases,
    changed,
    missions,
    posterior,
    robot_records,
    samples_of,
)

from malipp_field.mission import Mission, TeamState, initial_state
from malipp_field.mission.schema import Method
from malipp_field.plan import Plan, advance, stops_done
from malipp_field.planner import Progress, solve, verify
from malipp_field.planner.bounds.relaxation import relaxation_bound

_GAP = 1e-6
_MARGIN = 1.0 + 4 * _GAP
"""J of two plans proven to the gap, one of which should not be above the other."""
_LIMIT_S = 200.0
"""Generous: an example that ends unproven is a failure."""


def few(examples: int) -> settings:
    """Return settings under which every run tries the same examples."""
    return settings(max_examples=examples, derandomize=True, deadline=None, database=None)


def planned(
    case: Case, method: Method = "exact", on_progress: Callable[[Progress], None] | None = None
) -> Plan:
    """Return a plan proven to the end, and verified, or a proof that there is none."""
    plan = solve(
        case.mission, state=case.state, method=method, handoffs=case.handoffs,
        mip_gap=_GAP, time_limit_s=_LIMIT_S, on_progress=on_progress,
    )  # fmt: skip
    assert plan.status in {"optimal", "infeasible"}
    assert_kept(case, plan)
    return plan


_found: dict[str, Plan] = {}


def once(case: Case) -> Plan:
    """Return `planned`, made but once: the properties below are tried on the same missions."""
    key = "\n".join([case.mission.model_dump_json(), repr(case.state), str(case.handoffs)])
    if key not in _found:
        _found[key] = planned(case)
    return _found[key]


def assert_kept(case: Case, plan: Plan) -> None:
    """Check that the plan keeps every rule, or says why there is none."""
    if plan.robots:
        assert not verify(case.mission, plan, case.state)
    else:
        assert plan.reason


def information(plan: Plan) -> float:
    return math.inf if plan.objective is None else plan.objective.information


def figures(plan: Plan, *, energy: float = 1.0, variance: float = 1.0) -> Any:
    """Return status and objective in other units, to be compared with others."""
    if plan.objective is None:
        return plan.status
    found = plan.objective
    return pytest.approx(
        (variance * found.information, energy * found.energy_j, found.makespan_s), rel=4 * _GAP
    )


def objective(plan: Plan) -> Any:
    if plan.objective is None:
        return plan.status
    return (plan.objective.information, plan.objective.energy_j, plan.objective.makespan_s)


# relaxing


def _more_energy(case: Case, r: int) -> Case:
    robots = robot_records(case.mission)
    robots[r]["energy_budget_j"] *= 1.25
    more = case.with_robots(robots)
    if case.state is None:
        return more
    team = list(case.state.robots)
    team[r] = team[r].model_copy(update={"energy_left_j": team[r].energy_left_j * 1.25})
    return replace(more, state=case.state.model_copy(update={"robots": tuple(team)}))


def _more_of(what: str) -> Callable[[Case, int], Case]:
    def more(case: Case, r: int) -> Case:
        robots = robot_records(case.mission)
        robots[r][what] += 1
        return case.with_robots(robots)

    return more


def _another_robot(case: Case, r: int) -> Case:
    robots = robot_records(case.mission)
    robots.append(robots[r] | {"id": "another", "start": robots[r]["depots"][0]})
    more = case.with_robots(robots)
    if case.state is None:
        return more
    new = initial_state(more.mission).robots[-1]
    return replace(more, state=case.state.model_copy(update={"robots": (*case.state.robots, new)}))


def _any_depot(case: Case, r: int) -> Case:
    robots = robot_records(case.mission)
    robots[r]["depots"] = [node.id for node in case.mission.site.nodes if node.role == "depot"]
    return case.with_robots(robots)


def _lighter_samples(case: Case, r: int) -> Case:
    mass = 0.7 * case.mission.team.sample_mass_kg
    return replace(case, mission=changed(case.mission, {"team": {"sample_mass_kg": mass}}))


def _every_edge(case: Case, r: int) -> Case:
    ways = [
        edge.model_dump(by_alias=True, exclude_none=True) | {"one_way": False, "closed_to": []}
        for edge in case.mission.site.edges
    ]
    return replace(case, mission=changed(case.mission, {"site": {"edges": ways}}))


def _handoffs(case: Case, r: int) -> Case:
    return replace(case, handoffs=True)


RELAXATIONS: dict[str, Callable[[Case, int], Case]] = {
    "energy": _more_energy,
    "capacity": _more_of("payload_capacity"),
    "samples a node": _more_of("samples_per_node"),
    "a robot": _another_robot,
    "depots": _any_depot,
    "lighter samples": _lighter_samples,
    "edges": _every_edge,
    "handoffs": _handoffs,
}


@pytest.mark.parametrize("what", RELAXATIONS)
def test_relaxing_anything_never_raises_j(what: str) -> None:
    @few(10)
    @given(cases(robots=2 if what == "a robot" else 3), st.integers(0, 2))
    def holds(case: Case, r: int) -> None:
        if what == "handoffs":
            case = replace(case, handoffs=False)
        relaxed = RELAXATIONS[what](case, r % len(case.mission.team.robots))
        assert information(planned(relaxed)) <= information(once(case)) * _MARGIN

    holds()


# changing nothing


def _robots_in_another_order(case: Case, rng: random.Random) -> Case:
    robots = robot_records(case.mission)
    rng.shuffle(robots)
    if case.state is None:
        return case.with_robots(robots)
    state = case.state.model_copy(update={"robots": tuple(reversed(case.state.robots))})
    return replace(case.with_robots(robots), state=state)


def _sites_in_another_order(case: Case, rng: random.Random) -> Case:
    record = case.mission.model_dump(mode="json", by_alias=True, exclude_none=True)
    for entries in (record["site"]["nodes"], record["site"]["edges"], record["field"]["test_points"]):
        rng.shuffle(entries)
    return replace(case, mission=Mission.model_validate(record))


def _another_frame(case: Case, rng: random.Random) -> Case:
    """Turn, mirror and move the site."""
    record = case.mission.model_dump(mode="json", by_alias=True, exclude_none=True)
    angle = rng.uniform(0.0, 2.0 * math.pi)
    for place in [*record["site"]["nodes"], *record["field"]["test_points"]]:
        x, y = place["x_m"], -place["y_m"]
        place["x_m"] = math.cos(angle) * x - math.sin(angle) * y + 30.0
        place["y_m"] = math.sin(angle) * x + math.cos(angle) * y - 70.0
    return replace(case, mission=Mission.model_validate(record))


def _other_names(case: Case, rng: random.Random) -> Case:
    """Rename nodes and robots so that their alphabetical order is turned round."""
    ids = [node.id for node in case.mission.site.nodes] + [robot.id for robot in case.mission.team.robots]
    names = {old: f"n{99 - k}" for k, old in enumerate(sorted(ids))}

    def renamed(part: Any) -> Any:
        if isinstance(part, dict):
            return {names.get(key, key): renamed(value) for key, value in part.items()}
        if isinstance(part, list):
            return [renamed(value) for value in part]
        return names.get(part, part) if isinstance(part, str) else part

    mission = renamed(case.mission.model_dump(mode="json", by_alias=True, exclude_none=True))
    state = (
        None if case.state is None else TeamState.model_validate(renamed(case.state.model_dump(mode="json")))
    )
    return replace(case, mission=Mission.model_validate(mission), state=state)


SAME: dict[str, Callable[[Case, random.Random], Case]] = {
    "order of robots": _robots_in_another_order,
    "order of nodes, edges and test points": _sites_in_another_order,
    "frame": _another_frame,
    "names": _other_names,
}


@pytest.mark.parametrize("what", SAME)
def test_what_should_change_nothing_changes_nothing(what: str) -> None:
    @few(12)
    @given(cases(), st.integers(0, 99))
    def holds(case: Case, seed: int) -> None:
        other = SAME[what](case, random.Random(seed))
        assert objective(planned(other)) == figures(once(case))

    holds()


# other units


def _scaled_state(state: TeamState | None, factor: float) -> TeamState | None:
    if state is None:
        return None
    robots = tuple(
        robot.model_copy(update={"energy_left_j": factor * robot.energy_left_j}) for robot in state.robots
    )
    return state.model_copy(update={"robots": robots})


@few(14)
@given(cases(), st.sampled_from([0.001, 0.3, 7.0, 4000.0]), st.booleans())
def test_energies_in_other_units_give_the_same_plan(case: Case, factor: float, by_mass: bool) -> None:
    robots = robot_records(case.mission)
    for robot in robots:
        robot["energy_budget_j"] *= factor
        robot["empty_mass_kg" if by_mass else "energy_per_kg_m"] *= factor
    sample_kg = case.mission.team.sample_mass_kg * (factor if by_mass else 1.0)
    mission = changed(case.mission, {"team": {"robots": robots, "sample_mass_kg": sample_kg}})
    scaled = replace(case, mission=mission, state=_scaled_state(case.state, factor))
    assert objective(planned(scaled)) == figures(once(case), energy=factor)


@few(10)
@given(cases(), st.sampled_from([0.001, 250.0]))
def test_a_field_in_other_units_gives_the_same_plan(case: Case, factor: float) -> None:
    robots = robot_records(case.mission)
    for robot in robots:
        robot["noise_variance"] *= factor
    kernel = case.mission.field.kernel.model_dump() | {"variance": factor}
    mission = changed(case.mission, {"team": {"robots": robots}, "field": {"kernel": kernel}})
    scaled = replace(case, mission=mission)
    assert objective(planned(scaled)) == figures(once(case), variance=factor)


# classical informative path planning


def without_weight(mission: Mission) -> Mission:
    robots = [robot | {"payload_capacity": 50} for robot in robot_records(mission)]
    return changed(mission, {"team": {"sample_mass_kg": 0.0, "robots": robots}})


@few(20)
@given(missions())
def test_samples_without_mass_give_classical_informative_path_planning(mission: Mission) -> None:
    mission = without_weight(mission)
    truth = weightless.optimum(mission)
    plan = planned(Case(mission))
    assert (plan.objective is None) == (truth is None)
    if plan.objective is not None and truth is not None:
        assert plan.objective.information == pytest.approx(truth[0], rel=4 * _GAP)
        assert plan.objective.energy_j == pytest.approx(truth[1], rel=4 * _GAP, abs=1e-9)


# bounds


@few(8)
@given(cases())
def test_no_bound_is_ever_above_the_optimum(case: Case) -> None:
    heard: list[Progress] = []
    optimum = information(planned(case, on_progress=heard.append))
    optimum = min(optimum, information(planned(case, "arcs", on_progress=heard.append)))
    stopped = [
        solve(case.mission, state=case.state, method="exact", handoffs=case.handoffs, mip_gap=_GAP, **limit)
        for limit in ({"work_limit": 1}, {"time_limit_s": 0.02}, {"time_limit_s": 0.1})
    ]
    bounds = [news.bound for news in heard] + [plan.bound.information for plan in stopped]
    bounds.append(relaxation_bound(case.mission, case.state))
    assert all(bound is None or bound <= optimum * (1 + 1e-9) for bound in bounds)
    for plan in stopped:
        assert_kept(case, plan)
        assert information(plan) >= optimum / _MARGIN


# plans and their figures


@pytest.mark.parametrize("method", ["exact", "no-handoffs", "arcs", "seq"])
def test_figures_are_those_of_the_routes(method: Method) -> None:
    @few(10)
    @given(cases())
    def holds(case: Case) -> None:
        plan = solve(case.mission, state=case.state, method=method, handoffs=case.handoffs)
        assert_kept(case, plan)
        if plan.objective is None:
            return
        found = plan.objective
        assert found.information == pytest.approx(posterior(case.mission, samples_of(case, plan)), rel=1e-9)
        assert found.energy_j == pytest.approx(sum(robot.energy_j for robot in plan.robots), rel=1e-9)
        assert found.makespan_s == max(robot.route[-1].depart_s for robot in plan.robots)
        assert plan.bound.information is None or plan.bound.information <= found.information

    holds()


# tails


@few(10)
@given(missions(), st.booleans())
def test_a_mission_that_has_not_begun_is_its_state_at_time_zero(mission: Mission, handoffs: bool) -> None:
    """Word for word, so that this says as well that a plan can be had again."""
    fresh = planned(Case(mission, handoffs=handoffs))
    again = planned(Case(mission, initial_state(mission), handoffs))
    different = {"solve_time_s"}
    assert again.model_dump(exclude=different) == fresh.model_dump(exclude=different)


def somebody_comes_back(plan: Plan, time_s: float, rest: Plan) -> bool:
    """Tell whether a robot stops where it has stopped before, which a plan made in one go may not."""
    for robot, done in stops_done(plan, time_s).items():
        stops = plan.robot(robot).route[:done] + rest.robot(robot).route
        *inner, end = (stop.node for stop in stops)
        if len(set(inner)) < len(inner) or (inner and inner[-1] == end):
            return True
    return False


@few(16)
@given(missions(), st.booleans(), st.floats(0.0, 1.0))
def test_the_rest_of_an_optimal_plan_is_optimal(mission: Mission, handoffs: bool, share: float) -> None:
    """Nothing having gone wrong, a new plan part-way ends with the same J.

    It may end with less, because stops that lie behind count no longer: a robot may come back to a node,
    as no single plan lets it (eq:visit_terminal), to take what it left or to unload once more.
    """
    plan = planned(Case(mission, handoffs=handoffs))
    if plan.objective is None:
        return
    time_s = share * plan.objective.makespan_s
    rest = planned(Case(mission, advance(mission, plan, time_s), handoffs))
    assert information(rest) <= information(plan) * _MARGIN
    if information(rest) < information(plan) / _MARGIN:
        assert somebody_comes_back(plan, time_s, rest)


@few(10)
@given(missions(), st.floats(0.0, 1.0))
def test_without_mass_the_rest_is_as_good_exactly(mission: Mission, share: float) -> None:
    """Coming back is of no use where carrying is free."""
    mission = without_weight(mission)
    plan = planned(Case(mission))
    if plan.objective is None:
        return
    state = advance(mission, plan, share * plan.objective.makespan_s)
    rest = planned(Case(mission, state))
    assert information(rest) == pytest.approx(information(plan), rel=4 * _GAP)
