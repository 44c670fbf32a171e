"""Items against the firmware: each fault is found, and what is sound is left alone."""

from __future__ import annotations

import math
from typing import Any

import pytest
from check_cases import BY_OUTPUTS, rules, with_vehicles
from hypothesis import given, settings
from hypothesis import strategies as st
from vehicle_cases import handoff_plan, random_plan

from malipp_field.link.compare import differences
from malipp_field.mission.vehicles import VehicleSettings
from malipp_field.sim.items import RefusedItemError, stored
from malipp_field.vehicle import firmware
from malipp_field.vehicle.check import check_items
from malipp_field.vehicle.compile import compile_plan
from malipp_field.vehicle.items import MissionItem, item_at, item_without_place
from malipp_field.vehicle.layout import lay_out

SCRIPT = VehicleSettings()
BARE = VehicleSettings.model_validate({"payload": "manual"})
HOME = item_at(0, 16, 52.48, 13.785)
DRIVE = item_at(1, 16, 52.481, 13.786)
NAN, INF = math.nan, math.inf
SETTINGS = settings(deadline=None, derandomize=True, database=None)


def plain(command: int, *params: float, x: int = 0, y: int = 0) -> MissionItem:
    return item_without_place(1, command, *params, x=x, y=y)


SOUND = {
    "waypoint": DRIVE._replace(param1=5.0, param4=NAN),
    "loiter": item_at(1, 17, 52.481, 13.786)._replace(param4=NAN),
    "loiter time": item_at(1, 19, 52.481, 13.786, param1=30.0),
    "frame of old": DRIVE._replace(frame=6),
    "home again": plain(20),
    "delay": plain(93, 2.5, -1, -1, -1),
    "no delay": plain(93, 0, -1, -1, -1),
    "until midnight": plain(93, -1, 0, 0, 0),
    "until": plain(93, 0, 23, 59, 59),
    "condition": plain(112, 3.5),
    "speed": plain(178, 1, 1.5, -1),
    "relay": plain(181, 0, 1),
    "servo": plain(183, 9, 1500),
    "release": plain(211, 1, 0),
    "script": plain(42702, 4, 0, 2, 1, x=32767, y=21600),
    "message": plain(217, 65535, 1.5, -2, 3),
}


@pytest.mark.parametrize("item", SOUND.values(), ids=SOUND)
def test_a_sound_item_is_left_alone(item: MissionItem) -> None:
    assert rules(check_items([HOME, item], SCRIPT), "error", "warning") <= {"gate-late"}


FAULTY = [
    # what the autopilot refuses, which leaves a mixed mission
    ("not-a-number", DRIVE._replace(param1=NAN)),
    ("not-a-number", DRIVE._replace(param4=INF)),
    ("not-a-number", plain(93, 1.0, -1, -1, NAN)),
    ("altitude", DRIVE._replace(z=40000.0)),
    ("altitude", DRIVE._replace(z=NAN)),
    ("frame", DRIVE._replace(frame=1)),
    ("frame", DRIVE._replace(frame=2)),
    ("place", DRIVE._replace(x=910_000_000)),
    ("place", DRIVE._replace(y=-1_810_000_000)),
    # what comes back other than it was sent
    ("truncated", DRIVE._replace(param1=65536.0)),
    ("truncated", DRIVE._replace(param1=-1.0)),
    ("truncated", DRIVE._replace(param2=2.0)),
    ("rounded", DRIVE._replace(param1=2.5)),
    ("rounded", DRIVE._replace(z=1.005)),
    ("truncated", plain(93, 1.0, 200, -1, -1)),
    ("truncated", plain(42702, 258)),
    ("truncated", plain(42702, 2, 256)),
    ("truncated", plain(42702, 2, 0, 2049)),
    ("rounded", plain(42702, 2, 0, 0.1)),
    ("truncated", plain(42702, 2, 0, 1, 70000)),
    ("truncated", plain(42702, 2, x=32768)),
    ("truncated", plain(42702, 2, y=-40000)),
    ("truncated", plain(42702, 2)._replace(z=1.0)),
    ("truncated", plain(181, 0, 1, 1)),
    ("truncated", plain(183, 9, 99999)),
    ("truncated", plain(183, 9, 1500.5)),
    ("truncated", plain(20, 1)),
    ("frame-without-place", plain(42702, 2)._replace(frame=3)),
    # what hangs it, is skipped, or does something else
    ("hangs", plain(211, 1, 2)),
    ("hangs", plain(211, 1, -1)),
    ("hangs", plain(94)),
    ("hangs", plain(21)),
    ("skipped", plain(42600, 1, 1)),
    ("unknown-command", plain(22)),
    ("unknown-command", plain(206)),
    ("delay-zero", plain(93)),
    ("delay-time", plain(93, 0, 24, 0, 0)),
    ("delay-time", plain(93, -5, -1, -1, -1)),
    ("delay-conflict", plain(93, 5, 12, 0, 0)),
    ("delay-long", plain(93, 4000, -1, -1, -1)),
    ("delay-time", plain(93, -1, -1, 60, 0)),
    ("script-timeout", plain(42702, 2, 30)),
    ("script-action", plain(42702, 9)),
    ("script-tag", plain(42702, 2, x=-1)),
    ("servo-pulse", plain(183, 9, 99999)),
    ("servo-pulse", plain(183, 9, 0)),
    ("no-output", plain(183, 33, 1500)),
    ("no-output", plain(183, 0, 1500)),
    ("no-output", plain(181, 16, 1)),
    ("output-in-use", plain(183, 1, 1500)),
    ("output-in-use", plain(183, 3, 1500)),
    ("relay-state", plain(181, 0, 2)),
    ("zero-place", DRIVE._replace(x=0, y=0)),
    ("autocontinue", DRIVE._replace(autocontinue=0)),
    ("sequence", DRIVE._replace(seq=2)),
]  # fmt: skip
WARNED = {"delay-long", "delay-conflict", "rounded", "frame-without-place", "script-timeout", "zero-place",
          "output-in-use"}  # fmt: skip


@pytest.mark.parametrize(("rule", "item"), FAULTY, ids=lambda value: value if isinstance(value, str) else "")
def test_a_fault_is_found_with_its_item_and_a_remedy(rule: str, item: MissionItem) -> None:
    found = [finding for finding in check_items([HOME, item], SCRIPT, "rover") if finding.rule == rule]
    assert found
    unknown_do = rule == "unknown-command" and item.command > 95
    for finding in found:
        assert (finding.robot, finding.item) == ("rover", 1)
        assert finding.severity == ("warning" if rule in WARNED or unknown_do else "error")
        assert firmware.command_name(item.command) in finding.where
        assert finding.problem
        assert finding.remedy
        assert "\n" not in str(finding)


def test_a_script_item_needs_the_script_on_board() -> None:
    (never,) = check_items([HOME, plain(42702, 2)], BARE)
    (idle,) = check_items([HOME, plain(42702, 2, 30)], BARE)
    assert (never.rule, idle.rule) == ("no-script", "no-script")
    assert "never ends" in never.problem
    assert "waits 30 s and counts as done" in idle.problem


def test_a_time_of_day_is_warned_of_and_a_hold_noted() -> None:
    until, hold = plain(93, 0, 14, 5, 30), item_at(2, 17, 52.481, 13.786)
    late, held = check_items([HOME, until, hold], BARE)
    assert (late.severity, late.item) == ("warning", 1)
    assert "until 14:05:30 UTC" in late.problem
    assert (held.severity, held.rule, held.item) == ("note", "holds", 2)


def test_the_storage_of_the_vehicle() -> None:
    drives = [DRIVE._replace(seq=seq) for seq in range(1, 656)]
    assert rules(check_items([HOME, *drives[:654]], SCRIPT)) == set()
    (full,) = check_items([HOME, *drives], SCRIPT)
    assert (full.rule, full.severity) == ("too-many-items", "error")
    assert "656 items with home, the vehicle stores 655" in full.problem
    small = VehicleSettings(max_items=3)
    assert rules(check_items([HOME, *drives[:2]], small)) == set()
    assert rules(check_items([HOME, *drives[:3]], small)) == {"too-many-items"}


def test_home_comes_first_whatever_it_says() -> None:
    assert rules(check_items([HOME._replace(param1=2.5, autocontinue=0), DRIVE], SCRIPT)) == set()
    assert rules(check_items([plain(42702, 2)._replace(seq=0), DRIVE], SCRIPT)) == {"no-home"}
    assert rules(check_items([], SCRIPT)) == {"no-home"}


def test_only_one_item_is_current() -> None:
    marked = [HOME._replace(current=1), DRIVE._replace(current=1)]
    assert rules(check_items(marked, SCRIPT), "warning") == {"current"}
    assert not check_items([marked[0], DRIVE], SCRIPT)


TEAMS = [
    with_vehicles(scout=vehicle, scout2=vehicle, carrier=vehicle)
    for vehicle in ({"payload": "script"}, {"payload": "manual"}, {"payload": BY_OUTPUTS})
]


@SETTINGS
@given(st.integers(0, 10**6), st.sampled_from(range(len(TEAMS))))
def test_what_is_compiled_is_sound_on_any_hardware(seed: int, team: int) -> None:
    mission = TEAMS[team]
    compiled = compile_plan(mission, random_plan(seed))
    for robot, sent in compiled.missions.items():
        found = check_items(lay_out(sent).items, mission.vehicle(robot), robot)
        assert rules(found, "error", "warning") == set()


numbers = st.one_of(
    st.integers(-300, 70000).map(float), st.floats(-10, 10, width=32), st.sampled_from([NAN, INF, -INF, 1e9])
)
whole = st.integers(-5, 5) | st.integers(-(2**31), 2**31 - 1)
commands = st.sampled_from([16, 17, 19, 20, 93, 112, 181, 183, 211, 217, 42702])
any_items = st.builds(
    MissionItem,
    seq=st.just(1), frame=st.sampled_from([0, 1, 2, 3, 6, 10]), current=st.just(0),
    command=commands, autocontinue=st.sampled_from([0, 1]),
    param1=numbers, param2=numbers, param3=numbers, param4=numbers,
    x=whole, y=whole, z=numbers,
)  # fmt: skip


@SETTINGS
@given(any_items)
def test_what_passes_is_what_the_simulated_firmware_keeps(item: MissionItem) -> None:
    """The firmware is written down twice, here and in the simulation: neither knows the other's tables."""
    if rules(check_items([HOME, item], SCRIPT), "error"):
        return
    assert differences([HOME, item], [HOME, stored(item, 0)]) == []


@SETTINGS
@given(any_items)
def test_what_the_simulated_firmware_refuses_or_changes_is_found(item: MissionItem) -> None:
    try:
        kept = stored(item, 0)
    except RefusedItemError:
        kept = None
    if kept is None or differences([HOME, item], [HOME, kept]):
        assert rules(check_items([HOME, item], SCRIPT), "error")


BAD_VALUES: dict[str, tuple[Any, ...]] = {
    "seq": (0, 99), "frame": (1, 4, 99), "command": (21, 94, 42600, 60000), "autocontinue": (0,),
    "param1": (NAN, INF, 1e6, -7.0), "param2": (NAN, INF, 1e6, -7.0), "param3": (NAN, INF, 1e6, 4097.0),
    "param4": (INF, 1e6, 4097.0), "x": (2**31 - 1,), "y": (2**31 - 1,), "z": (NAN, INF, 4e4),
}  # fmt: skip


@pytest.mark.parametrize("field", BAD_VALUES)
@pytest.mark.parametrize("payload", ["script", "outputs"])
def test_every_field_of_every_item_is_looked_at(field: str, payload: str) -> None:
    mission = with_vehicles(carrier={"payload": BY_OUTPUTS if payload == "outputs" else "script"})
    items = lay_out(compile_plan(mission, handoff_plan()).missions["carrier"]).items
    for item in items[1:]:
        for value in BAD_VALUES[field]:
            spoiled = items.copy()
            spoiled[item.seq] = item._replace(**{field: value})
            found = check_items(spoiled, mission.vehicle("carrier"))
            assert rules(found, "error", "warning") - {"gate-late"}, f"{field} {value} of {item}"


def test_the_simulated_firmware_knows_no_other_commands() -> None:
    """But for DO_CHANGE_SPEED, which ours never sends."""
    for command in firmware.COMMANDS.keys() - {firmware.MAV_CMD_DO_CHANGE_SPEED}:
        stored(item_at(1, command, 1.0, 1.0), 0)
