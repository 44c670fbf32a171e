"""Where the team will be when a new plan can take effect, and what of the old plan is left then."""

from __future__ import annotations

import pytest
from control_cases import MISSION, compiled, confirm, drop_plan, relay_mission, relay_plan

from malipp_field.bus import Telemetry
from malipp_field.control.experience import Experience
from malipp_field.control.ledger import CustodyLedger
from malipp_field.control.lookahead import LookAhead, Outlook, Roads, Whereabouts
from malipp_field.control.remainder import remainder
from malipp_field.control.revision import revise, same_work
from malipp_field.control.schedule import deviation, expectations
from malipp_field.control.tracks import Track
from malipp_field.mission import Mission, parse_mission, to_globe
from malipp_field.plan import Plan
from malipp_field.vehicle.steps import Action, VehicleMission


def at(
    mission: VehicleMission, action: Action, node: str, x_m: float, used_j: float = 0.0, last: str = "hub"
) -> Whereabouts:
    index = next(i for i, s in enumerate(mission.steps) if s.action is action and s.node == node)
    return Whereabouts(mission, index, last, x_m, 0.0, used_j)


def look(
    plan: Plan, horizon_s: float, scout: Whereabouts, carrier: Whereabouts, ledger: CustodyLedger
) -> Outlook:
    mission = relay_mission()
    lookahead = LookAhead(mission, Roads(mission), horizon_s)
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


def test_a_shut_gate_ends_the_committed_part_and_an_open_one_does_not() -> None:
    missions, ledger = compiled(drop_plan())
    scout = at(missions["scout"], Action.DRIVE, "far", x_m=180.0, last="gate")
    carrier = at(missions["carrier"], Action.WAIT, "far", x_m=200.0, last="far")
    shut = look(drop_plan(), 0.0, scout, carrier, ledger)
    gate = next(s for s in missions["carrier"].steps if s.action is Action.WAIT)
    assert shut.committed["carrier"] == ()
    assert shut.diverges_at["carrier"] == gate.uid
    assert shut.state.robot("carrier").node == "far"
    (dropped,) = gate.tags
    for action, tags in ((Action.COLLECT, (1, 2)), (Action.DROP, (dropped,))):
        for tag in tags:
            assert ledger.confirm(confirm("scout", action, tag, "far")) is None
    scout = at(missions["scout"], Action.DRIVE, "gate", x_m=190.0, last="far")
    opened = look(drop_plan(), 12.0, scout, carrier, ledger)
    assert [s.action for s in opened.committed["carrier"]][:2] == [Action.WAIT, Action.PICK]
    assert opened.on_board["carrier"] == (dropped,)
    assert opened.state.caches == ()


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


def telemetry(robot: str, uid: str | None, time_s: float, x_m: float, used_j: float) -> Telemetry:
    origin = relay_mission().site.origin
    assert origin is not None
    lat_deg, lon_deg = to_globe(x_m, 0.0, origin)
    return Telemetry(
        time_s=time_s, robot=robot, lat_deg=lat_deg, lon_deg=lon_deg, heading_deg=90.0, speed_m_s=1.0,
        mode="AUTO", armed=True, ready_to_arm=True, energy_used_j=used_j, mission_version=1, step_uid=uid,
        finished=uid is None, link_ok=True,
    )  # fmt: skip


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


def test_a_stop_half_done_leaves_its_other_half() -> None:
    mission = relay_mission()
    missions, ledger = compiled(relay_plan())
    ledger.confirm(confirm("scout", Action.COLLECT, 1, "far"))
    steps = missions["scout"].steps
    second = next(i for i, s in enumerate(steps) if s.action is Action.COLLECT and s.tags == (2,))
    whereabouts = Whereabouts(missions["scout"], second, "far", 200.0, 0.0, 0.0)
    outlook = Outlook(
        look(
            relay_plan(), 0.0, whereabouts, Whereabouts(missions["carrier"], 0, "base", 0.0, 0.0, 0.0), ledger
        ).state,
        committed={"scout": (), "carrier": ()},
        diverges_at={"scout": steps[second].uid, "carrier": None},
        on_board={},
        caches={},
    )
    tracks = {r: Track(mission, relay_plan().robot(r), m) for r, m in missions.items()}
    here, home = remainder(relay_plan(), tracks, outlook).robot("scout").route
    assert (here.node, here.collect, home.node) == ("far", 1, "base")


def test_an_unchanged_plan_concerns_no_vehicle_and_keeps_the_tags() -> None:
    mission = relay_mission()
    missions, ledger = compiled(drop_plan())
    outlook = Outlook(
        look(
            drop_plan(),
            0.0,
            Whereabouts(missions["scout"], 0, "hub", 100.0, 0.0, 0.0),
            Whereabouts(missions["carrier"], 0, "base", 0.0, 0.0, 0.0),
            ledger,
        ).state,
        committed={"scout": (), "carrier": ()},
        diverges_at={r: m.steps[0].uid for r, m in missions.items()},
        on_board={},
        caches={},
    )
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


def test_deviation_is_foreseen_on_the_way_from_pace_and_drain() -> None:
    mission = relay_mission()
    roads = Roads(mission)
    missions, _ = compiled(relay_plan())
    expected = expectations(relay_plan(), missions, {"scout": 10000.0, "carrier": 50000.0}, mission)
    first, second = missions["scout"].steps[:2]
    track = Track(mission, relay_plan().robot("scout"), missions["scout"])
    track.update(telemetry("scout", first.uid, 10.0, 100.0, 0.0), roads, 0)
    on_time = deviation("scout", 10.0, track.whereabouts(roads, 0), 0, expected, roads)
    assert on_time is not None
    assert on_time.late_s == pytest.approx(0.0, abs=0.1)
    assert on_time.overdraw_j == pytest.approx(0.0, abs=1.0)
    # Ten metres in 40 s for 300 J, not in 10 s for 100 J: a quarter of the pace, thrice the drain.
    track.update(telemetry("scout", first.uid, 50.0, 110.0, 300.0), roads, 0)
    late = deviation("scout", 50.0, track.whereabouts(roads, 0), 0, expected, roads)
    assert late is not None
    assert late.node == "far"
    assert late.late_s == pytest.approx(50.0 + 40 * 4 + 50 - 110.0, abs=2.0)
    assert late.overdraw_j == pytest.approx(300.0 + 40 * 10 * 3 + 500 - 1000.0, abs=15.0)
    # A new leg is judged by itself.
    track.update(telemetry("scout", first.uid, 209.0, 149.9, 1497.0), roads, 0)
    track.update(telemetry("scout", second.uid, 210.0, 150.0, 1500.0), roads, 0)
    assert track.whereabouts(roads, 0).time_ratio == 1.0
    assert track.leg_done is not None
    assert track.leg_done[:2] == ("hub", "gate")
    assert track.leg_done[2:] == pytest.approx((4.0, 3.0), rel=0.02)


def test_what_was_measured_on_an_edge_counts_in_the_next_plan_for_everybody() -> None:
    mission = relay_mission()
    experience = Experience()
    assert experience.applied_to(mission) is mission
    assert not experience.note("hub", "gate", 1.05, 1.0)
    assert experience.note("gate", "hub", 4.0, 3.0)
    found = experience.applied_to(mission)
    for robot in ("scout", "carrier"):
        before, after = Roads(mission), Roads(found)
        time_s, energy_j = before.drive(robot, "hub", "gate", 1)
        assert after.drive(robot, "hub", "gate", 1) == pytest.approx((4.0 * time_s, 3.0 * energy_j))
        assert after.drive(robot, "base", "hub", 1) == before.drive(robot, "base", "hub", 1)


def test_a_measured_straight_line_of_a_complete_site_becomes_an_edge() -> None:
    text = MISSION.replace("  edges:", "  complete: true\n  edges:", 1)
    mission = parse_mission(text)
    experience = Experience()
    experience.note("base", "far", 2.0, 1.5)
    time_s, energy_j = Roads(mission).drive("scout", "far", "base", 0)
    found = Roads(experience.applied_to(mission)).drive("scout", "far", "base", 0)
    assert found == pytest.approx((2.0 * time_s, 1.5 * energy_j))
