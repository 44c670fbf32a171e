"""Where the team will be when a new plan can take effect, and what of the old plan is left then."""

from __future__ import annotations

from dataclasses import replace

import pytest
from control_cases import MISSION, compiled, confirm, drop_plan, relay_mission, relay_plan, telemetry

from malipp_field.control.experience import Experience
from malipp_field.control.ledger import CustodyLedger
from malipp_field.control.lookahead import LookAhead, Outlook, Roads, Whereabouts
from malipp_field.control.remainder import remainder
from malipp_field.control.revision import revise, same_work
from malipp_field.control.tracks import Measured, Track
from malipp_field.mission import Mission, parse_mission
from malipp_field.mission.vehicles import VehicleSettings
from malipp_field.plan import Plan, RobotPlan
from malipp_field.vehicle.steps import Action, VehicleMission


def at(
    mission: VehicleMission, action: Action, node: str, x_m: float, used_j: float = 0.0, last: str = "hub"
) -> Whereabouts:
    index = next(i for i, s in enumerate(mission.steps) if s.action is action and s.node == node)
    return Whereabouts(mission, index, last, x_m, 0.0, used_j)


def look(
    plan: Plan,
    horizon_s: float,
    scout: Whereabouts,
    carrier: Whereabouts,
    ledger: CustodyLedger,
    known: Roads | None = None,
) -> Outlook:
    mission = relay_mission()
    roads = Roads(mission)
    lookahead = LookAhead(mission, roads, known or roads, horizon_s)
    return lookahead.outlook(50.0, {"scout": scout, "carrier": carrier}, ledger)


def test_the_leg_in_progress_is_committed_and_costed_from_where_the_vehicle_is() -> None:
    missions, ledger = compiled(relay_plan())
    scout = at(missions["scout"], Action.DRIVE, "gate", x_m=120.0, used_j=200.0)
    carrier = Whereabouts(missions["carrier"], 0, "base", 0.0, 0.0, 0.0)
    found = look(relay_plan(), 1.0, scout, carrier, ledger)
    state = found.state.robot("scout")
    assert (state.node, state.on_board, state.collected) == ("gate", 0, {})
    assert state.ready_s == pytest.approx(50.0 + 30.0)  # 30 m left at 1 m/s
    assert state.energy_left_j == pytest.approx(10000.0 - 200.0 - 30.0 * 10.0)
    assert [s.node for s in found.committed["scout"]] == ["gate"]
    assert found.diverges_at["scout"] == missions["scout"].steps[1].uid
    assert found.state.robot("carrier").node == "base"
    assert found.diverges_at["carrier"] is None


def test_a_longer_horizon_commits_the_stop_ahead_with_its_samples() -> None:
    missions, ledger = compiled(relay_plan())
    scout = at(missions["scout"], Action.DRIVE, "gate", x_m=120.0)
    carrier = Whereabouts(missions["carrier"], 0, "base", 0.0, 0.0, 0.0)
    found = look(relay_plan(), 85.0, scout, carrier, ledger)
    state = found.state.robot("scout")
    assert state.node == "far"
    assert state.on_board == 2
    assert state.collected == {"far": 2}
    assert state.ready_s == pytest.approx(50.0 + 30.0 + 50.0 + 10.0)
    assert found.on_board["scout"] == (1, 2)


def test_a_gate_ends_the_committed_part_whether_its_containers_lie_there_or_not() -> None:
    missions, ledger = compiled(drop_plan())
    carrier = at(missions["carrier"], Action.WAIT, "far", x_m=200.0, last="far")
    gate = next(s for s in missions["carrier"].steps if s.action is Action.WAIT)
    (dropped,) = gate.tags
    scout = at(missions["scout"], Action.DRIVE, "far", x_m=180.0, last="gate")
    for action, tags in ((None, ()), (Action.COLLECT, (1, 2)), (Action.DROP, (dropped,))):
        for tag in tags:
            assert action is not None
            assert ledger.confirm(confirm("scout", action, tag, "far")) is None
        if ledger.on_board("scout"):
            scout = at(missions["scout"], Action.DRIVE, "gate", x_m=190.0, last="far")
        found = look(drop_plan(), 12.0, scout, carrier, ledger)
        assert found.committed["carrier"] == ()
        assert found.diverges_at["carrier"] == gate.uid
        assert found.state.robot("carrier").node == "far"
        assert found.state.robot("carrier").ready_s == 50.0 + 12.0, "no new plan is in force before"
    (cache,) = found.state.caches
    assert (cache.count, cache.available_s) == (1, 50.0 + 5.0)
    assert found.caches == {("far", "scout"): (dropped,)}


def test_a_vehicle_that_crawls_may_be_out_of_the_sand_before_the_new_plan_comes() -> None:
    missions, ledger = compiled(relay_plan())
    crawling = Whereabouts(missions["scout"], 0, "hub", 145.0, 0.0, 0.0, time_ratio=5.0)
    carrier = Whereabouts(missions["carrier"], 0, "base", 0.0, 0.0, 0.0)
    found = look(relay_plan(), 13.0, crawling, carrier, ledger)
    assert [step.node for step in found.committed["scout"]] == ["gate", "far"]
    assert found.state.robot("scout").ready_s == pytest.approx(50.0 + 5 * 5.0 + 50.0)


def test_later_legs_of_the_committed_part_cost_what_was_found_on_them() -> None:
    mission = relay_mission()
    experience = Experience()
    experience.note(Measured("gate", "far", 2.0, 3.0), whole=True)
    missions, ledger = compiled(relay_plan())
    scout = at(missions["scout"], Action.DRIVE, "gate", x_m=140.0)
    carrier = Whereabouts(missions["carrier"], 0, "base", 0.0, 0.0, 0.0)
    known = Roads(experience.applied_to(mission))
    state = look(relay_plan(), 20.0, scout, carrier, ledger, known).state.robot("scout")
    assert state.node == "far"
    assert state.ready_s == pytest.approx(50.0 + 10.0 + 2 * 50.0)
    assert state.energy_left_j == pytest.approx(10000.0 - 10 * 10.0 - 3 * 50 * 10.0)


def left_for_the_carrier() -> tuple[Plan, Outlook, CustodyLedger, dict[str, VehicleMission]]:
    """The scout has dropped container 1 and is called home by a new plan, version 2."""
    mission = relay_mission()
    missions, ledger = compiled(drop_plan())
    for action, tag in ((Action.COLLECT, 1), (Action.COLLECT, 2), (Action.DROP, 1)):
        assert ledger.confirm(confirm("scout", action, tag, "far", time_s=float(tag))) is None
    scout = at(missions["scout"], Action.DRIVE, "gate", x_m=190.0, last="far")
    carrier = at(missions["carrier"], Action.DRIVE, "hub", x_m=10.0, last="base")
    outlook = look(drop_plan(), 1.0, scout, carrier, ledger)
    tracks = {robot: Track(mission, drop_plan().robot(robot), missions[robot]) for robot in missions}
    rest = remainder(drop_plan(), tracks, outlook)
    there = rest.robot("carrier").route[1].model_copy(update={"path": ("hub", "gate", "far")})
    home = rest.robot("carrier").route[2]
    routes = (
        rest.robot("scout").model_copy(update={"route": rest.robot("scout").route[:1]}),
        rest.robot("carrier").model_copy(update={"route": (rest.robot("carrier").route[0], there, home)}),
    )
    return rest.model_copy(update={"version": 2, "robots": routes}), outlook, ledger, missions


def test_a_container_in_a_cache_is_in_the_new_mission_under_its_own_tag() -> None:
    plan, outlook, ledger, missions = left_for_the_carrier()
    revision = revise(relay_mission(), plan, outlook, ledger, missions)
    assert set(revision.missions) == {"scout"}, "the carrier's part is what it was"
    assert [(s.action, s.tags) for s in revision.compiled["carrier"].steps if s.tags][:2] == [
        (Action.WAIT, (1,)),
        (Action.PICK, (1,)),
    ]
    ledger.expect(revision.samples.values())
    assert [(r.state, r.holder) for r in ledger.records.values()] == [
        ("cached", "far"),
        ("on_board", "scout"),
    ]


def test_new_missions_keep_the_hardware_and_gates_are_told_their_new_times() -> None:
    plan, outlook, ledger, missions = left_for_the_carrier()
    vehicles = {
        "scout": VehicleSettings.model_validate({"payload": "manual"}),
        "carrier": VehicleSettings.model_validate({"payload": "manual", "gate": "time"}),
    }
    mission = relay_mission().model_copy(update={"vehicles": vehicles})
    gate_s = 1000.0 + 135.0 - 10.0 + 30.0

    def told(not_before_s: float) -> dict[str, VehicleMission]:
        carrier = missions["carrier"]
        steps = tuple(
            step.model_copy(update={"not_before_s": not_before_s if step.action is Action.WAIT else None})
            for step in carrier.steps
        )
        return {**missions, "carrier": carrier.model_copy(update={"steps": steps})}

    kept = revise(mission, plan, outlook, ledger, told(gate_s), start_s=1000.0)
    assert set(kept.missions) == {"scout"}
    assert kept.missions["scout"].payload == mission.vehicle("scout").payload
    later = revise(mission, plan, outlook, ledger, told(gate_s - 60.0), start_s=1000.0)
    assert set(later.missions) == {"scout", "carrier"}
    (gate,) = (step for step in later.missions["carrier"].steps if step.action is Action.WAIT)
    assert gate.not_before_s == gate_s


def test_replan_after_replan_a_tag_is_kept_or_withdrawn_and_never_given_twice() -> None:
    mission = relay_mission()
    missions, ledger = compiled(drop_plan())
    scout = at(missions["scout"], Action.DRIVE, "gate", x_m=110.0)
    carrier = at(missions["carrier"], Action.DRIVE, "hub", x_m=10.0, last="base")
    for version, wanted, tags in ((2, 2, {1, 2}), (3, 1, {1}), (4, 2, {1, 3}), (5, 2, {1, 3})):
        outlook = look(drop_plan(), 1.0, scout, carrier, ledger)
        tracks = {robot: Track(mission, drop_plan().robot(robot), missions[robot]) for robot in missions}
        rest = remainder(drop_plan(), tracks, outlook)
        here, far, home = rest.robot("scout").route
        far = far.model_copy(
            update={"path": ("gate", "far"), "collect": wanted, "drop": {}, "payload": wanted}
        )
        home = home.model_copy(update={"unload": wanted})
        stay = rest.robot("carrier").route[0]
        robots = (RobotPlan(id="scout", route=(here, far, home)), RobotPlan(id="carrier", route=(stay,)))
        plan = rest.model_copy(update={"version": version, "robots": robots})
        revision = revise(mission, plan, outlook, ledger, missions)
        ledger.expect(revision.samples.values())
        assert {tag for tag, record in ledger.records.items() if record.state == "planned"} == tags
        assert set(revision.samples) == tags


def test_a_committed_drop_is_a_cache_from_its_end_and_the_clearance_on() -> None:
    missions, ledger = compiled(drop_plan())
    for tag in (1, 2):
        ledger.confirm(confirm("scout", Action.COLLECT, tag, "far"))
    scout = at(missions["scout"], Action.DROP, "far", x_m=200.0, last="far")
    carrier = at(missions["carrier"], Action.DRIVE, "hub", x_m=10.0, last="base")
    found = look(drop_plan(), 0.0, scout, carrier, ledger)
    (cache,) = found.state.caches
    assert (cache.node, cache.sender, cache.count) == ("far", "scout", 1)
    assert cache.available_s == pytest.approx(50.0 + 10.0 + 5.0)
    assert found.state.robot("scout").on_board == 1


def track_of(mission: Mission, robot: str, vehicle_mission: VehicleMission, uid: str | None) -> Track:
    track = Track(mission, drop_plan().robot(robot), vehicle_mission)
    track.update(telemetry(robot, uid, 0.0, 100.0, 0.0), Roads(mission), 0)
    return track


def test_the_remainder_begins_where_the_free_part_does() -> None:
    mission = relay_mission()
    missions, ledger = compiled(drop_plan())
    scout = at(missions["scout"], Action.DRIVE, "gate", x_m=120.0)
    carrier = at(missions["carrier"], Action.DRIVE, "hub", x_m=10.0, last="base")
    found = look(drop_plan(), 1.0, scout, carrier, ledger)
    tracks = {
        robot: track_of(mission, robot, vehicle_mission, vehicle_mission.steps[0].uid)
        for robot, vehicle_mission in missions.items()
    }
    rest = remainder(drop_plan(), tracks, found)
    assert [stop.node for stop in rest.robot("scout").route] == ["gate", "far", "base"]
    assert [stop.node for stop in rest.robot("carrier").route] == ["hub", "far", "base"]
    assert rest.robot("scout").route[1].drop == {"carrier": 1}


def test_the_remainder_of_a_plan_not_yet_begun_keeps_what_is_to_be_done_where_it_begins() -> None:
    mission = relay_mission()
    missions, ledger = compiled(drop_plan())
    outlook = look(
        drop_plan(),
        1.0,
        at(missions["scout"], Action.DRIVE, "gate", x_m=120.0),
        at(missions["carrier"], Action.DRIVE, "hub", x_m=10.0, last="base"),
        ledger,
    )
    for node, nodes in (("far", ["gate", "far", "base"]), ("gate", ["gate", "base"])):
        route = drop_plan().robot("scout").route
        begin = route[1].model_copy(update={"node": node})
        track = Track(mission, RobotPlan(id="scout", route=(begin, route[2])), missions["scout"])
        track.committed = 4
        tracks = {
            "scout": track,
            "carrier": Track(mission, drop_plan().robot("carrier"), missions["carrier"]),
        }
        rest = remainder(drop_plan(), tracks, outlook).robot("scout").route
        assert [stop.node for stop in rest] == nodes
        assert rest[-2].collect == 2
        assert rest[-2].drop == {"carrier": 1}


def test_a_stop_half_done_leaves_its_other_half() -> None:
    mission = relay_mission()
    missions, ledger = compiled(relay_plan())
    ledger.confirm(confirm("scout", Action.COLLECT, 1, "far"))
    steps = missions["scout"].steps
    second = next(i for i, s in enumerate(steps) if s.action is Action.COLLECT and s.tags == (2,))
    whereabouts = Whereabouts(missions["scout"], second, "far", 200.0, 0.0, 0.0)
    carrier = Whereabouts(missions["carrier"], 0, "base", 0.0, 0.0, 0.0)
    outlook = replace(
        look(relay_plan(), 0.0, whereabouts, carrier, ledger),
        committed={"scout": (), "carrier": ()},
        diverges_at={"scout": steps[second].uid, "carrier": None},
    )
    tracks = {r: Track(mission, relay_plan().robot(r), m) for r, m in missions.items()}
    here, home = remainder(relay_plan(), tracks, outlook).robot("scout").route
    assert (here.node, here.collect, home.node) == ("far", 1, "base")


@pytest.mark.parametrize("meanwhile", [(), (1,), (1, 2)])
def test_an_unchanged_plan_concerns_no_vehicle_and_keeps_the_tags(meanwhile: tuple[int, ...]) -> None:
    """Also of samples that are taken while the planner thinks."""
    mission = relay_mission()
    missions, ledger = compiled(drop_plan())
    start = Whereabouts(missions["scout"], 0, "hub", 100.0, 0.0, 0.0)
    carrier = Whereabouts(missions["carrier"], 0, "base", 0.0, 0.0, 0.0)
    outlook = replace(
        look(drop_plan(), 0.0, start, carrier, ledger),
        committed={"scout": (), "carrier": ()},
        diverges_at={r: m.steps[0].uid for r, m in missions.items()},
    )
    for tag in meanwhile:
        assert ledger.confirm(confirm("scout", Action.COLLECT, tag, "far")) is None
    again = drop_plan().model_copy(update={"version": 2})
    revision = revise(mission, again, outlook, ledger, missions)
    assert revision.missions == {}
    assert sorted(revision.samples) == [1, 2]


def test_another_order_of_stops_is_other_work() -> None:
    missions, _ = compiled(drop_plan())
    steps = missions["scout"].steps
    assert same_work(steps, steps)
    assert not same_work(steps, steps[::-1])
    assert not same_work(steps, steps[:-1])


def test_a_measured_straight_line_of_a_complete_site_becomes_an_edge() -> None:
    text = MISSION.replace("  edges:", "  complete: true\n  edges:", 1)
    mission = parse_mission(text)
    experience = Experience()
    experience.note(Measured("base", "far", 2.0, 1.5), whole=True)
    time_s, energy_j = Roads(mission).drive("scout", "far", "base", 0)
    found = Roads(experience.applied_to(mission)).drive("scout", "far", "base", 0)
    assert found == pytest.approx((2.0 * time_s, 1.5 * energy_j))
