from __future__ import annotations

import itertools
import random
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from link_cases import HOME, SYSTEM, UNHURRIED, drives, framed, ids, step
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from malipp_field.link.commands import CommandExchange
from malipp_field.link.confirmations import ConfirmationInbox
from malipp_field.link.progress import Progress
from malipp_field.link.vehicle import Vehicle
from malipp_field.vehicle.payload_protocol import PayloadReport
from malipp_field.vehicle.steps import Action, VehicleMission


def heartbeat(mode: int = mavlink.ROVER_MODE_HOLD, armed: bool = False) -> Any:
    base = mavlink.MAV_MODE_FLAG_SAFETY_ARMED if armed else 0
    return framed(mavlink.MAVLink_heartbeat_message(10, 3, base, mode, 4, 3))


def current(seq: int, state: int = mavlink.MISSION_STATE_ACTIVE) -> Any:
    return framed(mavlink.MAVLink_mission_current_message(seq, 0, state))


def test_vehicle_gathers_what_it_hears() -> None:
    vehicle = Vehicle(SYSTEM)
    assert not vehicle.link_ok(0.0)
    vehicle.receive(heartbeat(mavlink.ROVER_MODE_AUTO, armed=True), 10.0)
    assert (vehicle.mode, vehicle.armed, vehicle.auto_entered) == ("AUTO", True, True)
    vehicle.receive(heartbeat(99), 11.0)
    assert (vehicle.mode, vehicle.armed, vehicle.auto_entered) == ("mode 99", False, True)
    assert vehicle.link_ok(15.9)
    assert not vehicle.link_ok(16.0)

    vehicle.receive(
        framed(mavlink.MAVLink_global_position_int_message(0, 5 * 10**7, -(10**8), 0, 0, 300, -400, 0, 9000)),
        11.0,
    )
    assert (vehicle.lat_deg, vehicle.lon_deg, vehicle.speed_m_s, vehicle.heading_deg) == (
        5.0,
        -10.0,
        5.0,
        90.0,
    )
    vehicle.receive(framed(mavlink.MAVLink_global_position_int_message(0, 0, 0, 0, 0, 0, 0, 0, 65535)), 11.0)
    assert vehicle.heading_deg == 90.0

    for flags, ready in ((8, False), (16, False), (24, True), (1, False)):
        vehicle.receive(framed(mavlink.MAVLink_ekf_status_report_message(flags, 0, 0, 0, 0, 0)), 11.0)
        assert vehicle.ready_to_arm is ready

    assert not vehicle.receive(framed(mavlink.MAVLink_heartbeat_message(10, 3, 0, 4, 4, 3), system=9), 20.0)
    assert not vehicle.link_ok(20.0)


def test_the_energy_the_script_measures_is_preferred() -> None:
    vehicle = Vehicle(SYSTEM)

    def battery(hectojoule: int) -> Any:
        return framed(mavlink.MAVLink_battery_status_message(0, 0, 0, 0, [0] * 10, 0, 0, hectojoule, 50))

    def named(name: bytes, value: float) -> Any:
        return framed(mavlink.MAVLink_named_value_float_message(0, name, value))

    vehicle.receive(battery(12), 0.0)
    assert vehicle.energy_used_j == 1200.0
    vehicle.receive(battery(-1), 0.0)  # not measured
    vehicle.receive(named(b"OTHER", 3.0), 0.0)
    assert vehicle.energy_used_j == 1200.0
    vehicle.receive(named(b"MLP_WH", 0.5), 0.0)
    vehicle.receive(battery(99), 0.0)
    vehicle.receive(named(b"MLP_WH", float("nan")), 0.0)
    assert vehicle.energy_used_j == 1800.0


def acknowledge(result: int, command: int = 176, to: tuple[int, int] = ids()) -> Any:
    return framed(
        mavlink.MAVLink_command_ack_message(command, result, target_system=to[0], target_component=to[1])
    )


def test_a_command_is_repeated_with_a_counter_and_given_up() -> None:
    command = CommandExchange(176, [1.0, 4.0], SYSTEM)
    sent = command.start(0.0)
    now_s = 0.0
    while not command.ended:
        now_s += 0.05
        sent += command.tick(now_s)
    assert [message.confirmation for message in sent] == list(range(len(sent)))
    assert len(sent) >= 6
    assert [sent[0].param1, sent[0].param2, sent[0].param7] == [1.0, 4.0, 0.0]
    assert 9.0 < now_s < 13.0
    assert command.failure == f"vehicle {SYSTEM} does not answer DO_SET_MODE"


def test_acknowledgements_of_commands() -> None:
    command = CommandExchange(176, [], SYSTEM)
    command.start(0.0)
    command.receive(acknowledge(mavlink.MAV_RESULT_ACCEPTED, command=400), 0.1)
    command.receive(acknowledge(mavlink.MAV_RESULT_ACCEPTED, to=(245, 190)), 0.1)
    assert not command.ended
    command.receive(acknowledge(mavlink.MAV_RESULT_IN_PROGRESS), 1.0)
    assert command.tick(2.0) == []  # it is being done: no need to repeat it
    command.receive(acknowledge(mavlink.MAV_RESULT_TEMPORARILY_REJECTED), 2.1)
    assert not command.ended
    command.receive(acknowledge(mavlink.MAV_RESULT_ACCEPTED, to=(0, 0)), 2.2)
    assert command.done


@pytest.mark.parametrize(
    ("result", "at_s", "words"),
    [
        (mavlink.MAV_RESULT_FAILED, 0.1, "MAV_RESULT_FAILED"),
        (mavlink.MAV_RESULT_TEMPORARILY_REJECTED, 11.0, "MAV_RESULT_TEMPORARILY_REJECTED"),
        (77, 0.1, "result 77"),
    ],
)
def test_refused_commands(result: int, at_s: float, words: str) -> None:
    command = CommandExchange(176, [], SYSTEM)
    command.start(0.0)
    command.receive(acknowledge(result), at_s)
    assert command.failure == f"DO_SET_MODE was refused ({words})"


@UNHURRIED
@given(st.permutations(range(1, 7)), st.lists(st.integers(1, 6), max_size=10))
def test_confirmations_come_out_in_order_and_once(order: list[int], repeats: list[int]) -> None:
    inbox, taken = ConfirmationInbox(), []
    for number in itertools.chain(order, repeats):
        inbox.put(PayloadReport(number, Action.COLLECT, number, "ok"), 0.0)
        while (report := inbox.next()) is not None:
            taken.append(report.number)
            inbox.accept()
        assert inbox.heard == len(taken)
    assert taken == [1, 2, 3, 4, 5, 6]


def test_a_script_that_counts_anew_is_believed() -> None:
    inbox = ConfirmationInbox()
    for number, tag in ((1, 10), (2, 11), (1, 10), (2, 30), (1, 29), (2, 30)):
        inbox.put(PayloadReport(number, Action.DROP, tag, "ok"), 0.0)
        while inbox.next() is not None:
            inbox.accept()
    assert inbox.heard == 2


def test_a_script_in_mid_count_is_joined_where_it_stands() -> None:
    """What it said before was acknowledged to an agent that is no more; the first of the rest is lost."""
    inbox, taken = ConfirmationInbox(), []
    for second in range(12):
        for number in (8, 7) if second else (8,):
            inbox.put(PayloadReport(number, Action.COLLECT, number, "ok"), float(second))
        while (report := inbox.next()) is not None:
            taken.append((second, report.number))
            inbox.accept()
    assert taken == [(8, 7), (8, 8)]
    assert inbox.heard == 8


def test_a_late_word_of_a_script_before_its_restart_does_not_deafen_the_inbox() -> None:
    inbox, taken = ConfirmationInbox(), []
    old, new = (PayloadReport(2, Action.DROP, tag, "ok") for tag in (11, 21))
    news = [PayloadReport(1, Action.DROP, 20, "ok"), new, old]
    news += [PayloadReport(3, Action.DROP, 22, "ok")] * 12  # all it still repeats
    for second, report in enumerate(news):
        inbox.put(report, float(second))
        while (found := inbox.next()) is not None:
            taken.append(found.tag)
            inbox.accept()
    assert taken[:2] == [20, 21]
    assert taken[-1] == 22


WORK = VehicleMission(
    robot="scout", version=1, home=HOME,
    steps=(
        step(Action.DRIVE, 1), step(Action.COLLECT, 1, 5), step(Action.DRIVE, 2), step(Action.WAIT, 2, 6),
        step(Action.PICK, 2, 6), step(Action.DRIVE, 3),
    ),
)  # fmt: skip


def under_way() -> Progress:
    progress = Progress()
    progress.adopt(WORK)
    progress.follow(1)
    return progress


def test_drives_are_done_when_passed_and_work_when_confirmed() -> None:
    progress = under_way()
    for _ in range(2):
        progress.report(3, complete=False)
    assert progress.done == {"drive/1/0"}
    assert [s.uid for s in progress.unconfirmed()] == ["collect/1/5"]
    assert progress.first_undone(WORK) == 1
    confirmed = progress.step_of(PayloadReport(1, Action.COLLECT, 5, "ok"))
    assert confirmed == WORK.steps[1]
    progress.done.add(confirmed.uid)
    for _ in range(2):
        progress.report(5, complete=False)
    assert progress.first_undone(WORK) == 4
    assert not progress.finished
    progress.done.add("pick/2/6")
    for _ in range(2):
        progress.report(6, complete=True)
    assert progress.finished
    assert progress.current is None


def test_a_stale_index_cannot_count_work_as_done() -> None:
    progress = under_way()
    progress.report(99, complete=False)  # of a longer mission that was here before
    assert progress.current == WORK.steps[0]
    for _ in range(2):
        progress.report(6, complete=True)
    assert progress.done == {"drive/1/0"}
    progress.report(0, complete=False)  # at no item at all
    progress.forget()
    progress.report(6, complete=False)
    assert progress.done == {"drive/1/0"}


def test_a_single_late_report_opens_no_gate() -> None:
    """Held and resumed after it, the vehicle would go past the gate and pick too early."""
    progress, gated = Progress(), WORK.model_copy(update={"steps": WORK.steps[2:]})
    progress.adopt(gated)
    progress.follow(1)
    progress.report(4, complete=False)  # under way since an earlier mission, or an earlier index
    progress.report(1, complete=False)
    progress.report(1, complete=True)
    progress.report(2, complete=False)
    assert progress.done == {"drive/2/0"}
    assert progress.resumption(gated) == 2


def test_confirmation_of_what_no_mission_has() -> None:
    assert under_way().step_of(PayloadReport(1, Action.UNLOAD, 5, "ok")) is None


def test_a_confirmation_of_another_run_is_of_no_step() -> None:
    report = PayloadReport(1, Action.COLLECT, 5, "ok")
    for known, told, found in ((0, 0, True), (0, 3, False), (7, 7, True), (7, 3, False), (7, 0, False)):
        progress = Progress()
        assert not progress.precedes(replace(report, run=told))  # nothing known to be before
        progress.adopt(WORK.model_copy(update={"run": known}))
        assert (progress.step_of(replace(report, run=told)) is not None) == found
        assert progress.precedes(replace(report, run=told)) != found


def test_in_another_run_nothing_is_done_yet() -> None:
    progress = under_way()
    for _ in range(2):
        progress.report(2, complete=False)
    progress.failed["collect/1/5"] = "full"
    again = WORK.model_copy(update={"run": 7})
    progress.adopt(again)
    assert (progress.done, progress.failed, progress.under_way) == (set(), {}, False)
    assert progress.resumption(again) == 1
    progress.follow(1)
    for _ in range(2):
        progress.report(2, complete=False)
    progress.adopt(again.model_copy(update={"version": 2}))
    assert (progress.done, progress.under_way) == ({"drive/1/0"}, True)


def test_objections() -> None:
    progress = Progress()
    shorter = WORK.model_copy(update={"version": 2, "steps": WORK.steps[:3]})
    assert progress.objection(shorter, None) is None  # nothing has begun
    progress = under_way()
    progress.report(1, complete=False)
    assert progress.objection(shorter, None) is None
    assert "drive/1/0" in (progress.objection(drives(2, first=5), None) or "")
    progress.report(4, complete=False)
    assert progress.objection(shorter, WORK.steps[3].uid) is None  # the gate
    assert progress.objection(shorter, None)
    assert progress.objection(shorter, WORK.steps[4].uid)
    progress.report(5, complete=False)
    assert progress.objection(shorter, WORK.steps[4].uid)  # not a gate
    progress.report(6, complete=True)
    assert progress.objection(shorter, None) is None  # it has finished


@pytest.mark.parametrize("seed", range(20))
def test_progress_survives_any_order_of_reports(seed: int) -> None:
    """Late and doubled news: in the end all is done, and nothing is done before it was."""
    order = random.Random(seed)
    progress = under_way()
    news: list[Any] = [*range(1, 7), *range(1, 7)]
    order.shuffle(news)
    for seq in news:
        progress.report(seq, complete=False)
        assert progress.done <= {"drive/1/0"}
    progress.done |= {"collect/1/5", "pick/2/6"}
    for _ in range(2):
        progress.report(6, complete=True)
    assert progress.finished


def test_of_two_steps_alike_the_one_not_done_is_meant() -> None:
    progress = under_way()
    newer = WORK.model_copy(update={"version": 2, "steps": (step(Action.PICK, 2, 6, uid="again"),)})
    report = PayloadReport(1, Action.PICK, 6, "ok")
    progress.done.add("pick/2/6")
    progress.adopt(newer)
    assert progress.step_of(report) == newer.steps[0]
    progress.done.add("again")
    assert progress.step_of(report) == newer.steps[0]
