"""The literal model equation by equation: each is broken alone, and only it complains."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import cvxpy as cp
import numpy as np
import pytest
from literal_cases import END_D, END_E, GOOD, NOISE, STAY, A, B, C, D, E, bench, get, place, put
from random_missions import part_way, tiny_mission

from malipp_field.planner import solve
from malipp_field.planner.extract import Route, Visit, routes_of, team_plan
from malipp_field.planner.paper.literal import LiteralModel
from malipp_field.planner.paper.literal_model import ENERGY, INFORMATION, MAKESPAN
from malipp_field.planner.paper.literal_plan import assign, read_routes
from malipp_field.planner.paper.literal_sets import coefficient_bounds, explained
from malipp_field.planner.problem import Problem, RobotView, build_problem

Breaker = Callable[[], LiteralModel]


def good() -> LiteralModel:
    return place(bench(), GOOD)


def with_robot(problem: Problem, r: int, robot: RobotView) -> Problem:
    return replace(problem, robots=(*problem.robots[:r], robot, *problem.robots[r + 1 :]))


def two_samples_where_one_is_allowed() -> LiteralModel:
    return place(bench(), ((Visit(D), Visit(A, collect=2), Visit(D, unload=2)), STAY, STAY))


def level(i: int, samples: int, problem: Problem) -> tuple[int, float]:
    levels = [key for key in LiteralModel(problem).sets.levels if key[0] == i]
    return min(levels, key=lambda key: abs(key[1] - samples / NOISE))


def better_than_sampled() -> LiteralModel:
    model = good()
    one, two = level(B, 1, model.problem), level(B, 2, model.problem)
    put(model, "z", {one: 0.0, two: 1.0})
    put(model, "p", {B: 2 / NOISE})
    columns = [model.z.position[key] for key in (one, two)]
    by_level = model.A_jvi.value.copy()
    by_level[:, columns] = by_level[:, columns[::-1]]
    model.A_jvi.save_value(by_level)
    return model


def no_level_for_a_precision() -> LiteralModel:
    model = good()
    put(model, "z", {level(B, 1, model.problem): 0.0})
    set_coefficients(model, level(B, 1, model.problem), 0.0)
    return model


def weight_on_a_level_not_selected() -> LiteralModel:
    model = good()
    set_coefficients(model, level(B, 2, model.problem), 0.1)
    return model


def set_coefficients(model: LiteralModel, key: tuple[int, float], value: float) -> None:
    by_level = model.A_jvi.value.copy()
    by_level[:, model.z.position[key]] = value
    model.A_jvi.save_value(by_level)
    nodes = np.array([[float(i == v) for i in range(3)] for v, _ in model.z.keys])
    model.A.save_value(by_level @ nodes)


def two_ways_out() -> LiteralModel:
    model = good()
    put(model, "x", {(2, D, END_E): 1.0})
    put(model, "phi", {(2, D, END_E): 1.0})
    put(model, "y", {(2, END_E): 1.0})
    put(model, "t", {(2, END_E): 10.0})
    return model


def start_not_visited() -> LiteralModel:
    model = good()
    put(model, "y", {(2, D): 0.0})
    return model


def dead_end() -> LiteralModel:
    model = good()
    put(model, "x", {(2, D, END_D): 0.0, (2, D, A): 1.0, (2, A, END_D): 1.0, (2, A, B): 1.0})
    put(model, "phi", {(2, D, END_D): 0.0, (2, D, A): 3.0, (2, A, END_D): 1.0, (2, A, B): 1.0})
    put(model, "y", {(2, A): 1.0, (2, B): 1.0})
    put(model, "t", {(2, A): 5.0, (2, B): 10.0, (2, END_D): 10.0})
    return model


def flow_on_arcs_not_used() -> LiteralModel:
    model = good()
    put(model, "phi", {(2, A, B): 1.0, (2, B, A): 1.0})
    return model


def flow_not_consumed() -> LiteralModel:
    model = good()
    put(model, "phi", {(0, A, B): 3.0})
    return model


def flow_from_nowhere() -> LiteralModel:
    model = good()
    put(model, "phi", {(0, D, A): 4.0})
    return model


def three_on_board() -> LiteralModel:
    giver = (Visit(D), Visit(C, collect=1, drop={2: 1}), Visit(D))
    crammed = Visit(C, collect=1, pick={0: 1})
    taker = (Visit(D), Visit(B, collect=1), crammed, Visit(E, unload=1), Visit(D, unload=2))
    return place(bench(), (giver, STAY, taker))


def battery_for_an_empty_run() -> LiteralModel:
    problem = bench()
    robot = problem.robots[0]
    cost = robot.closure.energy_per_kg
    empty_j = float(cost[D, A] + cost[A, B] + cost[B, D])
    return place(with_robot(problem, 0, replace(robot, budget_j=1.05 * empty_j)), GOOD)


def sample_lost() -> LiteralModel:
    model = good()
    put(model, "g", {(0, END_D): 0.0})
    return model


def unloads_what_it_picks() -> LiteralModel:
    giver = (Visit(D), Visit(A, collect=1), Visit(E, drop={1: 1}), Visit(D))
    return place(bench(), (giver, (Visit(D), Visit(E, pick={0: 1}, unload=1), Visit(D)), STAY))


def collects_before_it_drops() -> LiteralModel:
    third = Visit(C, collect=1, drop={1: 1})
    full = (Visit(D), Visit(A, collect=1), Visit(B, collect=1), third, Visit(D, unload=2))
    return place(bench(), (full, (Visit(D), Visit(C, pick={0: 1}), Visit(D, unload=1)), STAY))


def drops_more_than_it_can_hold() -> LiteralModel:
    problem = bench()
    small = with_robot(problem, 0, replace(problem.robots[0], capacity=1))
    giver = (Visit(D), Visit(A, collect=1), Visit(B, collect=1, drop={1: 1, 2: 1}), Visit(D))
    taker: Route = (Visit(D), Visit(B, pick={0: 1}), Visit(D, unload=1))
    return place(small, (giver, taker, taker))


def transfer_of_nothing() -> LiteralModel:
    model = good()
    put(model, "delta", {(0, 1, D): 1.0})
    return model


def transfer_by_an_absent_robot() -> LiteralModel:
    model = good()
    put(model, "delta", {(2, 0, B): 1.0})
    return model


def unloads_more_than_it_can_hold() -> LiteralModel:
    problem = bench()
    laden = with_robot(problem, 2, replace(problem.robots[2], on_board=3))
    return place(laden, (*GOOD[:2], (Visit(D, unload=3),)))


def departs_before_it_is_ready() -> LiteralModel:
    problem = bench()
    model = place(with_robot(problem, 2, replace(problem.robots[2], ready_s=5.0)), GOOD)
    put(model, "t", {(2, D): 4.0})
    return model


def faster_than_it_can_drive() -> LiteralModel:
    model = good()
    put(model, "t", {(0, B): float(model.problem.robots[0].closure.time_s[D, B])})
    return model


def shift(model: LiteralModel, r: int, slots: tuple[int, ...], by_s: float) -> None:
    put(model, "t", {(r, v): get(model, "t", (r, v)) + by_s for v in slots})
    model.T_end.save_value(np.array(100.0))


def picked_before_it_is_dropped() -> LiteralModel:
    model = good()
    shift(model, 0, (A, B, END_D), get(model, "t", (1, A)) - get(model, "t", (0, A)) + 1.0)
    return model


def swap() -> LiteralModel:
    first = (Visit(D), Visit(A, collect=1), Visit(B), Visit(D, unload=1))
    model = place(bench(), (first, (Visit(D), Visit(C, collect=1), Visit(A), Visit(E, unload=1)), STAY))
    shift(model, 0, (A, B, END_D), get(model, "t", (1, A)) - get(model, "t", (0, A)))
    for name in ("H", "delta"):
        put(model, name, {(0, 1, A): 1.0, (1, 0, A): 1.0})
    return model


def time_at_a_node_not_visited() -> LiteralModel:
    model = good()
    put(model, "t", {(2, A): 1.0})
    return model


def over_before_the_last_arrives() -> LiteralModel:
    model = good()
    model.T_end.save_value(model.T_end.value - 1.0)
    return model


def half_a_transfer() -> LiteralModel:
    model = good()
    put(model, "delta", {(0, 1, A): 0.5})
    return model


# Where a second label stands, the first follows from others: it cannot be broken alone.
CASES: dict[str, tuple[Breaker, set[str]]] = {
    "eq:sampling_visit": (two_samples_where_one_is_allowed, set()),
    "eq:precision": (better_than_sampled, set()),
    "eq:precision_select": (no_level_for_a_precision, set()),
    "eq:A_activation": (weight_on_a_level_not_selected, set()),
    "eq:start": (two_ways_out, {"eq:terminal_select"}),
    "eq:visit_terminal": (start_not_visited, set()),
    "eq:terminal_select": (two_ways_out, {"eq:start"}),
    "eq:balance": (dead_end, set()),
    "eq:flow": (flow_on_arcs_not_used, set()),
    "eq:flow_balance": (flow_not_consumed, set()),
    "eq:flow_source": (flow_from_nowhere, {"eq:flow_balance"}),
    "eq:payload": (three_on_board, set()),
    "eq:energy_budget": (battery_for_an_empty_run, set()),
    "eq:conservation": (sample_lost, set()),
    "eq:source_feasibility": (unloads_what_it_picks, set()),
    "eq:cap_feasibility": (collects_before_it_drops, set()),
    "eq:handoff_capacity": (drops_more_than_it_can_hold, {"eq:cap_feasibility"}),
    "eq:delta_amount": (transfer_of_nothing, set()),
    "eq:delta_visits": (transfer_by_an_absent_robot, {"eq:delta_amount"}),
    "eq:unload_bound": (unloads_more_than_it_can_hold, set()),
    "eq:start_time": (departs_before_it_is_ready, {"departure_bounds"}),
    "eq:time_propagation": (faster_than_it_can_drive, set()),
    "eq:deaddrop_sync": (picked_before_it_is_dropped, set()),
    "eq:no_mutual": (swap, set()),
    "departure_bounds": (time_at_a_node_not_visited, set()),
    "eq:makespan": (over_before_the_last_arrives, set()),
    "eq:domains": (half_a_transfer, set()),
}


def test_a_good_plan_keeps_every_equation() -> None:
    model = good()
    assert model.violations() == {}
    assert set(CASES) == set(model.constraints)


@pytest.mark.parametrize("label", CASES)
def test_one_equation_broken_is_the_one_reported(label: str) -> None:
    breaker, besides = CASES[label]
    assert set(breaker().violations()) == {label} | besides


def test_receiver_capacity_follows_from_the_rest() -> None:
    model = LiteralModel(bench())
    labels = ("eq:conservation", "eq:payload", "eq:visit_terminal", "eq:balance", "eq:start", "eq:domains")
    rows = [row for label in labels for row in model.constraints[label]]
    (implied,) = model.implied["eq:receiver_capacity"]
    excess = implied.args[0] - implied.args[1]
    for slot in ((0, A), (1, D), (2, E)):
        problem = cp.Problem(cp.Maximize(excess[model.sets.slots.index(slot)]), rows)
        assert problem.solve(solver=cp.HIGHS) <= 1e-6


def test_objectives_are_those_of_the_plan() -> None:
    model = good()
    team = team_plan(model.problem, GOOD)
    assert team is not None
    assert model.objectives[INFORMATION].value == pytest.approx(team.information, rel=1e-12)
    assert model.objectives[ENERGY].value == pytest.approx(team.energy_j, rel=1e-12)
    assert model.objectives[MAKESPAN].value == pytest.approx(team.makespan_s, rel=1e-12)
    assert read_routes(model) == GOOD


def test_j_is_least_at_the_posterior_estimator() -> None:
    model = good()
    best = float(model.objectives[INFORMATION].value)
    rng = np.random.default_rng(0)
    chosen = model.z.variable.value
    nodes = np.array([[float(i == v) for i in range(3)] for v, _ in model.z.keys])
    for _ in range(5):
        by_level = model.A_jvi.value + 0.01 * rng.normal(size=model.A_jvi.shape) * chosen
        model.A.save_value(by_level @ nodes)
        model.A_jvi.save_value(by_level)
        assert float(model.objectives[INFORMATION].value) > best


@pytest.mark.parametrize("seed", range(4))
def test_coefficient_bounds_hold_for_every_selection(seed: int) -> None:
    sets = LiteralModel(build_problem(tiny_mission(seed, candidates=4, samples_per_node=2))).sets
    known, bounds = sets.problem.information, coefficient_bounds(sets)
    rng = np.random.default_rng(seed)
    tightest = np.inf
    for _ in range(50):
        columns = [
            int(rng.choice(own))
            for i in range(4)
            if (own := [c for c, (v, _) in enumerate(sets.levels) if v == i]) and rng.uniform() < 0.6
        ]
        nodes = [sets.levels[c][0] for c in columns]
        noisy = known.k_vv[np.ix_(nodes, nodes)] + np.diag([1 / sets.levels[c][1] for c in columns])
        best = np.linalg.solve(noisy, known.k_tv[:, nodes].T).T
        room = bounds[:, columns] - np.abs(best)
        tightest = min(tightest, float(np.min(room, initial=np.inf)))
    assert tightest >= -1e-12


def test_explained_variance_is_what_j_loses() -> None:
    known = bench().information
    precision = np.array([10.0, 0.0, 20.0])
    lost = known.weights @ explained(known.k_vv, known.k_tv, precision)
    assert known.prior - lost == pytest.approx(known.value(precision), rel=1e-12)


def test_samples_handed_round_in_a_circle_stay_where_they_are() -> None:
    visit: Route = (Visit(D), Visit(A), Visit(D))
    model = place(bench(), tuple((Visit(D), Visit(A, collect=1), Visit(D, unload=1)) for _ in visit))
    circle = [(0, 1, A), (1, 2, A), (2, 0, A)]
    for name in ("H", "delta"):
        put(model, name, dict.fromkeys(circle, 1.0))
    assert model.violations() == {}
    assert all(not stop.drop and not stop.pick for route in read_routes(model) for stop in route)


def test_an_idle_stop_between_a_depot_and_its_copy_is_kept() -> None:
    """What is picked at a depot is not unloaded in the same visit, and no arc leads straight to the copy."""
    giver = (Visit(D), Visit(A, collect=1), Visit(E, drop={1: 1}), Visit(D))
    taker = (Visit(D), Visit(E, pick={0: 1}), Visit(B), Visit(E, unload=1))
    model = place(bench(), (giver, taker, STAY))
    assert model.violations() == {}
    assert read_routes(model) == (giver, taker, STAY)


@pytest.mark.parametrize("seed", [0, 1, 3, 5, 60, 62, 64])
def test_plans_of_the_fast_method_are_feasible_here(seed: int) -> None:
    mission = tiny_mission(seed, candidates=2)
    state = part_way(mission, seed) if seed >= 60 else None
    plan = solve(mission, state=state, method="seq", time_limit_s=20.0)
    if not plan.robots:
        plan = solve(mission, state=state, method="exact", time_limit_s=20.0)
    problem = build_problem(mission, state)
    team = team_plan(problem, routes_of(problem, plan))
    assert team is not None
    model = LiteralModel(problem)
    assert assign(model, team)
    assert model.violations() == {}
    assert model.objectives[INFORMATION].value == pytest.approx(team.information, rel=1e-9)
    assert model.objectives[ENERGY].value == pytest.approx(team.energy_j, rel=1e-9)
    assert read_routes(model) == team.routes


def fetched() -> LiteralModel:
    mission = tiny_mission(60, candidates=2)
    problem = build_problem(mission, part_way(mission, 60))
    plan = solve(mission, state=part_way(mission, 60), method="exact", time_limit_s=20.0)
    model = LiteralModel(problem)
    team = team_plan(problem, routes_of(problem, plan))
    assert team is not None
    assert assign(model, team)
    return model


def test_stock_is_fetched_whole_and_not_too_early() -> None:
    model = fetched()
    (taker,) = [key for key, count in zip(model.F.keys, model.F.variable.value, strict=True) if count]
    stock = model.problem.stocks[taker[1]]
    late = replace(stock, available_s=get(model, "t", (taker[0], stock.node)) + 5.0)
    later = LiteralModel(replace(model.problem, stocks=(late,)))
    for name, variable in model.variables.items():
        later.variables[name].save_value(variable.value)
    assert set(later.violations()) == {"eq:deaddrop_sync"}
    put(model, "f", {taker: 0.0})
    assert set(model.violations()) == {"eq:delta_amount"}
    put(model, "F", {taker: 0.0})
    assert set(model.violations()) == {"eq:conservation"}
