"""What `solve` promises beside the optimum: limits, reasons, warm starts, methods and reproducibility."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from random_missions import part_way, tiny_mission
from team_cases import quickest

from malipp_field.mission import Cache, Mission, RobotState, TeamState, initial_state, read_mission
from malipp_field.mission.schema import Method
from malipp_field.plan import Plan
from malipp_field.planner import Progress, solve, verify
from malipp_field.planner.bounds.relaxation import relaxation_bound

MISSIONS = Path(__file__).parents[2] / "missions"
FEW = settings(max_examples=5, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))
seeds = st.integers(100, 400).filter(lambda seed: seed % 5 != 4)


def corridor() -> Mission:
    return read_mission(MISSIONS / "corridor.yaml")


def quarry() -> Mission:
    return read_mission(MISSIONS / "quarry.yaml")


def information(plan: Plan) -> float:
    assert plan.objective is not None
    return plan.objective.information


def without_time(plan: Plan) -> Plan:
    return plan.model_copy(update={"solve_time_s": 0.0})


def test_in_the_corridor_dead_drops_pay() -> None:
    plans = {method: solve(corridor(), method=method) for method in ("auto", "exact", "no-handoffs", "seq")}
    assert {plan.status for name, plan in plans.items() if name != "seq"} == {"optimal"}
    assert information(plans["exact"]) < 0.9 * information(plans["no-handoffs"])
    assert information(plans["auto"]) == pytest.approx(information(plans["exact"]), rel=1e-4)
    assert information(plans["no-handoffs"]) <= information(plans["seq"]) * (1 + 1e-4)
    assert [plans[name].method for name in plans] == ["exact", "exact", "no-handoffs", "seq"]
    assert plans["exact"].handoffs > 0
    assert plans["no-handoffs"].handoffs == plans["seq"].handoffs == 0
    bound = plans["seq"].bound.information  # of the relaxation: Seq-LIPP proves nothing itself
    assert bound is not None
    assert bound <= information(plans["exact"]) * (1 + 1e-6)


def test_handoffs_false_is_the_ablation() -> None:
    plan = solve(corridor(), method="exact", handoffs=False)
    assert (plan.method, plan.handoffs) == ("no-handoffs", 0)


def test_the_bound_of_the_relaxation_holds() -> None:
    assert relaxation_bound(corridor()) <= information(solve(corridor(), method="exact")) * (1 + 1e-6)


@FEW
@given(seeds)
def test_handoffs_never_raise_j(seed: int) -> None:
    mission = tiny_mission(seed, candidates=3)
    free = solve(mission, method="exact", handoffs=True, mip_gap=1e-7)
    bound = solve(mission, method="exact", handoffs=False, mip_gap=1e-7)
    if free.objective and bound.objective:
        assert information(free) <= information(bound) + 1e-6


@FEW
@given(seeds)
def test_a_larger_budget_never_raises_j(seed: int) -> None:
    poor, rich = (tiny_mission(seed, energy_budget_j=budget) for budget in (18.0, 24.0))
    before, after = solve(poor, method="exact", mip_gap=1e-7), solve(rich, method="exact", mip_gap=1e-7)
    if before.objective:
        assert information(after) <= information(before) + 1e-6


@FEW
@given(seeds)
def test_the_order_of_robots_is_of_no_consequence(seed: int) -> None:
    mission = tiny_mission(seed, candidates=3)
    turned = mission.model_copy(
        update={"team": mission.team.model_copy(update={"robots": mission.team.robots[::-1]})}
    )
    one, other = solve(mission, method="exact", mip_gap=1e-7), solve(turned, method="exact", mip_gap=1e-7)
    assert one.status == other.status
    if one.objective and other.objective:
        assert one.objective.information == pytest.approx(other.objective.information, rel=1e-6)
        assert one.objective.energy_j == pytest.approx(other.objective.energy_j, rel=1e-6, abs=1e-6)


@FEW
@given(seeds)
def test_the_sequential_plan_is_never_better_and_the_bound_never_above(seed: int) -> None:
    mission = tiny_mission(seed, candidates=4)
    exact, seq = solve(mission, method="auto", time_limit_s=4.0), solve(mission, method="seq")
    assert exact.status in {"optimal", "feasible", "infeasible"}
    if exact.objective and seq.objective:
        assert information(exact) <= information(seq) * (1 + 1e-4)
        assert exact.bound.information is not None
        assert exact.bound.information <= information(exact) + 1e-9


def test_an_unreachable_depot_is_named_with_the_energy_it_needs() -> None:
    mission = tiny_mission(1, energy_budget_j=1.0, start="v1", depots=["d0"])
    plan = solve(mission)
    assert plan.status == "infeasible"
    assert plan.robots == ()
    assert plan.reason is not None
    assert plan.reason.startswith("r0: the cheapest way from v1 to a depot (d0) needs ")
    assert plan.reason.endswith("its budget is 1.0 J")


def test_samples_that_nobody_can_fetch_are_named() -> None:
    mission = tiny_mission(1, energy_budget_j=3.0, start="d0", depots=["d0"])
    state = initial_state(mission).model_copy(update={"caches": (Cache(node="v2", sender="r1", count=1),)})
    for handoffs in (True, False):
        plan = solve(mission, state=state, handoffs=handoffs)
        assert plan.status == "infeasible"
        assert plan.reason is not None
        assert plan.reason.startswith("samples of r1 at v2: no robot can fetch them: ")


def test_more_samples_than_the_team_can_take_up_at_one_stop_each() -> None:
    mission = tiny_mission(1, energy_budget_j=90.0, start="d0", depots=["d0"], payload_capacity=1)
    state = initial_state(mission).model_copy(update={"caches": (Cache(node="v2", sender="r1", count=3),)})
    assert solve(mission, state=state).reason == (
        "samples of r1 at v2: 3 lie there, robots that can fetch them carry 2 at most, and stop there once"
    )


def test_a_robot_that_is_too_heavily_loaded_is_named_unless_it_may_hand_over() -> None:
    mission = tiny_mission(1, robots=1, start="v1", depots=["d0"], payload_capacity=1)
    state = TeamState(robots=(RobotState(id="r0", node="v1", energy_left_j=50.0, on_board=2),))
    assert solve(mission, state=state).reason == "r0: it has 2 samples on board and room for 1"


@pytest.mark.parametrize("method", ["auto", "seq"])
def test_the_time_limit_is_kept(method: Method) -> None:
    plan, took_s = quickest(lambda: solve(quarry(), method=method, time_limit_s=1.0), 3.0)
    assert took_s < 3.0
    assert plan.status == "feasible"


def test_cancelling_gives_the_best_plan_so_far() -> None:
    heard: list[Progress] = []
    plan = solve(
        quarry(), method="exact", time_limit_s=60.0, on_progress=heard.append,
        cancelled=lambda: any(p.stage == "ruin and recreate" for p in heard),
    )  # fmt: skip
    assert plan.status == "feasible"
    assert plan.solve_time_s < 40.0
    incumbents = [p.incumbent for p in heard if p.incumbent is not None and p.stage != "sequential"]
    assert information(plan) == pytest.approx(incumbents[-1])
    assert all(p.elapsed_s <= q.elapsed_s for p, q in pairwise(heard))


def test_cancelled_at_once_the_plan_is_a_modest_one() -> None:
    plan = solve(quarry(), method="exact", cancelled=lambda: True)
    assert plan.status == "feasible"
    assert all(len(robot.route) == 1 for robot in plan.robots)


def test_with_nothing_that_can_be_built_in_time_there_is_no_plan_and_a_reason() -> None:
    mission = tiny_mission(1, candidates=3, energy_budget_j=30.0, start="d0", depots=["d0"])
    caches = tuple(Cache(node=f"v{i}", sender="r0", count=2) for i in range(3))
    state = initial_state(mission).model_copy(update={"caches": caches})
    assert solve(mission, state=state, method="exact").status != "no_plan"
    plan = solve(mission, state=state, method="seq", cancelled=lambda: True)
    assert (plan.status, plan.robots) == ("no_plan", ())
    assert plan.reason


def test_the_same_seed_gives_the_same_plan() -> None:
    mission = corridor()
    once, again = (without_time(solve(mission, method="auto", seed=3)) for _ in range(2))
    assert once == again
    assert once.status == "optimal"
    assert once.seed == 3


def test_a_warm_start_is_never_lost() -> None:
    mission = quarry()
    first = solve(mission, method="exact", time_limit_s=4.0)
    again = solve(mission, time_limit_s=1.0, warm_start=first, version=2)
    assert information(again) <= information(first)
    assert again.version == 2


def test_a_warm_start_that_breaks_a_rule_is_passed_over() -> None:
    mission = corridor()
    plan = solve(mission, method="exact")
    start = initial_state(mission)
    scout, carrier = start.robots
    poorer = start.model_copy(
        update={"robots": (scout.model_copy(update={"energy_left_j": 12000.0}), carrier)}
    )
    assert verify(mission, plan, poorer)
    again = solve(mission, state=poorer, method="exact", warm_start=plan)
    assert again.status == "optimal"
    assert information(again) > information(plan)


def test_an_energy_reserve_is_kept() -> None:
    mission = corridor()
    options = mission.planner.model_copy(update={"energy_reserve": 0.3})
    plan = solve(mission.model_copy(update={"planner": options}), method="exact")
    for robot in mission.team.robots:
        assert plan.robot(robot.id).energy_j <= 0.7 * robot.energy_budget_j * (1 + 1e-9)


def test_what_is_gained_already_counts() -> None:
    mission = tiny_mission(1, candidates=3)
    state = part_way(mission, 1)
    plan = solve(mission, state=state, method="exact")
    fresh = state.model_copy(
        update={"robots": tuple(r.model_copy(update={"collected": {}}) for r in state.robots)}
    )
    assert information(plan) < information(solve(mission, state=fresh, method="exact"))


def test_a_sequential_plan_fetches_what_lies_in_drops() -> None:
    mission = tiny_mission(3, candidates=3, energy_budget_j=60.0)
    state = initial_state(mission).model_copy(
        update={
            "caches": (
                Cache(node="v1", sender="r0", count=1, available_s=200.0),
                Cache(node="v2", sender="r1", count=1),
            )
        }
    )
    plan = solve(mission, state=state, method="seq")
    assert plan.status == "feasible"
    assert sum(sum(stop.pick.values()) for robot in plan.robots for stop in robot.route) == 2
    assert plan.handoffs == 0
