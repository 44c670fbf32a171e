"""The bound of the relaxation: below every plan, exact where nothing is scarce, no matter of trust."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import chain, combinations, pairwise, permutations
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from relaxation_reference import relaxed_optimum
from verify_cases import FIELD, Routes, Scene, dead_drop, mid_route, one_way, plan_of, residual, robot, stop

from malipp_field.field import candidate_ids, information_model
from malipp_field.mission import Mission, TeamState, node_positions, parse_mission
from malipp_field.plan import RobotPlan
from malipp_field.planner.bounds import relaxation
from malipp_field.planner.bounds.relaxation import relaxation_bound
from malipp_field.planner.bounds.relaxation_rows import Polytope
from malipp_field.planner.problem import build_problem
from malipp_field.planner.verifier.rules import verify

PLACES = {"a": (10.0, 4.0), "b": (18.0, -6.0), "c": (25.0, 3.0), "d": (4.0, -9.0)}


def mission_of(*robots: dict[str, Any]) -> Mission:
    nodes: list[dict[str, Any]] = [{"id": "base", "x_m": 0.0, "y_m": 0.0, "role": "depot"}]
    nodes += [{"id": node, "x_m": x_m, "y_m": y_m} for node, (x_m, y_m) in PLACES.items()]
    return parse_mission(
        json.dumps(
            {
                "format": "malipp-mission/1",
                "name": "open",
                "site": {"nodes": nodes, "complete": True},
                "field": FIELD,
                "team": {"sample_mass_kg": 0.7, "robots": list(robots)},
            }
        )
    )


def information(mission: Mission, taken: dict[str, int], noise_variance: float) -> float:
    precision = np.array([taken.get(node, 0) / noise_variance for node in candidate_ids(mission)])
    return information_model(mission).value(precision)


def with_budget(budget_j: float, **fields: Any) -> Mission:
    return mission_of(robot("solo", energy_budget_j=budget_j, payload_capacity=4, **fields))


def subsets(nodes: tuple[str, ...]) -> Iterator[tuple[str, ...]]:
    return chain.from_iterable(combinations(nodes, k) for k in range(len(nodes) + 1))


def best_of_one(mission: Mission) -> float:
    """J of the best plan of one robot that takes one sample at every stop, by trying every order."""
    solo, places = mission.team.robots[0], node_positions(mission)
    best = math.inf
    for nodes in subsets(tuple(PLACES)):
        value = information(mission, dict.fromkeys(nodes, 1), solo.noise_variance)
        for order in permutations(nodes):
            energy_j = sum(
                math.dist(places[u], places[v]) * (solo.empty_mass_kg + mission.team.sample_mass_kg * load)
                for load, (u, v) in enumerate(pairwise(("base", *order, "base")))
            )
            if energy_j <= solo.energy_budget_j:
                best = min(best, value)
    return best


@pytest.mark.parametrize("budget_j", [0.0, 15.0, 30.0, 60.0, 90.0, 120.0])
def test_the_bound_is_below_the_best_plan_of_one_robot(budget_j: float) -> None:
    mission = with_budget(budget_j)
    assert relaxation_bound(mission) <= best_of_one(mission)


@pytest.mark.parametrize("budget_j", [0.0, 1.0e4])
def test_the_bound_is_exact_where_nothing_can_be_taken_and_where_everything_can(budget_j: float) -> None:
    mission = with_budget(budget_j)
    assert relaxation_bound(mission) == pytest.approx(best_of_one(mission), rel=1e-6)


def test_the_bound_knows_that_all_that_can_be_reached_need_not_fit_into_one_route() -> None:
    mission = with_budget(60.0)  # each of the four nodes alone costs at most 50.4 J out and 35.6 J of load
    reach = information(mission, dict.fromkeys(PLACES, 1), 0.1)
    assert reach + 0.2 < relaxation_bound(mission) <= best_of_one(mission)


def test_more_energy_never_raises_the_bound() -> None:
    bounds = [relaxation_bound(with_budget(budget_j)) for budget_j in np.linspace(0.0, 150.0, 11)]
    assert np.all(np.diff(bounds) <= 1e-6)
    assert bounds[-1] < bounds[0] - 1.0


def test_heavier_samples_never_lower_the_bound() -> None:
    bounds = []
    for mass_kg in (0.0, 0.5, 1.0, 4.0):
        light = with_budget(60.0)
        bounds.append(
            relaxation_bound(
                light.model_copy(update={"team": light.team.model_copy(update={"sample_mass_kg": mass_kg})})
            )
        )
    assert np.all(np.diff(bounds) >= -1e-6)
    assert bounds[-1] > bounds[0] + 0.1


def test_the_reserve_counts_as_spent() -> None:
    mission = with_budget(100.0)
    options = mission.planner.model_copy(update={"energy_reserve": 0.5})
    with_reserve = mission.model_copy(update={"planner": options})
    assert relaxation_bound(with_reserve) == pytest.approx(relaxation_bound(with_budget(50.0)), rel=1e-5)


@pytest.mark.parametrize("scene", [dead_drop, mid_route, one_way, residual], ids=lambda scene: scene.__name__)
def test_the_bound_is_below_plans_made_by_hand(scene: Callable[[], Scene]) -> None:
    mission, plan, state = scene().build()
    assert plan.objective is not None
    assert relaxation_bound(mission, state) <= plan.objective.information


def test_precision_gained_so_far_counts() -> None:
    mission = with_budget(60.0)
    fresh = {"id": "solo", "node": "base", "energy_left_j": 0.0}
    after = TeamState.model_validate({"robots": [fresh | {"collected": {"a": 1, "c": 1}}]})
    assert relaxation_bound(mission, after) == pytest.approx(
        information(mission, {"a": 1, "c": 1}, 0.1), rel=1e-6
    )


def test_a_robot_that_reaches_no_depot_still_gives_a_bound() -> None:
    mission = with_budget(60.0)
    lost = TeamState.model_validate({"robots": [{"id": "solo", "node": "c", "energy_left_j": 1.0}]})
    assert math.isfinite(relaxation_bound(mission, lost))


# The solver is not trusted ------------------------------------------------------------------------------


def test_a_solver_that_answers_nonsense_only_makes_the_bound_weak(monkeypatch: pytest.MonkeyPatch) -> None:
    honest, mission = relaxation._solve, with_budget(60.0)
    rng = np.random.default_rng(3)

    def nonsense(*arguments: Any) -> relaxation._Answer | None:
        answer = honest(*arguments)
        assert answer is not None
        return replace(
            answer,
            precision=answer.precision * rng.uniform(0.0, 3.0, answer.precision.shape),
            equal=answer.equal + rng.normal(0.0, 1.0, answer.equal.shape),
            at_most=answer.at_most * rng.uniform(0.0, 2.0, answer.at_most.shape),
        )

    tight = relaxation_bound(mission)
    monkeypatch.setattr(relaxation, "_solve", nonsense)
    for _ in range(10):
        assert relaxation_bound(mission) <= tight + 1e-6 <= best_of_one(mission)


def test_without_an_answer_in_time_the_bound_is_what_reach_alone_allows(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    mission = with_budget(60.0)
    monkeypatch.setattr(relaxation, "_solve", lambda *_: None)
    everything = information(mission, dict.fromkeys(PLACES, 1), 0.1)
    assert relaxation_bound(mission) == pytest.approx(everything, rel=1e-6)


# Plans with handoffs, on budgets with nothing to spare --------------------------------------------------


@dataclass
class Relay:
    """What a scout does at each of its stops, in order, and what a carrier that follows finds and takes."""

    collect: dict[str, int]
    drop: dict[str, int]
    carrier_order: list[str]
    carrier_collect: dict[str, int]
    cached: dict[str, int]
    on_board: int


@st.composite
def relays(draw: st.DrawFn) -> Relay:
    order = draw(st.permutations(list(PLACES)))[: draw(st.integers(1, 4))]
    collect = {node: draw(st.integers(0, 2)) for node in order}
    drop, load = {}, 0
    for node in order:
        load += collect[node]
        drop[node] = draw(st.integers(0, load))
        load -= drop[node]
    cached = {node: draw(st.integers(0, 1)) for node in PLACES}
    needed = {node for node in PLACES if drop.get(node) or cached[node]}
    extra = {node for node in PLACES if draw(st.booleans())}
    carrier_order = [node for node in draw(st.permutations(list(PLACES))) if node in needed | extra]
    taken = {node: draw(st.integers(0, 1)) for node in carrier_order}
    return Relay(collect, drop, carrier_order, taken, cached, draw(st.integers(0, 2)))


def routes_of(relay: Relay) -> Routes:
    scout = [stop("base")]
    for before, node in pairwise(["base", *relay.collect]):
        drop = {"carrier": relay.drop[node]} if relay.drop[node] else {}
        scout.append(stop(node, f"{before} {node}", collect=relay.collect[node], drop=drop))
    left = sum(relay.collect.values()) - sum(relay.drop.values())
    scout.append(stop("base", f"{scout[-1]['node']} base", unload=left))
    carrier, load = [stop("base", depart_s=1000.0)], relay.on_board
    for before, node in pairwise(["base", *relay.carrier_order]):
        found = relay.drop.get(node, 0) + relay.cached[node]
        pick = {"scout": found} if found else {}
        carrier.append(stop(node, f"{before} {node}", collect=relay.carrier_collect[node], pick=pick))
        load += found + relay.carrier_collect[node]
    last = carrier[-1]["node"]
    carrier.append(stop("base", "base" if last == "base" else f"{last} base", unload=load))
    return {"scout": scout, "carrier": carrier}


def most_held(entry: RobotPlan, on_board: int) -> int:
    """The capacity a route needs: what is on board on departure, and before anything is dropped."""
    brought = [on_board, *(made.payload for made in entry.route)]
    held = [load + made.collect - made.unload for load, made in zip(brought, entry.route, strict=False)]
    return max(brought + held)


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(relays())
def test_the_bound_is_below_a_plan_with_handoffs_that_needs_all_there_is(relay: Relay) -> None:
    routes = routes_of(relay)
    generous = mission_of(
        robot("scout", samples_per_node=2), robot("carrier", empty_mass_kg=3.0, noise_variance=0.4)
    )
    caches = [{"node": n, "sender": "scout", "count": c} for n, c in relay.cached.items() if c]

    def state_of(energies: dict[str, float]) -> TeamState:
        robots: list[dict[str, Any]] = [
            {"id": r, "node": "base", "energy_left_j": energy_j} for r, energy_j in energies.items()
        ]
        robots[1]["on_board"] = relay.on_board
        return TeamState.model_validate({"robots": robots, "caches": caches})

    draft = plan_of(generous, routes, state_of({"scout": 0.0, "carrier": 0.0}))
    state = state_of({entry.id: entry.energy_j for entry in draft.robots})
    held = [most_held(entry, state.robot(entry.id).on_board) for entry in draft.robots]
    scout, carrier = (max(most, *relay.drop.values(), 0) for most in held)
    mission = mission_of(
        robot("scout", samples_per_node=2, payload_capacity=scout),
        robot(
            "carrier", empty_mass_kg=3.0, noise_variance=0.4,
            payload_capacity=carrier,
        ),
    )  # fmt: skip
    plan = plan_of(mission, routes, state)
    assert verify(mission, plan, state) == []
    assert plan.objective is not None
    assert relaxation_bound(mission, state) <= plan.objective.information


@pytest.mark.parametrize("budget_j", [30.0, 60.0, 90.0])
def test_the_cone_program_is_that_of_cvxpy(budget_j: float) -> None:
    two = mission_of(
        robot("light", energy_budget_j=budget_j, noise_variance=0.4),
        robot("heavy", energy_budget_j=1.5 * budget_j, payload_capacity=4),
    )
    problem = build_problem(two)
    polytope, most = Polytope(problem), relaxation._most_precision(problem)
    answer = relaxation._solve(polytope, most, 60.0)
    assert answer is not None
    optimum, precision = relaxed_optimum(polytope, most)
    assert problem.information.value(answer.precision) == pytest.approx(optimum, rel=1e-5)
    assert answer.precision == pytest.approx(precision, rel=1e-2, abs=1e-2)
    # the multipliers prove what the point achieves
    assert relaxation._certified(polytope, answer) == pytest.approx(optimum, rel=1e-5)
