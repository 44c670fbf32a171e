"""A whole plan under check: ground, energy, times, people, links. Each rule finds its fault, and only it."""

from __future__ import annotations

from typing import Any

import pytest
from check_cases import BY_OUTPUTS, SERVO, changed, of_rule, rules, with_vehicles
from vehicle_cases import handoff_plan, plan_of, small_mission, stop

from malipp_field.errors import PlanError
from malipp_field.mission import Mission, RobotState, TeamState, initial_state
from malipp_field.plan import Plan
from malipp_field.vehicle.check import check, way_findings
from malipp_field.vehicle.compile import Custody, compile_plan
from malipp_field.vehicle.finding import Finding
from malipp_field.vehicle.items import MissionItem, degrees_e7
from malipp_field.vehicle.layout import lay_out

START_S = 1_800_000_000.0  # 2027-01-15 08:00:00 UTC
LINKED: dict[str, dict[str, Any]] = {
    robot: {"link": f"udpin:0.0.0.0:{port}", "signing_key": "keys/team.key"}
    for port, robot in enumerate(("scout", "scout2", "carrier"), start=14550)
}
MISSION = with_vehicles(**LINKED)


def linked(robot: str, **entries: Any) -> Mission:
    return with_vehicles(**{**LINKED, robot: LINKED[robot] | entries})


def items_of(robot: str, plan: Plan | None = None) -> list[MissionItem]:
    return lay_out(compile_plan(MISSION, plan or handoff_plan()).missions[robot]).items


def only(findings: list[Finding], rule: str) -> Finding:
    (found,) = of_rule(findings, rule)
    return found


def test_a_sound_plan_has_only_notes() -> None:
    assert rules(check(MISSION, handoff_plan()), "error", "warning") == set()
    note = only(check(MISSION, handoff_plan()), "custody-gates")
    assert (note.severity, note.robot, note.where) == ("note", "carrier", "hub")


def test_findings_come_robot_by_robot_the_team_first() -> None:
    mission = changed(small_mission(), planner={"energy_reserve": 0.999})
    robots = [finding.robot for finding in check(mission, handoff_plan())]
    assert robots == sorted(robots, key=[None, "scout", "scout2", "carrier"].index)
    assert set(robots) >= {None, "scout", "carrier"}


# ground


def test_a_leg_across_a_keep_out() -> None:
    pit = {"id": "puddle", "polygon": [{"x_m": x, "y_m": y} for x, y in ((44, 29), (46, 29), (45, 32))]}
    mission = changed(MISSION, site={"keep_outs": [pit]})
    found = check(mission, handoff_plan())
    crossing = of_rule(found, "keep-out-crossing")
    assert {(f.robot, f.item) for f in crossing} == {("scout", 5), ("carrier", 1), ("carrier", 5)}
    assert "from a crosses keep-out 'puddle'" in crossing[0].problem
    assert "hub" in crossing[0].where


def test_touching_a_keep_out_or_the_fence_is_allowed() -> None:
    """The way from base to the hub is the edge of both."""
    below = [{"x_m": x, "y_m": y} for x, y in ((0, 0), (60, 40), (60, -60))]
    above = [{"x_m": x, "y_m": y} for x, y in ((0, 0), (60, 40), (0, 60))]
    plan = plan_of({"carrier": [stop("base", 0.0), stop("hub", 9.0, path=("base", "hub"))]})
    sites: list[dict[str, Any]] = [{"keep_outs": [{"id": "below", "polygon": below}]}, {"fence": above}]
    for site in sites:
        assert "keep-out-crossing" not in rules(check(changed(MISSION, site=site), plan))
        assert "fence-crossing" not in rules(check(changed(MISSION, site=site), plan))


def test_a_way_out_of_the_fence() -> None:
    """All stops are inside of this horseshoe, the straight way between two of them is not."""
    corners = ((-10, -10), (40, -10), (40, 30), (50, 30), (50, -30), (210, -30), (210, 90), (-10, 90))
    mission = changed(MISSION, site={"fence": [{"x_m": x, "y_m": y} for x, y in corners]})
    plan = plan_of({"scout": [stop("base", 0.0), stop("b", 9.0, path=("base", "b"))]})
    leaving = only(check(mission, plan), "fence-crossing")
    assert (leaving.robot, leaving.item, leaving.where) == ("scout", 1, "b")
    assert leaving.problem == "the straight way from base leaves the fence"
    inside = plan_of({"scout": [stop("base", 0.0), stop("a", 9.0, path=("base", "a"))]})
    assert "fence-crossing" not in rules(check(mission, inside))


def test_a_depot_out_of_bounds() -> None:
    corners = ((-10, -40), (150, -40), (150, 90), (-10, 90))
    mission = changed(MISSION, site={"fence": [{"x_m": x, "y_m": y} for x, y in corners]})
    outside = of_rule(check(mission, handoff_plan()), "depot-outside")
    assert {finding.where for finding in outside} == {"yard"}
    keep_out = {"id": "shed", "polygon": [{"x_m": x, "y_m": y} for x, y in ((190, -9), (210, -9), (200, 20))]}
    inside = of_rule(check(changed(MISSION, site={"keep_outs": [keep_out]}), handoff_plan()), "depot-outside")
    assert "lies in keep-out 'shed'" in inside[0].problem


def test_a_mission_from_elsewhere_is_measured_from_its_home() -> None:
    items = items_of("carrier")
    assert way_findings(MISSION, "carrier", items) == []
    shifted = [items[0]._replace(x=items[0].x + degrees_e7(0.01)), *items[1:]]
    found = way_findings(MISSION, "carrier", shifted)
    assert rules(found) == {"home-off", "far-from-home"}
    assert "home is 1113 m from" in only(found, "home-off").problem
    near = [items[0]._replace(x=items[0].x + degrees_e7(0.0001)), *items[1:]]
    assert way_findings(MISSION, "carrier", near) == []


def test_the_way_back_to_launch_counts() -> None:
    pit = {"id": "puddle", "polygon": [{"x_m": x, "y_m": y} for x, y in ((40, -20), (46, 25), (48, -20))]}
    mission = changed(MISSION, site={"keep_outs": [pit]})
    plan = plan_of({"scout": [stop("base", 0.0), stop("a", 9.0, path=("base", "a"))]})
    there = items_of("scout", plan)
    assert way_findings(mission, "scout", there) == []
    yard = items_of(
        "scout", plan_of({"scout": [stop("base", 0.0), stop("yard", 9.0, path=("base", "yard"))]})
    )
    back = [there[0], there[1], yard[1]._replace(seq=2, command=20, frame=2, x=0, y=0)]
    assert way_findings(mission, "scout", back) == []
    round_trip = [there[0], yard[1], yard[1]._replace(seq=2, command=20, frame=2, x=0, y=0)]
    assert [finding.item for finding in way_findings(mission, "scout", round_trip)] == [1, 2]


def test_a_replan_begins_where_the_vehicle_is() -> None:
    """The straight way from home to the first waypoint crosses the pit; the vehicle stands beyond it."""
    pit = {"id": "pit", "polygon": [{"x_m": x, "y_m": y} for x, y in ((20, -30), (30, 30), (25, -30))]}
    mission = changed(MISSION, site={"keep_outs": [pit]})
    plan = plan_of({"scout": [stop("c", 0.0), stop("yard", 9.0, path=("c", "yard"))]}, version=2)
    assert "keep-out-crossing" not in rules(check(mission, plan))
    at_base = plan_of({"scout": [stop("base", 0.0), stop("yard", 9.0, path=("base", "yard"))]})
    assert "keep-out-crossing" in rules(check(mission, at_base))


# energy


def lone_route(*nodes: str, loads: tuple[int, ...]) -> Plan:
    """Return a plan of the scout through these nodes, carrying so much from each on."""
    stops = [stop(nodes[0], 0.0, loads[0])]
    stops += [
        stop(node, 9.0 * i, load, path=(nodes[i - 1], node), collect=max(0, load - loads[i - 1]))
        for i, (node, load) in enumerate(zip(nodes[1:], loads[1:], strict=True), start=1)
    ]
    stops[-1] = stops[-1].model_copy(update={"unload": loads[-2]})
    return plan_of({"scout": stops})


def with_budget(energy_j: float, **planner: Any) -> Mission:
    robots = [
        robot.model_dump() | {"energy_budget_j": energy_j, "depots": ["base"]}
        for robot in small_mission().team.robots
    ]
    return changed(MISSION, team={"robots": robots}, planner=planner)


# base to c and back are 92.2 m each way, at 2 J per kg and m: 40 J/m empty (20 kg), 44 J/m with two samples
OUT_J, BACK_J = 92.195 * 40.0, 92.195 * 44.0


def test_the_energy_of_the_legs_with_what_is_on_board() -> None:
    plan = lone_route("base", "c", "base", loads=(0, 2, 0))
    short = only(check(with_budget(OUT_J + BACK_J - 50.0), plan), "way-home")
    assert (short.severity, short.robot, short.where) == ("error", "scout", "stop 1 at c")
    assert "with 2 on board the way to a depot takes 4.06 kJ, there are 4.01 kJ" in short.problem
    assert rules(check(with_budget(OUT_J + BACK_J + 1.0), plan), "error") == set()


def test_a_stop_from_which_only_the_plan_leads_home() -> None:
    """With three on board the way home is too dear; the plan leaves them at b, for a teammate."""
    route = [
        stop("base", 0.0),
        stop("c", 9.0, 3, path=("base", "c"), collect=3),
        stop("b", 19.0, 0, path=("c", "b"), drop={"carrier": 3}),
        stop("base", 29.0, path=("b", "base")),
    ]
    fetch = [
        stop("base", 0.0),
        stop("b", 39.0, 3, path=("base", "b"), pick={"scout": 3}),
        stop("base", 49.0, path=("b", "base"), unload=3),
    ]
    plan = plan_of({"scout": route, "carrier": fetch})
    heavy = changed(with_budget(0.0), team={"sample_mass_kg": 10.0})
    budget_j = 92.195 * 40 + 50.0 * 100 + 63.246 * 40 + 1.0
    robots = [robot.model_dump() for robot in heavy.team.robots]
    robots[0]["energy_budget_j"] = budget_j
    robots[2]["energy_budget_j"] = 1e6
    found = check(changed(heavy, team={"robots": robots}), plan)
    assert rules(found, "error") == set()
    stuck = only(found, "turning-home")
    assert (stuck.severity, stuck.where) == ("warning", "stop 1 at c")
    assert "cannot be called home from here: with 3 on board" in stuck.problem
    robots[0]["energy_budget_j"] = 92.195 * 140 + 1.0
    assert "turning-home" not in rules(check(changed(heavy, team={"robots": robots}), plan))


def test_the_reserve_is_measured_at_every_stop() -> None:
    plan = lone_route("base", "c", "base", loads=(0, 2, 0))
    used_j = OUT_J + BACK_J
    enough, scarce = used_j / 0.89, used_j / 0.91
    assert "reserve" not in rules(check(with_budget(enough, energy_reserve=0.1), plan))
    warning = only(check(with_budget(scarce, energy_reserve=0.1), plan), "reserve")
    assert warning.severity == "warning"
    assert "the reserve (10 %) is" in warning.problem
    # without a reserve of the planner's, that of replans
    assert "reserve" not in rules(check(with_budget(used_j / 0.94), plan))
    assert "the reserve (5 %)" in only(check(with_budget(used_j / 0.96), plan), "reserve").problem


def test_a_mission_part_way_has_the_energy_that_is_left() -> None:
    plan = lone_route("c", "base", loads=(2, 0))
    mission = with_budget(50_000.0, energy_reserve=0.9)
    begin = initial_state(mission)

    def left(energy_j: float) -> TeamState:
        scout = RobotState(id="scout", node="c", energy_left_j=energy_j, on_board=2)
        return begin.model_copy(update={"robots": (scout, *begin.robots[1:])})

    custody = Custody({"scout": (1, 2)}, {}, next_tag=3)
    assert "way-home" in rules(check(mission, plan, custody=custody, state=left(BACK_J - 10.0)))
    found = rules(check(mission, plan, custody=custody, state=left(BACK_J / 0.97)))
    assert "reserve" in found
    assert "way-home" not in found
    assert "reserve" not in rules(check(mission, plan, custody=custody, state=left(BACK_J / 0.94)))


def test_only_authorised_depots_count() -> None:
    plan = lone_route("base", "c", "base", loads=(0, 2, 0))
    open_to_all = small_mission().team.robots[0].model_dump() | {"energy_budget_j": OUT_J + BACK_J + 1.0}
    yard_only = open_to_all | {"depots": ["yard"]}
    assert "turning-home" not in rules(
        check(changed(MISSION, team={"robots": [open_to_all]}, vehicles={}), plan)
    )
    assert "turning-home" in rules(check(changed(MISSION, team={"robots": [yard_only]}, vehicles={}), plan))


def test_an_edge_that_may_not_be_driven() -> None:
    closed = [{"from": "base", "to": "hub", "one_way": True, "closed_to": ["carrier"]}]
    fault = only(check(changed(MISSION, site={"edges": closed}), handoff_plan()), "no-way")
    assert (fault.severity, fault.robot, fault.where) == ("error", "carrier", "stop 1 at hub")
    assert fault.problem == "carrier may not drive from base to hub"


def test_an_edge_longer_than_the_straight_way() -> None:
    """From base to the hub it is 72 m."""
    for length_m, found in ((72.2, 0), (75.0, 0), (110.0, 1), (50.0, 1)):
        mission = changed(MISSION, site={"edges": [{"from": "base", "to": "hub", "length_m": length_m}]})
        bent = of_rule(check(mission, handoff_plan()), "not-straight")
        assert [(f.robot, f.severity) for f in bent] == [("carrier", "warning")] * found
    assert "the straight way driven is 72 m" in bent[0].problem


# times and people


def test_actions_longer_than_the_service_time() -> None:
    mission = linked("scout", payload={"collect": SERVO})
    timed = changed(mission, team={"service_time_s": 20.0})
    late = only(check(timed, handoff_plan()), "service-time")
    assert (late.severity, late.robot, late.where) == ("warning", "scout", "stop 1 at a")
    assert "take 40 s, the plan gives a stop 20 s; in all the robot loses 20 s" in late.problem
    assert "set team.service_time_s to 40" in late.remedy
    assert "service-time" not in rules(check(changed(mission, team={"service_time_s": 40.0}), handoff_plan()))


TIME_GATE = {"gate": "time", "gate_margin_s": 60.0}


def handoff_at(**times: float) -> Plan:
    """Return the handoff with other times of the carrier's stop at the hub."""
    plan = handoff_plan()
    *others, carrier = plan.robots
    start, hub, end = carrier.route
    route = (start, hub.model_copy(update=times), end)
    return plan.model_copy(update={"robots": (*others, carrier.model_copy(update={"route": route}))})


def test_a_gate_that_a_vehicle_without_script_may_miss() -> None:
    bare = linked("carrier", **TIME_GATE, payload=BY_OUTPUTS)
    late = only(check(bare, handoff_plan(), START_S), "gate-late")
    assert (late.severity, late.item, late.where) == ("warning", 2, "gate at hub")
    assert "opens at 2027-01-15 08:03:10 UTC" in late.problem
    assert "by the plan it is 60 s early" in late.problem
    scripted = linked("carrier", **TIME_GATE)
    assert rules(check(scripted, handoff_plan(), START_S)) == set()
    assert "gate-late" not in rules(check(bare, handoff_plan()))


def test_time_gates_want_to_know_the_start() -> None:
    found = only(check(linked("carrier", **TIME_GATE), handoff_plan()), "gates-unknown")
    assert (found.severity, found.robot) == ("warning", "carrier")
    assert "gates-unknown" not in rules(check(linked("scout", **TIME_GATE), handoff_plan()))


@pytest.mark.parametrize(("payload", "hours"), [("script", 11), (BY_OUTPUTS, 23)], ids=["script", "outputs"])
def test_a_gate_too_far_ahead_is_refused(payload: Any, hours: int) -> None:
    def waiting(seconds: float) -> list[Finding]:
        plan = handoff_at(arrive_s=130.0, depart_s=130.0 + seconds)
        mission = linked("carrier", gate="time", gate_margin_s=0.0, payload=payload)
        return check(mission, plan, START_S)

    with pytest.raises(PlanError, match=f"the time of day tells at most {hours} h"):
        waiting(hours * 3600.0 + 60.0)
    assert "error" not in {found.severity for found in waiting(hours * 3600.0 - 60.0)}


def test_a_gate_in_the_past() -> None:
    """Service windows of before the mission began are no plan's; a plan file may hold one."""
    past = handoff_at(arrive_s=-200.0, depart_s=-100.0)
    for payload, words in (("script", "does not wait at all"), (BY_OUTPUTS, "waits until the next day")):
        mission = linked("carrier", **TIME_GATE, payload=payload)
        fault = only(check(mission, past, START_S), "gate-past")
        assert (fault.severity, fault.item) == ("error", 2)
        assert words in fault.problem


def test_people_who_have_to_be_there() -> None:
    mission = linked("scout", payload={"collect": {"by": "manual"}, "drop": SERVO | {"confirm": "operator"}})
    note = only(check(mission, handoff_plan()), "operator")
    assert (note.severity, note.robot, note.where) == ("note", "scout", "a, hub")
    assert note.problem == "until a person confirms, the vehicle holds after 5 actions"
    assert "operator" not in rules(check(MISSION, handoff_plan()))


# links


def test_links_and_keys() -> None:
    team = check(small_mission(), handoff_plan())
    assert only(team, "no-link").where == "scout, scout2, carrier"
    found = check(linked("carrier", signing_key=None), handoff_plan())
    unsigned = only(found, "unsigned")
    assert (unsigned.severity, unsigned.robot, unsigned.where) == ("warning", None, "carrier")
    here = linked("carrier", signing_key=None, link="tcp:127.0.0.1:5760")
    assert rules(check(here, handoff_plan()), "warning") == set()


def test_vehicles_that_cannot_be_told_apart() -> None:
    same = only(check(linked("carrier", system_id=1), handoff_plan()), "system-id")
    assert same.severity == "error"
    assert same.problem == "system id 1 is that of scout and carrier"
    ours = only(check(linked("carrier", system_id=255), handoff_plan()), "system-id")
    assert "carrier and the ground station" in ours.problem


def test_the_storage_of_this_vehicle() -> None:
    full = only(check(linked("scout", max_items=8), handoff_plan()), "too-many-items")
    assert (full.severity, full.robot) == ("error", "scout")
    assert rules(check(linked("scout", max_items=12), handoff_plan()), "error") == set()
