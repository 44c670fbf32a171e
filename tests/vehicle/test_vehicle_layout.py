"""Which mission items each step becomes on each kind of payload hardware."""

from __future__ import annotations

import pytest
from vehicle_cases import handoff_plan, small_mission

from malipp_field.errors import PlanError
from malipp_field.link.progress import Progress
from malipp_field.mission.vehicles import (
    ByGripper,
    ByHand,
    ByRelay,
    ByScript,
    ByServo,
    Means,
    PayloadProfile,
    VehicleSettings,
)  # fmt: skip
from malipp_field.sim.payload import goes_on_without
from malipp_field.vehicle.compile import Compiled, compile_plan
from malipp_field.vehicle.items import MissionItem
from malipp_field.vehicle.layout import Layout, confirmed_by, gate_code, held_for_operator, lay_out
from malipp_field.vehicle.steps import MAX_RUN, Action, GeoPoint, Step, VehicleMission, run_at

WAYPOINT, LOITER, DELAY, SERVO, RELAY, GRIPPER, SCRIPT = 16, 17, 93, 183, 181, 211, 42702
PLACE = GeoPoint(lat_deg=34.0, lon_deg=-118.0)
MIDNIGHT_S = 1_700_006_400.0
SMALL = small_mission()


def step(action: Action, number: int = 1, tag: int = 7, **more: object) -> Step:
    fields = {"uid": f"{action}/{number}", "action": action, "node": "n", "stop": number, "place": PLACE}
    tags = () if action is Action.DRIVE else (tag,)
    return Step.model_validate({**fields, "tags": tags, **more})


def laid_out(*steps: Step, payload: PayloadProfile | None = None) -> Layout:
    profile = payload or PayloadProfile()
    return lay_out(VehicleMission(robot="r", version=1, home=PLACE, steps=steps, payload=profile))


def in_short(items: list[MissionItem]) -> list[tuple[float, ...]]:
    """Return command and the params that are not 0 at the end."""
    found = []
    for item in items:
        params = [item.param1, item.param2, item.param3, item.param4]
        while params and params[-1] == 0.0:
            params.pop()
        found.append((item.command, *params))
    return found


def only(action: Action, means: Means) -> PayloadProfile:
    return PayloadProfile.model_validate({action.value: means})


@pytest.mark.parametrize(
    ("means", "items", "witness"),
    [
        (ByScript(), [(SCRIPT, 2, 0, 1, 1)], "script"),
        (ByHand(by="manual"), [(LOITER,)], "person"),
        (
            ByServo(by="servo", channel=9, pwm_us=1900, rest_us=1100, duration_s=2.5),
            [(SERVO, 9, 1900), (DELAY, 2.5, -1, -1, -1), (SERVO, 9, 1100)],
            "progress",
        ),
        (
            ByServo(by="servo", channel=9, pwm_us=1900, duration_s=2.5, confirm="operator"),
            [(SERVO, 9, 1900), (DELAY, 2.5, -1, -1, -1), (LOITER,)],
            "person",
        ),
        (
            ByRelay(by="relay", relay=3, duration_s=4.0),
            [(RELAY, 3, 1), (DELAY, 4, -1, -1, -1), (RELAY, 3)],
            "progress",
        ),
        (
            ByGripper(by="gripper", gripper=2, move="grab", duration_s=1.0),
            [(GRIPPER, 2, 1), (DELAY, 1, -1, -1, -1)],
            "progress",
        ),
        (
            ByGripper(by="gripper", move="release", duration_s=1.0),
            [(GRIPPER, 1), (DELAY, 1, -1, -1, -1)],
            "progress",
        ),
    ],
)
@pytest.mark.parametrize("action", [Action.COLLECT, Action.DROP, Action.PICK, Action.UNLOAD])
def test_every_means_of_every_action(
    action: Action, means: Means, items: list[tuple[float, ...]], witness: str
) -> None:
    profile = only(action, means)
    drive, work = step(Action.DRIVE), step(action)
    layout = laid_out(drive, work, step(Action.DRIVE, 2), payload=profile)
    code = {Action.COLLECT: 2, Action.DROP: 3, Action.PICK: 4, Action.UNLOAD: 5}[action]
    expected = [(SCRIPT, code, *entry[2:]) if entry[0] == SCRIPT else entry for entry in items]
    assert in_short(layout.items) == [(WAYPOINT,), (WAYPOINT,), *expected, (WAYPOINT,)]
    assert layout.steps == [-1, 0, *[1] * len(items), 2]
    assert [item.seq for item in layout.items] == list(range(len(layout.items)))
    assert (layout.first_item(1), layout.last_item(1)) == (2, 1 + len(items))
    vehicle = VehicleMission(robot="r", version=1, home=PLACE, steps=(drive, work), payload=profile)
    assert (confirmed_by(vehicle, work), confirmed_by(vehicle, drive)) == (witness, None)
    assert held_for_operator(means) == (witness == "person")


@pytest.mark.parametrize("if_missing", ["hold", "go_on"])
def test_the_script_is_told_the_tag_and_what_to_do_without_it(if_missing: str) -> None:
    (*_, item) = laid_out(step(Action.PICK, tag=321, if_missing=if_missing)).items
    assert (item.x, item.y) == (321, int(if_missing == "go_on"))


@pytest.mark.parametrize("means", [ByScript(), ByHand(by="manual")])
@pytest.mark.parametrize(
    "first", [step(Action.PICK), step(Action.WAIT), step(Action.WAIT, not_before_s=MIDNIGHT_S)]
)
def test_item_one_is_always_a_waypoint_of_the_first_step(first: Step, means: Means) -> None:
    layout = laid_out(first, step(Action.DRIVE, 2), payload=only(Action.PICK, means))
    lead_in = layout.items[1]
    assert (lead_in.command, lead_in.x, lead_in.y) == (WAYPOINT, 340000000, -1180000000)
    assert [item.command for item in layout.items].count(WAYPOINT) == 3
    assert layout.steps == [-1, 0, 0, 1]


def test_before_a_command_done_in_passing_there_is_a_waypoint() -> None:
    profile = only(Action.COLLECT, ByServo(by="servo", channel=9, pwm_us=1900, duration_s=2.0))
    layout = laid_out(step(Action.COLLECT), payload=profile)
    assert in_short(layout.items)[1:] == [(WAYPOINT,), (SERVO, 9, 1900), (DELAY, 2, -1, -1, -1)]
    assert layout.steps == [-1, 0, 0, 0]
    assert [layout.shown_at(item) for item in (1, 2, 3)] == [1, 3, 3]


def test_gates_of_the_script() -> None:
    shut = laid_out(step(Action.WAIT)).items[2]
    timed = laid_out(step(Action.WAIT, not_before_s=MIDNIGHT_S + 3601.0)).items[2]
    assert (shut.command, shut.param1, shut.y) == (SCRIPT, 1.0, 0)
    assert (timed.command, timed.y) == (SCRIPT, gate_code(MIDNIGHT_S + 3604.0))


@pytest.mark.parametrize("pick", [ByHand(by="manual"), ByGripper(by="gripper", move="grab", duration_s=1.0)])
def test_gates_without_a_script(pick: Means) -> None:
    profile = only(Action.PICK, pick)
    shut = laid_out(step(Action.WAIT), payload=profile).items[2]
    assert (shut.command, shut.x) == (LOITER, 340000000)
    for gate_s, params in (
        (MIDNIGHT_S + 3661.2, (-1, 1, 1, 2)),  # rounded up, never too early
        (MIDNIGHT_S, (-1, 0, 0, 0)),
        (MIDNIGHT_S - 0.5, (-1, 0, 0, 0)),
    ):
        item = laid_out(step(Action.WAIT, not_before_s=gate_s), payload=profile).items[2]
        assert (item.command, item.param1, item.param2, item.param3, item.param4) == (DELAY, *params)


@pytest.mark.parametrize(
    ("after_midnight_s", "code"),
    [(0.0, 1), (0.1, 2), (4.0, 2), (43200.0, 10801), (86396.0, 21600), (86397.0, 1)],
)
def test_the_time_of_a_gate_fits_an_int16_and_is_never_early(after_midnight_s: float, code: int) -> None:
    assert gate_code(MIDNIGHT_S + after_midnight_s) == code
    assert 0 < code < 2**15


def test_a_step_of_several_items_goes_on_where_it_was_left() -> None:
    servo = ByServo(by="servo", channel=9, pwm_us=1900, rest_us=1100, duration_s=2.0, confirm="operator")
    profile = only(Action.COLLECT, servo)
    steps = (step(Action.DRIVE), step(Action.COLLECT), step(Action.DRIVE, 2))
    old = VehicleMission(robot="r", version=1, home=PLACE, steps=steps, payload=profile)
    new = old.model_copy(update={"version": 2, "steps": (steps[1], step(Action.DRIVE, 3))})
    layout = lay_out(new)
    assert in_short(layout.items)[1:5] == [
        (WAYPOINT,), (SERVO, 9, 1900), (DELAY, 2, -1, -1, -1), (SERVO, 9, 1100),
    ]  # fmt: skip
    for seq, resumed in ((1, 1), (3, 3), (5, 5)):  # on the way there, in the delay, at the hold
        progress = Progress()
        progress.adopt(old)
        progress.follow(1)
        progress.report(seq, complete=False)
        progress.done.add(steps[0].uid)
        assert progress.resumption(new) == resumed
    progress.settle(steps[1])
    assert progress.resumption(new) == 6
    progress.done.add("drive/3")
    assert progress.resumption(new) is None


def test_scripted_actions_tell_the_run_and_whether_to_go_on() -> None:
    steps = (step(Action.COLLECT), step(Action.WAIT), step(Action.PICK, if_missing="go_on"))
    untold = VehicleMission(robot="r", version=1, home=PLACE, steps=steps)
    for run, ys in ((0, [0, 0, 1]), (5, [10, 0, 11]), (MAX_RUN, [32766, 0, 32767])):
        items = lay_out(untold.model_copy(update={"run": run})).items[2:]
        assert [item.y for item in items] == ys
        assert [goes_on_without(item) for item in items] == [False, False, True]


def test_the_number_of_a_run_is_the_minute_of_its_start() -> None:
    assert [run_at(time_s) for time_s in (0.0, 59.9, 60.0)] == [1, 1, 2]
    assert run_at(60.0 * (MAX_RUN - 1)) == MAX_RUN
    assert run_at(60.0 * MAX_RUN) == 1
    assert {m.run for m in compile_plan(SMALL, handoff_plan(), run=9).missions.values()} == {9}
    assert {m.run for m in compile_plan(SMALL, handoff_plan()).missions.values()} == {0}


def test_a_time_gate_opens_when_the_pick_is_due_and_a_margin_later() -> None:
    mission = SMALL.model_copy(update={"vehicles": {"carrier": VehicleSettings(gate="time")}})
    wait = compile_plan(mission, handoff_plan(), start_s=MIDNIGHT_S).missions["carrier"].steps[1]
    assert (wait.action, wait.not_before_s) == (Action.WAIT, MIDNIGHT_S + 130.0 + 30.0)
    unknown = compile_plan(mission, handoff_plan()).missions["carrier"].steps[1]
    assert unknown.not_before_s is None
    custody = compile_plan(SMALL, handoff_plan(), start_s=MIDNIGHT_S).missions["carrier"].steps[1]
    assert custody.not_before_s is None


@pytest.mark.parametrize(("pick", "most_h"), [(ByHand(by="manual"), 23), (ByScript(), 11)])
def test_a_gate_of_another_day_is_refused(pick: Means, most_h: int) -> None:
    def at_the_gate_for(hours: float) -> Compiled:
        settings = VehicleSettings(
            payload=only(Action.PICK, pick), gate="time", gate_margin_s=min(43200.0, hours * 3600.0)
        )
        plan = handoff_plan()
        route = plan.robot("carrier").route
        late_s = hours * 3600.0 - settings.gate_margin_s
        meet = route[1].model_copy(update={"depart_s": 130.0 + late_s})
        carrier = plan.robot("carrier").model_copy(update={"route": (route[0], meet, route[2])})
        robots = tuple(carrier if robot.id == "carrier" else robot for robot in plan.robots)
        mission = SMALL.model_copy(update={"vehicles": {"carrier": settings}})
        return compile_plan(mission, plan.model_copy(update={"robots": robots}), start_s=MIDNIGHT_S)

    at_the_gate_for(most_h - 0.01)
    with pytest.raises(PlanError, match=f"carrier, stop 1 at 'hub': its time gate .* at most {most_h} h"):
        at_the_gate_for(most_h + 0.01)


def test_what_a_lenient_vehicle_picks_is_in_doubt_from_then_on() -> None:
    lenient = VehicleSettings(if_missing="go_on")
    mission = SMALL.model_copy(update={"vehicles": {"carrier": lenient}})
    steps = compile_plan(mission, handoff_plan()).missions["carrier"].steps
    doubtful = {s.uid for s in steps if s.if_missing == "go_on"}
    assert doubtful == {s.uid for s in steps if s.action in (Action.PICK, Action.UNLOAD)}
    strict = compile_plan(SMALL, handoff_plan()).missions["carrier"].steps
    assert not [s for s in strict if s.if_missing == "go_on"]
