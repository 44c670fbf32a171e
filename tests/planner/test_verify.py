"""The verifier: plans made by hand hold, and for every rule there is a plan that breaks it."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable
from importlib import import_module

import pytest
from verify_cases import Scene, dead_drop, mid_route, one_way, residual, stop

from malipp_field.errors import PlanError
from malipp_field.planner.verifier import custody as verify_custody
from malipp_field.planner.verifier import routes as verify_routes
from malipp_field.planner.verifier.rules import check, verify

Change = Callable[[Scene], None]
SCENES = {scene.__name__: scene for scene in (dead_drop, mid_route, one_way, residual)}


@pytest.mark.parametrize("name", SCENES)
def test_a_plan_made_by_hand_holds(name: str) -> None:
    mission, plan, state = SCENES[name]().build()
    assert verify(mission, plan, state) == []
    check(mission, plan, state)


def test_the_figures_of_the_dead_drop_are_those_of_the_paper() -> None:
    _, plan, _ = dead_drop().build()
    assert [leg.leg_energy_j for leg in plan.robot("scout").route[1:]] == [30.0, 20.0, 20.0]
    assert [leg.leg_energy_j for leg in plan.robot("carrier").route[1:]] == [80.0, 120.0]
    assert [leg.depart_s for leg in plan.robot("scout").route] == [2.0, 34.0, 46.0, 68.0]
    assert [leg.depart_s for leg in plan.robot("carrier").route] == [2.0, 51.0, 73.0]
    assert plan.objective is not None
    assert (plan.objective.energy_j, plan.objective.makespan_s) == (270.0, 73.0)


# Whole-plan rules ---------------------------------------------------------------------------------------


def other_mission(s: Scene) -> None:
    s.plan["mission"] = "another"


def optimal_without_proof(s: Scene) -> None:
    s.plan["status"] = "optimal"


def reason_beside_a_plan(s: Scene) -> None:
    s.plan["reason"] = "none"


def feasible_without_objective(s: Scene) -> None:
    s.plan["objective"] = None


def routes_of_an_infeasible_mission(s: Scene) -> None:
    s.plan |= {"status": "infeasible", "reason": "too far", "objective": None}


def infeasible_without_reason(s: Scene) -> None:
    s.plan |= {"status": "infeasible", "objective": None, "robots": []}


def robot_left_out(s: Scene) -> None:
    del s.routes["idle"]


def stranger(s: Scene) -> None:
    s.routes["ghost"] = [stop("base")]


def robot_entered_twice(s: Scene) -> None:
    _, plan, _ = s.build()
    s.plan["robots"] = (*plan.robots, plan.robot("idle"))


def wrong_information(s: Scene) -> None:
    _change_objective(s, "information", 1e-4)


def wrong_energy(s: Scene) -> None:
    _change_objective(s, "energy_j", 0.01)


def wrong_makespan(s: Scene) -> None:
    _change_objective(s, "makespan_s", -0.01)


def _change_objective(s: Scene, key: str, by: float) -> None:
    _, plan, _ = s.build()
    assert plan.objective is not None
    s.plan["objective"] = plan.objective.model_dump() | {key: getattr(plan.objective, key) + by}


def bound_above_information(s: Scene) -> None:
    s.plan |= {"bound": {"information": 1000.0}, "gap": 0.0}


def gap_that_does_not_fit(s: Scene) -> None:
    s.plan |= {"bound": {"information": 0.0}, "gap": 0.5}


def gap_without_bound(s: Scene) -> None:
    s.plan["gap"] = 0.1


WHOLE: list[tuple[Callable[[], Scene], Change, set[str]]] = [
    (dead_drop, other_mission, {"format:mission"}),
    (dead_drop, optimal_without_proof, {"format:status"}),
    (dead_drop, reason_beside_a_plan, {"format:status"}),
    (dead_drop, feasible_without_objective, {"format:status"}),
    (dead_drop, routes_of_an_infeasible_mission, {"format:status"}),
    (dead_drop, infeasible_without_reason, {"format:reason"}),
    (dead_drop, robot_left_out, {"format:robots"}),
    (dead_drop, stranger, {"format:robots"}),
    (dead_drop, robot_entered_twice, {"format:robots"}),
    (dead_drop, wrong_information, {"eq:llse_objective"}),
    (residual, wrong_information, {"eq:llse_objective"}),
    (dead_drop, wrong_energy, {"eq:total_energy"}),
    (dead_drop, wrong_makespan, {"eq:makespan"}),
    (dead_drop, bound_above_information, {"format:bound"}),
    (dead_drop, gap_that_does_not_fit, {"format:gap"}),
    (dead_drop, gap_without_bound, {"format:gap"}),
]

# Routes -------------------------------------------------------------------------------------------------


def begins_elsewhere(s: Scene) -> None:
    s.routes["idle"] = [stop("yard")]


def begins_behind_the_state(s: Scene) -> None:
    s.routes["scout"] = [stop("b"), stop("base", "b h a base")]
    s.begin("scout")["energy_left_j"] = 100.0


def back_into_the_start(s: Scene) -> None:
    s.routes["idle"] = [stop("base"), stop("a", "base a"), stop("base", "a base"), stop("b", "base a h b"),
                        stop("base", "b h a base")]  # fmt: skip


def departs_before_service(s: Scene) -> None:
    s.routes["scout"][0]["depart_s"] = 1.0


def departs_before_it_is_ready(s: Scene) -> None:
    s.routes["scout"][0]["depart_s"] = 47.0


def first_stop_with_a_leg(s: Scene) -> None:
    s.routes["idle"][0] |= {"path": ["base"], "arrive_s": 0.0, "leg_energy_j": 0.0}


def stop_without_arrival(s: Scene) -> None:
    s.routes["scout"][1]["arrive_s"] = None


def node_twice(s: Scene) -> None:
    s.routes["scout"][1:2] = [stop("h", "base a h"), stop("b", "h b", collect=1)]
    s.routes["carrier"][1]["depart_s"] = 60.0


def ends_in_the_field(s: Scene) -> None:
    s.routes["scout"][-1] = stop("a", "h a")


def ends_at_a_strange_depot(s: Scene) -> None:
    s.team("scout")["depots"] = ["yard"]


def stops_at_a_via_node(s: Scene) -> None:
    s.routes["scout"][1:2] = [stop("out", "base out"), stop("a", "out a", collect=1)]


def depot_to_its_own_copy(s: Scene) -> None:
    s.routes["scout"][3:] = [stop("yard", "yard")]


def unknown_node(s: Scene) -> None:
    # Legs to and from nowhere have no energy that could be checked, and the rule on paths leaves them alone.
    s.routes["idle"] = [stop("base"), stop("nowhere", "base nowhere"), stop("base", "nowhere base")]


def path_that_skips_a_node(s: Scene) -> None:
    s.routes["scout"][1]["path"] = ["base", "b"]


def path_from_elsewhere(s: Scene) -> None:
    s.routes["scout"][2]["path"] = ["a", "h"]


def against_a_one_way(s: Scene) -> None:
    s.routes["scout"][2]["path"] = ["a", "out", "base"]


def over_a_closed_edge(s: Scene) -> None:
    s.routes["scout"][1]["path"] = ["base", "out", "home", "out", "a"]


def dear_path(s: Scene) -> None:
    s.routes["scout"][1]["path"] = ["base", "a"]


def energy_without_the_load(s: Scene) -> None:
    s.routes["scout"][2]["leg_energy_j"] = 10.0
    _change_objective(s, "energy_j", 10.0)


def departs_before_it_is_there(s: Scene) -> None:
    s.routes["scout"][1]["depart_s"] = 33.0


def arrives_too_soon(s: Scene) -> None:
    s.routes["scout"][1]["arrive_s"] = 31.0


def arrives_within_its_service(s: Scene) -> None:
    s.routes["carrier"][1]["arrive_s"] = 50.0


def budget_too_small(s: Scene) -> None:
    s.team("scout")["energy_budget_j"] = 69.0


def energy_left_too_small(s: Scene) -> None:
    s.begin("carrier")["energy_left_j"] = 169.0


ROUTES: list[tuple[Callable[[], Scene], Change, set[str]]] = [
    (mid_route, begins_elsewhere, {"eq:start"}),
    (residual, begins_behind_the_state, {"eq:start"}),
    (dead_drop, back_into_the_start, {"eq:start"}),
    (dead_drop, departs_before_service, {"eq:start_time"}),
    (residual, departs_before_it_is_ready, {"eq:start_time"}),
    (dead_drop, first_stop_with_a_leg, {"format:stop"}),
    (dead_drop, stop_without_arrival, {"format:stop"}),
    (dead_drop, node_twice, {"eq:visit_terminal"}),
    (dead_drop, ends_in_the_field, {"eq:terminal_select"}),
    # It also unloads at base, where it may not.
    (mid_route, ends_at_a_strange_depot, {"eq:terminal_select", "eq:unload_bound"}),
    (one_way, stops_at_a_via_node, {"subsec:routing"}),
    (mid_route, depot_to_its_own_copy, {"subsec:routing"}),
    (dead_drop, unknown_node, {"format:names"}),
    (dead_drop, path_that_skips_a_node, {"format:path"}),
    (dead_drop, path_from_elsewhere, {"format:path"}),
    (one_way, against_a_one_way, {"format:path"}),
    (one_way, over_a_closed_edge, {"format:path"}),
    (one_way, dear_path, {"subsec:setting"}),
    (dead_drop, energy_without_the_load, {"format:leg_energy"}),
    (dead_drop, departs_before_it_is_there, {"eq:time_propagation"}),
    (dead_drop, arrives_too_soon, {"format:arrival"}),
    (dead_drop, arrives_within_its_service, {"format:arrival"}),
    (dead_drop, budget_too_small, {"eq:energy_budget"}),
    (residual, energy_left_too_small, {"eq:energy_budget"}),
]

# Custody ------------------------------------------------------------------------------------------------


def samples_at_a_depot(s: Scene) -> None:
    s.routes["scout"][2] |= {"collect": 1, "unload": 2}


def too_many_samples(s: Scene) -> None:
    s.routes["scout"][1]["collect"] = 2
    s.routes["scout"][-1]["unload"] = 1


def samples_again_what_it_took(s: Scene) -> None:
    s.begin("carrier")["collected"]["h"] = 2
    s.routes["carrier"][1]["collect"] = 1
    s.routes["carrier"][2]["unload"] = 3
    s.begin("carrier")["energy_left_j"] = 300.0


def samples_where_nothing_is_to_be_had(s: Scene) -> None:
    assert s.state is not None
    s.state["barren"] = ["h"]
    s.routes["carrier"][1]["collect"] = 1
    s.routes["carrier"][2]["unload"] = 3
    s.begin("carrier")["energy_left_j"] = 300.0


def unloads_in_the_field(s: Scene) -> None:
    s.routes["carrier"][2:] = [stop("a", "h a", unload=1), stop("base", "a base", unload=1)]


def unloads_at_a_strange_depot(s: Scene) -> None:
    s.team("scout")["depots"] = ["base"]


def unloads_more_than_it_can_carry(s: Scene) -> None:
    s.begin("idle")["on_board"] = 3
    s.routes["idle"][0]["unload"] = 3


def sample_lost(s: Scene) -> None:
    s.routes["carrier"][-1] |= {"unload": 1, "payload": 0}


def sample_kept(s: Scene) -> None:
    s.routes["carrier"][-1]["unload"] = 1


def unloads_what_it_picked_just_now(s: Scene) -> None:
    _depot_at(s, "h", "carrier")
    s.routes["carrier"][1] |= {"collect": 0, "unload": 1}
    s.routes["carrier"][2]["unload"] = 0


def _depot_at(s: Scene, node: str, robot_id: str) -> None:
    next(entry for entry in s.mission["site"]["nodes"] if entry["id"] == node)["role"] = "depot"
    s.team(robot_id)["depots"] = ["base", node]


def holds_too_much_within_a_stop(s: Scene) -> None:
    s.team("scout")["payload_capacity"] = 1
    s.routes["scout"][2]["collect"] = 1
    s.routes["scout"][3]["unload"] = 1


def drops_more_than_it_can_hold(s: Scene) -> None:
    s.team("scout").update(payload_capacity=1, samples_per_node=2, energy_budget_j=200.0)
    s.routes["scout"][1:3] = [stop("h", "base a h", collect=2, drop={"carrier": 2})]
    s.routes["carrier"][1] |= {"collect": 0, "pick": {"scout": 2}}


def picks_more_than_it_can_hold(s: Scene) -> None:
    s.team("carrier")["payload_capacity"] = 1
    _unloads_in_two_parts(s)


def _unloads_in_two_parts(s: Scene) -> None:
    """Let the carrier leave no more than one sample at a time, lest it break eq:unload_bound."""
    _depot_at(s, "a", "carrier")
    s.routes["carrier"][2:] = [stop("a", "h a", unload=1), stop("base", "a base", unload=1)]


def carries_too_much(s: Scene) -> None:
    del s.routes["scout"][1:]
    s.routes["carrier"][1] = stop("h", "base a h", collect=2)
    picks_more_than_it_can_hold(s)


def hands_over_more_than_the_receiver_can_hold(s: Scene) -> None:
    s.team("carrier")["payload_capacity"] = 1
    s.team("scout")["samples_per_node"] = 2
    s.routes["scout"][1]["collect"] = 2
    s.routes["scout"][2]["drop"] = {"carrier": 2}
    s.routes["carrier"][1] |= {"collect": 0, "pick": {"scout": 2}}
    _unloads_in_two_parts(s)


def drops_for_one_who_does_not_come(s: Scene) -> None:
    s.routes["scout"][2]["drop"] = {"idle": 1}
    del s.routes["carrier"][1]["pick"]
    s.routes["carrier"][2]["unload"] = 1


def picks_from_one_who_does_not_come(s: Scene) -> None:
    s.routes["carrier"][1]["pick"] = {"scout": 1, "idle": 1}
    s.routes["carrier"][2]["unload"] = 3


def drop_left_lying(s: Scene) -> None:
    del s.routes["carrier"][1]["pick"]
    s.routes["carrier"][2]["unload"] = 1


def picks_more_than_was_dropped(s: Scene) -> None:
    s.routes["carrier"][1]["pick"] = {"scout": 2}
    s.routes["carrier"][2]["unload"] = 3


def picks_more_than_is_cached(s: Scene) -> None:
    s.begin("carrier")["energy_left_j"] = 300.0
    picks_more_than_was_dropped(s)


def picks_from_nobody_known(s: Scene) -> None:
    s.routes["carrier"][1]["pick"] = {"scout": 1, "ghost": 1}
    s.routes["carrier"][2]["unload"] = 3


def cache_left_lying(s: Scene) -> None:
    drop_left_lying(s)


def fetched_too_early(s: Scene) -> None:
    s.routes["carrier"][1]["depart_s"] = 50.0


def picked_before_the_clearance_is_over(s: Scene) -> None:
    s.routes["carrier"][1]["depart_s"] = 50.0


def both_ways_at_one_node(s: Scene) -> None:
    # Without service and clearance both may depart at the same time, which keeps the timing of either drop.
    s.mission["team"] |= {"service_time_s": 0.0, "clearance_s": 0.0}
    s.routes["scout"][2] |= {"pick": {"carrier": 1}, "depart_s": 40.0}
    s.routes["scout"][3]["unload"] = 1
    s.routes["carrier"][1] |= {"drop": {"scout": 1}, "depart_s": 40.0}
    s.routes["carrier"][2]["unload"] = 1


def hands_over_at_its_terminal(s: Scene) -> None:
    s.routes["scout"] = [stop("base"), stop("b", "base a h b", collect=1),
                         stop("base", "b h a base", drop={"carrier": 1})]  # fmt: skip
    s.routes["carrier"] = [stop("base", pick={"scout": 1}, depart_s=80.0), stop("base", "base", unload=1)]


def hands_over_to_itself(s: Scene) -> None:
    s.routes["carrier"][1] |= {"collect": 2, "drop": {"carrier": 1}}


CUSTODY: list[tuple[Callable[[], Scene], Change, set[str]]] = [
    (mid_route, samples_at_a_depot, {"eq:sampling_visit"}),
    (dead_drop, too_many_samples, {"eq:sampling_visit"}),
    (residual, samples_again_what_it_took, {"eq:sampling_visit"}),
    (residual, samples_where_nothing_is_to_be_had, {"eq:sampling_visit"}),
    (dead_drop, unloads_in_the_field, {"eq:unload_bound"}),
    (mid_route, unloads_at_a_strange_depot, {"eq:unload_bound"}),
    (residual, unloads_more_than_it_can_carry, {"eq:unload_bound"}),
    (dead_drop, sample_lost, {"eq:conservation"}),
    (dead_drop, sample_kept, {"eq:conservation"}),
    (dead_drop, unloads_what_it_picked_just_now, {"eq:source_feasibility"}),
    (dead_drop, holds_too_much_within_a_stop, {"eq:cap_feasibility"}),
    # What is dropped was held (eq:source_feasibility), so either that or eq:cap_feasibility breaks as well;
    # and one receiver of more than K_r gets more than min(K_r, K_r').
    (
        dead_drop,
        drops_more_than_it_can_hold,
        {"eq:handoff_capacity", "eq:cap_feasibility", "eq:delta_amount"},
    ),
    # Given eq:conservation, eq:receiver_capacity says of a stop with picks what eq:payload says of its leg,
    (dead_drop, picks_more_than_it_can_hold, {"eq:receiver_capacity", "eq:payload"}),
    # and eq:cap_feasibility implies eq:payload for one without.
    (dead_drop, carries_too_much, {"eq:payload", "eq:cap_feasibility"}),
    # More than the receiver's capacity in one handoff is more than its room, and than it may drive with.
    (
        dead_drop,
        hands_over_more_than_the_receiver_can_hold,
        {"eq:delta_amount", "eq:receiver_capacity", "eq:payload"},
    ),
    (dead_drop, drops_for_one_who_does_not_come, {"eq:delta_visits"}),
    (dead_drop, picks_from_one_who_does_not_come, {"eq:delta_visits"}),
    (dead_drop, drop_left_lying, {"format:pairs"}),
    (dead_drop, picks_more_than_was_dropped, {"format:pairs"}),
    (residual, picks_more_than_is_cached, {"format:pairs"}),
    (dead_drop, picks_from_nobody_known, {"format:names"}),
    (residual, cache_left_lying, {"format:caches"}),
    (residual, fetched_too_early, {"format:available"}),
    (dead_drop, picked_before_the_clearance_is_over, {"eq:deaddrop_sync"}),
    (dead_drop, both_ways_at_one_node, {"eq:no_mutual"}),
    (dead_drop, hands_over_at_its_terminal, {"subsec:custody"}),
    (dead_drop, hands_over_to_itself, {"subsec:custody"}),
]

BROKEN = WHOLE + ROUTES + CUSTODY


@pytest.mark.parametrize(
    ("scene", "change", "rules"), BROKEN, ids=[f"{s.__name__}-{c.__name__}" for s, c, _ in BROKEN]
)
def test_a_plan_that_breaks_a_rule_is_found_out(
    scene: Callable[[], Scene], change: Change, rules: set[str]
) -> None:
    changed = scene()
    change(changed)
    mission, plan, state = changed.build()
    found = verify(mission, plan, state)
    assert {violation.rule for violation in found} == rules, [str(violation) for violation in found]


def test_every_rule_has_a_plan_that_breaks_it() -> None:
    modules = (import_module(verify.__module__), verify_custody, verify_routes)
    source = "".join(inspect.getsource(module) for module in modules)
    known = set(re.findall(r'"((?:eq|format|subsec):\w+)"', source))
    assert known == set().union(*(rules for _, _, rules in BROKEN))


# Things that are allowed --------------------------------------------------------------------------------


def test_no_routes_and_a_reason_is_all_an_infeasible_mission_needs() -> None:
    scene = dead_drop()
    scene.plan = {"status": "infeasible", "reason": "too far", "objective": None, "robots": []}
    assert verify(*scene.build()) == []
    scene.plan = {"status": "no_plan", "objective": None, "robots": []}
    assert verify(*scene.build()) == []


def test_a_proven_optimum_holds_with_a_rounded_gap() -> None:
    scene = dead_drop()
    _, plan, _ = scene.build()
    assert plan.objective is not None
    bound = plan.objective.information * (1 - 2e-5)
    scene.plan = {"status": "optimal", "bound": {"information": bound}, "gap": 0.0}
    assert verify(*scene.build()) == []


def test_a_robot_may_pick_at_its_start_and_go_straight_to_the_terminal_copy() -> None:
    scene = residual()
    assert scene.state is not None
    scene.state["caches"] = [{"node": "base", "sender": "scout", "count": 2, "available_s": 10.0}]
    del scene.routes["carrier"][1]["pick"]
    scene.routes["carrier"][2]["unload"] = 1
    scene.routes["idle"] = [stop("base", pick={"scout": 2}, depart_s=12.0), stop("base", "base", unload=2)]
    assert verify(*scene.build()) == []


def test_a_robot_may_fetch_what_it_left_itself() -> None:
    scene = residual()
    del scene.routes["carrier"][1]["pick"]
    scene.routes["carrier"][2]["unload"] = 1
    scene.routes["scout"][0] |= {"pick": {"scout": 1}, "depart_s": 51.0}
    scene.routes["scout"][1]["unload"] = 1
    scene.begin("scout")["energy_left_j"] = 40.0
    assert verify(*scene.build()) == []


def test_two_caches_at_one_node_may_be_fetched_one_after_the_other() -> None:
    scene = residual()
    assert scene.state is not None
    scene.state["caches"].append({"node": "h", "sender": "scout", "count": 1, "available_s": 90.0})
    scene.begin("idle")["energy_left_j"] = 60.0
    late = stop("h", "base a h", pick={"scout": 1}, depart_s=92.0)
    scene.routes["idle"] = [stop("base"), late, stop("base", "h a base", unload=1)]
    assert verify(*scene.build()) == []
    late["depart_s"] = 91.0
    assert {violation.rule for violation in verify(*scene.build())} == {"format:available"}


def test_a_robot_may_leave_what_it_has_on_board_at_the_depot_where_it_stays() -> None:
    scene = residual()
    scene.begin("idle")["on_board"] = 2
    scene.routes["idle"][0]["unload"] = 2
    assert verify(*scene.build()) == []


def test_the_error_is_one_line_with_the_first_fault_and_the_number_of_others() -> None:
    scene = dead_drop()
    holds_too_much_within_a_stop(scene)
    scene.plan["mission"] = "another"
    mission, plan, state = scene.build()
    with pytest.raises(PlanError) as caught:
        check(mission, plan, state)
    assert str(caught.value) == (
        "the plan breaks format:mission: the plan is for another, not small (and 1 more)"
    )
