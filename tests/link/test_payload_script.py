"""The payload script for ArduPilot, run by a Lua interpreter: what it does, says and refuses."""

from __future__ import annotations

from typing import Any

import pytest
from lua_cases import AUTO, HOLD, Scripted, named_int, structure

from malipp_field.vehicle.layout import ACTION_CODES, gate_code
from malipp_field.vehicle.payload_protocol import PayloadReport, ack_name, parse_confirmation
from malipp_field.vehicle.steps import Action

WAIT, COLLECT, DROP, PICK, UNLOAD = (ACTION_CODES[a] for a in Action if a in ACTION_CODES)
SERVO: dict[str, float] = {"COL_TYPE": 1, "COL_NUM": 9, "COL_ON": 1900, "COL_OFF": 1100, "COL_TIME": 3}
RELAY: dict[str, float] = {"DRP_TYPE": 2, "DRP_NUM": 0, "DRP_ON": 1, "DRP_OFF": 0, "DRP_TIME": 2}
GRIPPER: dict[str, float] = {"PIK_TYPE": 3, "PIK_NUM": 1, "PIK_ON": 1, "PIK_TIME": 2}
UNLOADER: dict[str, float] = {"UNL_TYPE": 1, "UNL_NUM": 10, "UNL_ON": 2000, "UNL_TIME": 1}
ALL = {"CAP": 2} | SERVO | RELAY | GRIPPER | UNLOADER
RELAY_THERE = "S.relays[0] = true"
GPS_AHEAD_OF_UTC_S = 18


@pytest.fixture
def rover() -> Scripted:
    found = Scripted(RELAY_THERE, **ALL)
    found.run(0.2)
    assert found.take() == ["MLP script ready, 0 on board"]
    return found


def done(rover: Scripted, code: int, tag: int, y: int = 0) -> list[str]:
    """Have an item carried out and its confirmation acknowledged; return what was said."""
    rover.ask(code, tag, y)
    rover.run(4.0)
    texts = rover.take()
    rover.acknowledge(1000)  # never given: ignored
    numbers = [report.number for text in texts if (report := parse_confirmation(text))]
    rover.acknowledge(max(numbers, default=0))
    rover.run(0.2)
    rover.take()
    return sorted(set(texts))


def test_each_action_works_its_output_for_its_time_and_is_confirmed(rover: Scripted) -> None:
    for code, tag, seconds, switched, at_rest, text in (
        (COLLECT, 7, 3.0, ("servo", 8, 1900), [("servo", 8, 1100)], "MLP 1 collect 7 ok"),
        (DROP, 7, 2.0, ("relay", 0, 1), [("relay", 0, 0)], "MLP 2 drop 7 ok"),
        (PICK, 8, 2.0, ("command 211", 1, 1), [], "MLP 3 pick 8 ok"),
        (UNLOAD, 8, 1.0, ("servo", 9, 2000), [], "MLP 4 unload 8 ok"),
    ):
        rover.ask(code, tag)
        rover.run(seconds - 0.2)
        assert (rover.outputs(), rover.take(), rover.ended) == ([switched], [], False)
        rover.run(0.5)
        assert (rover.outputs(), rover.take(), rover.ended) == (at_rest, [text], True)
        rover.acknowledge(99)  # more than was given: no acknowledgement
        rover.acknowledge(int(text.split()[1]))
        rover.run(5.0)
        assert rover.take() == []
    assert rover.parameter("ABOARD") == 0.0


def test_a_confirmation_is_repeated_every_second_until_acknowledged(rover: Scripted) -> None:
    for tag in (1, 2):
        rover.ask(COLLECT, tag)
        rover.run(3.3)
    rover.take()
    rover.run(5.0)
    assert sorted(rover.take()) == ["MLP 1 collect 1 ok"] * 5 + ["MLP 2 collect 2 ok"] * 5
    rover.acknowledge(1)
    rover.run(5.0)
    assert rover.take() == ["MLP 2 collect 2 ok"] * 5


def test_a_link_that_was_away_is_not_flooded(rover: Scripted) -> None:
    for tag in range(1, 21):
        rover.ask(PICK if tag % 2 else DROP, (tag + 1) // 2)
        rover.run(2.3)
    rover.take()
    rover.run(1.0)
    assert sorted(int(text.split()[1]) for text in rover.take()) == list(range(1, 9))
    rover.acknowledge(6)
    rover.run(1.5)
    assert {int(text.split()[1]) for text in rover.take()} == set(range(7, 15))


@pytest.mark.parametrize("wide", [False, True])
def test_only_a_whole_acknowledgement_for_this_vehicle_counts(rover: Scripted, wide: bool) -> None:
    rover.ask(COLLECT, 1)
    rover.run(3.3)
    right = structure(named_int(ack_name(7), 1), wide)
    at = 15 if wide else 12
    damaged = right[: at + 4] + bytes([right[at + 4] ^ 2]) + right[at + 5 :]
    old = right[:2] + b"\xfe" + right[3:]
    others = [structure(named_int(name, 1), wide) for name in (ack_name(8), ack_name(77), "MLP_ACK")]
    for message in [damaged, old, *others]:
        rover.receive(message)
    rover.run(2.0)
    assert "MLP 1 collect 1 ok" in rover.take()
    rover.receive(right)
    rover.run(0.2)
    rover.take()
    rover.run(3.0)
    assert rover.take() == []


def test_the_name_of_the_system_id_before_4_7_is_known_too() -> None:
    rover = Scripted("S.parameters.MAV_SYSID = nil; S.parameters.SYSID_THISMAV = 7", **ALL)
    rover.run(0.2)
    done(rover, COLLECT, 1)
    rover.run(3.0)
    assert rover.take() == []


def test_a_full_bay_and_a_container_that_is_not_on_board_are_refused(rover: Scripted) -> None:
    assert done(rover, COLLECT, 1) == ["MLP 1 collect 1 ok"]
    assert done(rover, COLLECT, 2) == ["MLP 2 collect 2 ok"]
    assert done(rover, PICK, 3) == ["Cannot pick 3: holding", "MLP 3 pick 3 full"]
    assert (rover.mode, rover.ended) == (HOLD, False)
    assert done(rover, DROP, 9) == ["Cannot drop 9: holding", "MLP 4 drop 9 missing"]
    assert done(rover, UNLOAD, 0) == ["Cannot unload 0: holding", "MLP 5 unload 0 unknown"]
    assert done(rover, DROP, 1) == ["MLP 6 drop 1 ok"]
    assert (rover.mode, rover.ended) == (AUTO, True)


@pytest.mark.parametrize("what", [{"COL_TYPE": 0}, {"COL_ON": 99999}, {"COL_NUM": 0}, {"COL_OFF": 3}])
def test_an_action_without_a_usable_output_is_never_done(what: dict[str, float]) -> None:
    rover = Scripted(RELAY_THERE, **(ALL | what))
    assert done(rover, COLLECT, 1)[0] == "Cannot collect 1: holding"
    assert (rover.outputs(), rover.ended, rover.mode) == ([], False, HOLD)


def test_a_relay_that_is_not_set_up_and_a_gripper_that_refuses_are_noticed() -> None:
    rover = Scripted("S.gripper_says = 4", **(ALL | {"ABOARD": 1}))
    assert done(rover, DROP, 1) == [
        "Cannot drop 1: holding", "MLP 1 drop 1 unknown", "MLP script ready, 1 on board",
    ]  # fmt: skip
    assert done(rover, PICK, 2) == ["Cannot pick 2: holding", "MLP 2 pick 2 unknown"]
    assert rover.parameter("ABOARD") == 1.0


@pytest.mark.parametrize("code", [0, 6, 255])
def test_an_action_it_does_not_know_makes_the_vehicle_hold(rover: Scripted, code: int) -> None:
    rover.ask(code, 1)
    rover.run(20.0)
    assert (rover.take(), rover.mode, rover.ended) == ([f"MLP unknown action code {code}"], HOLD, False)


def test_more_containers_at_a_time_than_one_are_refused(rover: Scripted) -> None:
    rover.ask(COLLECT, 1, containers=2.0)
    rover.run(0.2)
    assert rover.take() == ["Cannot collect 1: holding", "MLP 1 collect 1 unknown"]


def test_what_was_done_at_this_place_is_confirmed_again_and_not_done_twice(rover: Scripted) -> None:
    assert done(rover, COLLECT, 1) == ["MLP 1 collect 1 ok"]
    rover.outputs()
    rover.set("S.place = { 2.0, 1.0 }")
    assert done(rover, COLLECT, 1) == ["MLP 2 collect 1 ok"]
    assert (rover.outputs(), rover.ended, rover.parameter("ABOARD")) == ([], True, 1.0)
    rover.set("S.place = { 9.0, 1.0 }")
    assert done(rover, COLLECT, 1)[1] == "MLP 3 collect 1 unknown"
    assert rover.outputs() == []


def test_a_new_mission_may_use_the_tags_again_and_a_hold_on_the_way_is_none(rover: Scripted) -> None:
    rover.set("S.armed = true")
    done(rover, COLLECT, 1)
    rover.set("S.armed = false")
    rover.run(0.2)
    rover.set("S.armed = true; S.place = { 50.0, 0.0 }")
    assert done(rover, COLLECT, 1)[0] == "Cannot collect 1: holding"  # still on board: the same mission
    done(rover, UNLOAD, 1)
    rover.set("S.armed = false")
    rover.run(0.2)
    rover.set("S.armed = true")
    rover.run(0.2)
    assert done(rover, COLLECT, 1)[0] == "MLP 4 collect 1 ok"


def test_another_run_may_use_the_tags_again_whatever_is_on_board(rover: Scripted) -> None:
    def y_of(run: int) -> int:
        return 2 * run

    assert done(rover, COLLECT, 1, y_of(400)) == ["MLP 1 collect 1 ok k=400"]
    assert done(rover, COLLECT, 1, y_of(400)) == ["MLP 2 collect 1 ok k=400"]  # done here already
    assert rover.parameter("ABOARD") == 1.0
    rover.outputs()
    assert done(rover, COLLECT, 1, y_of(401)) == ["MLP 3 collect 1 ok k=401"]
    assert (len(rover.outputs()), rover.parameter("ABOARD")) == (2, 2.0)
    assert done(rover, UNLOAD, 1, y_of(401)) == ["MLP 4 unload 1 ok k=401"]
    assert done(rover, UNLOAD, 7, y_of(401)) == ["MLP 5 unload 7 ok k=401"]  # of before, whatever its tag
    assert done(rover, UNLOAD, 1, y_of(402) + 1) == ["MLP 6 unload 1 missing k=402"]
    assert (rover.ended, rover.mode) == (True, AUTO)


def test_a_vehicle_armed_again_in_the_same_run_remembers_what_it_did(rover: Scripted) -> None:
    for action in (COLLECT, UNLOAD):
        done(rover, action, 1, 2 * 400)
    rover.set("S.armed = true")
    rover.run(0.2)
    rover.outputs()
    assert done(rover, UNLOAD, 1, 2 * 400) == ["MLP 3 unload 1 ok k=400"]
    assert rover.outputs() == []


def test_a_reading_is_taken_at_the_end_of_a_collect_and_told_again_as_it_was() -> None:
    rover = Scripted(
        f"{RELAY_THERE}; S.volts[13] = 9.0", **(ALL | {"VAL_PIN": 13, "VAL_MUL": 2, "VAL_ADD": -1})
    )
    rover.ask(COLLECT, 1, y=2 * 400)
    rover.run(2.9)
    rover.set("S.volts[13] = 2.123456789")
    rover.run(0.2)
    rover.set("S.volts[13] = 7.0")
    rover.run(0.1)
    assert rover.take() == ["MLP script ready, 0 on board", "MLP 1 collect 1 ok k=400 v=3.24691"]
    rover.acknowledge(1)
    assert done(rover, COLLECT, 1, y=2 * 400) == ["MLP 2 collect 1 ok k=400 v=3.24691"]
    assert done(rover, DROP, 1, y=2 * 400) == ["MLP 3 drop 1 ok k=400"]
    rover.set("S.volts[13] = 0.0/0.0")
    assert done(rover, COLLECT, 2) == ["MLP 4 collect 2 ok"]


def test_the_longest_text_of_a_vehicle_that_has_confirmed_a_hundred_thousand_fits() -> None:
    """The stand-in refuses a longer one; a number of seven digits would not be reached in years."""
    rover = Scripted(f"{RELAY_THERE}; S.volts[13] = -1.2345678e-30", **(ALL | {"VAL_PIN": 13}))
    rover.ask(COLLECT, 32767, y=32766)
    rover.run(3.3)
    text = rover.take()[-1]
    assert text == "MLP 1 collect 32767 ok k=16383 v=-1.23457e-30"
    assert len(text) + len("99999") <= 50
    assert parse_confirmation(text) == PayloadReport(1, Action.COLLECT, 32767, "ok", -1.23457e-30, 16383)


def test_an_input_that_is_none_is_told_at_the_start() -> None:
    with pytest.raises(Exception, match="MLP: no analog input 13"):
        Scripted("", VAL_PIN=13)


def test_parameters_keep_their_places_and_there_is_room_for_more(rover: Scripted) -> None:
    """A vehicle keeps values by place, and gives a script that is loaded again no larger table."""
    words = [f"{word}_{what}" for word in ("COL", "DRP", "PIK", "UNL")
             for what in ("TYPE", "NUM", "ON", "OFF", "TIME")]  # fmt: skip
    names = ["CAP", "ABOARD", "SW_PIN", "SW_ON", *words, "VAL_PIN", "VAL_MUL", "VAL_ADD"]
    assert list(rover.state.order.values()) == names
    assert len(names) < rover.state.table[3]


def test_what_was_put_down_is_not_looked_for_among_what_is_on_board_from_before_a_restart() -> None:
    rover = Scripted(RELAY_THERE, **(ALL | {"ABOARD": 2}))
    assert done(rover, DROP, 1)[0] == "MLP 1 drop 1 ok"
    rover.outputs()
    assert done(rover, DROP, 1) == ["MLP 2 drop 1 ok"]  # after a hold: done here already
    rover.set("S.place = { 50.0, 0.0 }")
    assert done(rover, UNLOAD, 1)[1] == "MLP 3 unload 1 missing"
    assert (rover.outputs(), rover.parameter("ABOARD")) == ([], 1.0)


def test_an_action_that_is_broken_off_is_put_to_rest_and_begun_anew(rover: Scripted) -> None:
    rover.ask(COLLECT, 1)
    rover.run(1.0)
    rover.set(f"S.mode = {HOLD}")
    rover.run(10.0)
    assert rover.outputs() == [("servo", 8, 1900), ("servo", 8, 1100)]
    assert (rover.take(), rover.parameter("ABOARD")) == ([], 0.0)
    rover.ask(COLLECT, 1)
    rover.run(3.5)
    assert (rover.outputs(), rover.ended) == ([("servo", 8, 1900), ("servo", 8, 1100)], True)
    assert rover.take() == ["MLP 1 collect 1 ok"]


def test_another_item_made_current_in_the_middle_breaks_an_action_off(rover: Scripted) -> None:
    rover.ask(COLLECT, 1)
    rover.run(1.0)
    rover.ask(PICK, 2)
    rover.run(2.5)
    assert rover.outputs() == [("servo", 8, 1900), ("servo", 8, 1100), ("command 211", 1, 1)]
    assert rover.take() == ["MLP 1 pick 2 ok"]


def test_what_is_on_board_survives_a_restart_and_a_person_may_say_it_is_not() -> None:
    rover = Scripted(RELAY_THERE, **(ALL | {"ABOARD": 2}))
    assert done(rover, COLLECT, 3)[1] == "MLP 1 collect 3 full"
    assert done(rover, DROP, 1) == ["MLP 2 drop 1 ok"]
    rover.set("S.parameters.MLP_ABOARD = 0.0")
    assert done(rover, DROP, 2)[1] == "MLP 3 drop 2 missing"
    assert done(rover, COLLECT, 3) == ["MLP 4 collect 3 ok"]
    rover.set("S.parameters.MLP_ABOARD = 0.0")  # somebody took it out
    assert done(rover, UNLOAD, 3)[1] == "MLP 5 unload 3 missing"


def test_a_switch_tells_whether_the_container_was_there() -> None:
    rover = Scripted("", **(ALL | {"SW_PIN": 54, "SW_ON": 1}))
    rover.ask(PICK, 1)
    rover.run(1.0)
    rover.set("S.pins[54] = true")
    rover.run(0.3)
    rover.set("S.pins[54] = false")
    rover.run(1.0)
    assert rover.take() == ["MLP script ready, 0 on board", "MLP 1 pick 1 ok"]
    rover.acknowledge(1)
    assert done(rover, PICK, 2) == ["Cannot pick 2: holding", "MLP 2 pick 2 missing"]
    assert (rover.mode, rover.ended, rover.parameter("ABOARD")) == (HOLD, False, 1.0)


def test_where_the_mission_says_so_it_goes_on_without_the_container() -> None:
    rover = Scripted(RELAY_THERE, **(ALL | {"SW_PIN": 54}))
    rover.set("S.pins[54] = true")  # level 0 would mean a container
    assert done(rover, PICK, 1, y=1)[0] == "MLP 1 pick 1 missing"
    assert (rover.mode, rover.ended) == (AUTO, True)
    assert done(rover, UNLOAD, 1, y=1) == ["MLP 2 unload 1 missing"]
    assert (rover.mode, rover.ended) == (AUTO, True)
    rover.set("S.pins[54] = false; S.parameters.MLP_ABOARD = 2.0")
    assert done(rover, PICK, 3, y=1) == ["Cannot pick 3: holding", "MLP 3 pick 3 full"]


def clock(utc_s: float) -> str:
    """Return the stand-in's receiver at a time of day (UTC), on some day of the GPS week."""
    return f"S.gps.ms = {round((3 * 86400 + utc_s + GPS_AHEAD_OF_UTC_S) * 1000)}"


def test_a_gate_opens_by_the_ground_alone_or_at_its_time(rover: Scripted) -> None:
    rover.ask(WAIT, 1)
    rover.run(300.0)
    assert (rover.ended, rover.mode, rover.take()) == (False, AUTO, [])
    gate = gate_code(1_800_000_000 // 86400 * 86400 + 36_000.0)  # ten in the morning
    rover.ask(WAIT, 1, y=gate)
    for utc_s, opens in ((0.0, False), (35_999.0, False), (36_000.0, True)):
        rover.set(clock(utc_s))
        rover.run(0.5)
        assert rover.ended == opens


@pytest.mark.parametrize(
    ("now_s", "gate_s", "opens"),
    [
        (36_001.0, 36_000.0, True),  # just past
        (10.0, 86_390.0, True),  # past, before midnight
        (86_390.0, 10.0, False),  # after midnight
        (36_000.0, 36_000.0 + 43_200.0, False),
        (36_000.0, 36_000.0 - 43_190.0, True),
        (0.0, 0.0, True),
    ],
)
def test_a_gate_knows_late_from_tomorrow(rover: Scripted, now_s: float, gate_s: float, opens: bool) -> None:
    rover.set(clock(now_s))
    rover.ask(WAIT, 1, y=gate_code(gate_s))
    rover.run(0.5)
    assert rover.ended == opens


@pytest.mark.parametrize("trouble", ["S.gps.status = 2", "S.gps.week = 0"])
def test_without_the_time_no_gate_opens(rover: Scripted, trouble: str) -> None:
    rover.set(f"{clock(36_001.0)}; {trouble}")
    rover.ask(WAIT, 1, y=gate_code(36_000.0))
    rover.run(60.0)
    assert not rover.ended


def test_energy_is_counted_from_the_start_of_the_script(rover: Scripted) -> None:
    def reported() -> Any:
        return rover.state["MLP_WH"]

    assert reported() is None
    rover.set("S.wh = { 5.5, 100.0 }")
    rover.run(1.0)
    assert reported() == 0.0
    rover.set("S.wh[1] = 7.75")
    rover.run(1.0)
    assert reported() == 2.25


def test_a_fault_stops_the_vehicle_and_not_the_script(rover: Scripted) -> None:
    rover.ask(COLLECT, 1)
    rover.run(1.0)
    rover.outputs()
    rover.set("S.fault = 'a very long story of something that has gone wrong in the firmware'")
    rover.run(2.0)
    assert (rover.mode, rover.ended, rover.outputs()) == (HOLD, False, [("servo", 8, 1100)])
    texts = rover.take()
    assert texts
    assert all(text.startswith("MLP ") and len(text) <= 50 for text in texts)
    rover.set("S.fault = nil")
    assert done(rover, COLLECT, 1) == ["MLP 1 collect 1 ok"]


def test_it_refuses_to_run_on_anything_but_a_rover() -> None:
    with pytest.raises(Exception, match="this script is for Rover"):
        Scripted("S.firmware = 2")


def test_its_memory_is_bounded_but_for_what_nobody_has_heard(rover: Scripted) -> None:
    def kilobytes_after(pairs: range, *, heard: bool) -> float:
        for tag in pairs:
            for code in (PICK, DROP):
                rover.ask(code, tag)
                rover.run(2.3)
                if heard:
                    rover.acknowledge(2 * tag if code == DROP else 2 * tag - 1)
        rover.run(0.2)
        rover.take()
        rover.outputs()
        rover.set("collectgarbage(); collectgarbage(); S.kilobytes = collectgarbage('count')")
        return float(rover.state.kilobytes)

    full = kilobytes_after(range(1, 21), heard=True)
    assert full < 150.0  # with the stand-in, and in 64 bits
    assert kilobytes_after(range(21, 61), heard=True) - full < 2.0
    assert kilobytes_after(range(61, 111), heard=False) - full < 15.0
