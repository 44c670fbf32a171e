"""Where a vehicle is by its own word, how its legs go, and what is learned from them."""

from __future__ import annotations

import itertools

import pytest
from control_cases import compiled, confirm, drop_plan, relay_mission, relay_plan, telemetry

from malipp_field.control.experience import Experience
from malipp_field.control.gates import may_pass
from malipp_field.control.ledger import CustodyLedger
from malipp_field.control.lookahead import LookAhead, Roads
from malipp_field.control.schedule import deviation, expectations
from malipp_field.control.tracks import Measured, Track
from malipp_field.vehicle.steps import Action, Sample, Step, VehicleMission


def followed(robot: str = "scout") -> tuple[Track, Roads, VehicleMission]:
    mission = relay_mission()
    missions, _ = compiled(drop_plan())
    return Track(mission, drop_plan().robot(robot), missions[robot]), Roads(mission), missions[robot]


def first(mission: VehicleMission, action: Action, tag: int | None = None) -> Step:
    return next(s for s in mission.steps if s.action is action and tag in (None, *s.tags))


def test_a_step_ahead_of_its_confirmation_is_not_done() -> None:
    """The vehicle goes on; that it has the sample gets through later."""
    track, roads, mission = followed()
    home = next(s for s in mission.steps[4:] if s.action is Action.DRIVE)
    track.update(telemetry("scout", home.uid, 120.0, 200.0, 0.0), roads, 0)
    for action, tag in ((Action.COLLECT, 1), (Action.COLLECT, 2), (Action.DROP, 1)):
        step = first(mission, action, tag)
        assert track.step == step
        track.confirm(step.uid)
    assert track.step == home


def test_a_confirmation_ahead_of_the_step_counts_once() -> None:
    """The outlook must not take a sample twice: once by the ledger, once by the step in progress."""
    relay = relay_mission()
    track, roads, mission = followed()
    missions, ledger = compiled(drop_plan())
    taking = first(mission, Action.COLLECT, 1)
    track.update(telemetry("scout", taking.uid, 110.0, 200.0, 0.0), roads, 0)
    ledger.confirm(confirm("scout", Action.COLLECT, 1, "far"))
    track.confirm(taking.uid)
    carrier = Track(relay, drop_plan().robot("carrier"), missions["carrier"])
    carrier.update(telemetry("carrier", missions["carrier"].steps[0].uid, 110.0, 0.0, 0.0), roads, 0)
    whereabouts = {"scout": track.whereabouts(roads, 1), "carrier": carrier.whereabouts(roads, 0)}
    found = LookAhead(relay, roads, roads, 0.0).outlook(110.0, whereabouts, ledger)
    assert found.state.robot("scout").collected == {"far": 2}
    assert (found.on_board["scout"], found.caches) == ((2,), {("far", "scout"): (1,)})


def test_the_end_is_reached_only_with_the_last_confirmation() -> None:
    track, roads, mission = followed()
    track.update(telemetry("scout", None, 300.0, 0.0, 0.0), roads, 0)
    for step in mission.steps:
        assert not track.finished
        if step.action is not Action.DRIVE:
            track.confirm(step.uid)
    assert track.finished


def test_no_step_at_all_is_no_beginning_anew() -> None:
    """Between the last item and its confirmation an agent names no step, and is not finished."""
    track, roads, mission = followed()
    last = mission.steps[-1]
    track.update(telemetry("scout", last.uid, 300.0, 0.0, 0.0), roads, 0)
    silent = telemetry("scout", None, 301.0, 0.0, 0.0).model_copy(update={"finished": False})
    track.update(silent, roads, 0)
    for step in mission.steps[:-1]:
        track.confirm(step.uid)
    assert track.step == last


def test_a_vehicle_that_was_done_is_not_done_with_its_new_mission_and_stands_where_it_ended() -> None:
    relay = relay_mission()
    missions, _ = compiled(relay_plan())
    old = missions["scout"]
    track, roads = Track(relay, relay_plan().robot("scout"), old), Roads(relay)
    for step in old.steps:
        track.confirm(step.uid)
    track.update(telemetry("scout", None, 330.0, 0.0, 0.0), roads, 0)
    assert (track.finished, track.last_node) == (True, "base")
    steps = tuple(step.model_copy(update={"uid": f"v2 {step.uid}"}) for step in old.steps)
    new = old.model_copy(update={"version": 2, "steps": steps})
    loaded = telemetry("scout", None, 340.0, 0.0, 0.0, version=2).model_copy(update={"finished": False})
    track.update(loaded, roads, 0)  # on board, but not in force yet
    assert (track.finished, track.last_node) == (True, "base")
    track.adopt(relay_plan().robot("scout"), new, 0)
    track.update(telemetry("scout", None, 339.9, 0.0, 0.0), roads, 0)  # was under way before
    assert (track.finished, track.current, track.last_node) == (False, 0, "base")
    track.update(loaded, roads, 0)
    assert (track.finished, track.current, track.last_node) == (False, 0, "base")


def test_a_new_mission_goes_on_at_the_step_in_progress() -> None:
    track, roads, mission = followed()
    second = mission.steps[1]
    track.update(telemetry("scout", second.uid, 60.0, 150.0, 0.0), roads, 0)
    new = mission.model_copy(update={"version": 2, "steps": mission.steps[1:]})
    track.adopt(drop_plan().robot("scout"), new, 1)
    assert (track.step, track.last_node) == (second, "gate")


def test_a_gate_that_was_opened_is_passed_whatever_the_last_report_says() -> None:
    track, roads, mission = followed("carrier")
    gate = first(mission, Action.WAIT)
    track.update(telemetry("carrier", gate.uid, 150.0, 200.0, 0.0), roads, 0)
    assert track.step == gate
    track.confirm(gate.uid)
    assert track.step == first(mission, Action.PICK)


def test_standing_in_hold_is_not_slow_driving() -> None:
    track, roads, mission = followed()
    uid = mission.steps[0].uid
    track.update(telemetry("scout", uid, 0.0, 100.0, 0.0), roads, 0)
    track.update(telemetry("scout", uid, 20.0, 120.0, 200.0, mode="HOLD"), roads, 0)
    track.update(telemetry("scout", uid, 80.0, 120.0, 230.0), roads, 0)
    track.update(telemetry("scout", uid, 100.0, 140.0, 430.0), roads, 0)
    found = track.measured(roads, 0)
    assert found is not None
    assert (found.tail, found.head) == ("hub", "gate")
    assert (found.time_ratio, found.energy_ratio) == pytest.approx((1.0, 1.0), rel=0.01)


def test_a_first_stretch_says_nothing_and_what_is_known_of_the_edge_counts() -> None:
    track, roads, mission = followed()
    uid = mission.steps[0].uid
    track.update(telemetry("scout", uid, 0.0, 100.0, 0.0), roads, 0)
    track.update(telemetry("scout", uid, 9.0, 103.0, 0.0), roads, 0)
    assert track.measured(roads, 0) is None
    assert track.whereabouts(roads, 0, known=(2.0, 3.0)).time_ratio == 2.0
    track.update(telemetry("scout", uid, 40.0, 110.0, 100.0), roads, 0)
    now = track.whereabouts(roads, 0, known=(2.0, 3.0))
    assert (now.time_ratio, now.energy_ratio) == pytest.approx((4.0, 3.0), rel=0.01)


def test_a_wrong_measurement_goes_when_the_whole_edge_turns_out_well() -> None:
    experience, mission = Experience(), relay_mission()
    assert experience.note(Measured("hub", "gate", 3.0, 2.0), whole=False)
    assert experience.of("gate", "hub") == (3.0, 2.0)
    experience.note(Measured("hub", "gate", 1.0, 1.0), whole=False)
    experience.note(Measured("hub", "gate", 1.5, 1.5), whole=False)
    assert experience.of("gate", "hub") == (3.0, 2.0), "a part of an edge does not speak for the rest"
    assert not experience.note(Measured("gate", "hub", 1.02, 1.0), whole=True)
    assert experience.of("gate", "hub") == (1.0, 1.0)
    assert experience.applied_to(mission) is mission


def test_deviation_is_foreseen_on_the_way_from_pace_and_drain() -> None:
    mission = relay_mission()
    roads = Roads(mission)
    missions, _ = compiled(relay_plan())
    expected = expectations(relay_plan(), missions, {"scout": 10000.0, "carrier": 50000.0}, mission)
    begun, second = missions["scout"].steps[:2]
    track = Track(mission, relay_plan().robot("scout"), missions["scout"])
    track.update(telemetry("scout", begun.uid, 10.0, 100.0, 0.0), roads, 0)
    on_time = deviation("scout", 10.0, track.whereabouts(roads, 0), 0, expected, roads)
    assert on_time is not None
    assert on_time.late_s == pytest.approx(0.0, abs=0.1)
    assert on_time.overdraw_j == pytest.approx(0.0, abs=1.0)
    # Ten metres in 40 s for 300 J, not in 10 s for 100 J: a quarter of the pace, thrice the drain.
    track.update(telemetry("scout", begun.uid, 50.0, 110.0, 300.0), roads, 0)
    late = deviation("scout", 50.0, track.whereabouts(roads, 0), 0, expected, roads)
    assert late is not None
    assert late.node == "far"
    assert late.late_s == pytest.approx(50.0 + 40 * 4 + 50 - 110.0, abs=2.0)
    assert late.overdraw_j == pytest.approx(300.0 + 40 * 10 * 3 + 500 - 1000.0, abs=15.0)
    # A new leg is judged by itself.
    track.update(telemetry("scout", begun.uid, 209.0, 149.9, 1497.0), roads, 0)
    leg = track.update(telemetry("scout", second.uid, 210.0, 150.0, 1500.0), roads, 0)
    assert track.whereabouts(roads, 0).time_ratio == 1.0
    assert leg is not None
    assert (leg.tail, leg.head) == ("hub", "gate")
    assert (leg.time_ratio, leg.energy_ratio) == pytest.approx((4.0, 3.0), rel=0.02)


def test_what_was_measured_on_an_edge_counts_in_the_next_plan_for_everybody() -> None:
    mission = relay_mission()
    experience = Experience()
    assert experience.applied_to(mission) is mission
    assert not experience.note(Measured("hub", "gate", 1.05, 1.0), whole=True)
    assert experience.note(Measured("gate", "hub", 4.0, 3.0), whole=True)
    found = experience.applied_to(mission)
    for robot in ("scout", "carrier"):
        before, after = Roads(mission), Roads(found)
        time_s, energy_j = before.drive(robot, "hub", "gate", 1)
        assert after.drive(robot, "hub", "gate", 1) == pytest.approx((4.0 * time_s, 3.0 * energy_j))
        assert after.drive(robot, "base", "hub", 1) == before.drive(robot, "base", "hub", 1)


CLEARANCE_S = 5.0


def test_a_gate_with_two_senders_opens_when_both_have_gone_and_the_clearance_is_over() -> None:
    relay = relay_mission()
    roads = Roads(relay)
    missions, _ = compiled(relay_plan())
    tracks = {r: Track(relay, relay_plan().robot(r), missions[r]) for r in ("scout", "carrier")}
    ledger = CustodyLedger()
    ledger.expect([Sample(tag=1, node="far", sampler="scout"), Sample(tag=2, node="far", sampler="carrier")])

    gate = first(compiled(drop_plan())[0]["carrier"], Action.WAIT).model_copy(update={"tags": (1, 2)})

    def free(now_s: float, robot: str = "third", node: str = "far") -> bool:
        at = gate.model_copy(update={"node": node})
        return may_pass(robot, at, ledger, tracks, now_s, CLEARANCE_S)

    taking = first(missions["scout"], Action.COLLECT, 2)
    leaving = next(s for s in missions["scout"].steps[4:] if s.action is Action.DRIVE)
    tracks["scout"].confirm(first(missions["scout"], Action.COLLECT, 1).uid)
    tracks["scout"].update(telemetry("scout", taking.uid, 100.0, 200.0, 0.0), roads, 0)
    for robot, tag, time_s in (("scout", 1, 101.0), ("carrier", 2, 130.0)):
        assert not free(1000.0)
        ledger.confirm(confirm(robot, Action.COLLECT, tag, "far", time_s=time_s))
        ledger.confirm(confirm(robot, Action.DROP, tag, "far", time_s=time_s))
    assert not free(1000.0), "the scout is still at work there"
    tracks["scout"].confirm(taking.uid)
    tracks["scout"].update(telemetry("scout", leaving.uid, 140.0, 200.0, 0.0), roads, 0)
    assert not free(140.0 + CLEARANCE_S - 0.1)
    assert free(140.0 + CLEARANCE_S)
    assert not free(1000.0, node="hub"), "they lie elsewhere, for somebody else to bring them here first"
    # What the receiver has on board already is no reason to wait; what a third has taken is.
    ledger.confirm(confirm("third", Action.PICK, 1, "far", time_s=150.0))
    assert free(150.0)
    assert not free(150.0, robot="fourth")


@pytest.mark.parametrize(
    "order", list(itertools.permutations(("telemetry", "collect 1", "collect 2", "drop")))
)
def test_reports_and_confirmations_in_any_order_give_the_same_state(order: tuple[str, ...]) -> None:
    track, roads, mission = followed()
    track.update(telemetry("scout", first(mission, Action.COLLECT, 1).uid, 110.0, 200.0, 0.0), roads, 0)
    leaving = next(s for s in mission.steps[4:] if s.action is Action.DRIVE)
    uids = {
        "collect 1": first(mission, Action.COLLECT, 1).uid,
        "collect 2": first(mission, Action.COLLECT, 2).uid,
        "drop": first(mission, Action.DROP).uid,
    }
    for what in order:
        assert track.step != leaving or what == "telemetry"
        if what == "telemetry":
            track.update(telemetry("scout", leaving.uid, 120.0, 200.0, 0.0), roads, 0)
        else:
            track.confirm(uids[what])
    assert track.step == leaving
    assert track.last_node == "far"
