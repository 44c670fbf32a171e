"""The vehicles of a mission file: what may be said of them, and each fault with its line and key."""

from __future__ import annotations

import pytest

from malipp_field.errors import InputError
from malipp_field.mission import parse_mission
from malipp_field.mission.vehicles import ByGripper, ByHand, ByScript, ByServo

MISSION = """\
format: malipp-mission/1
name: yard
site:
  complete: true
  nodes:
    - {id: base, x_m: 0.0, y_m: 0.0, role: depot}
    - {id: a, x_m: 30.0, y_m: 0.0}
  fence: [{x_m: -5.0, y_m: -5.0}, {x_m: 50.0, y_m: -5.0}, {x_m: 50.0, y_m: 9.0}, {x_m: -5.0, y_m: 9.0}]
field: {kernel: {family: rbf, length_scale_m: 20.0}, test_points: [{x_m: 10.0, y_m: 1.0}]}
team:
  sample_mass_kg: 2.0
  robots:
    - {id: scout, start: base, depots: [base], empty_mass_kg: 20.0, energy_budget_j: 1000.0,
       payload_capacity: 2, samples_per_node: 1, noise_variance: 0.1, energy_per_kg_m: 3.0, speed_m_s: 1.0}
    - {id: carrier, start: base, depots: [base], empty_mass_kg: 90.0, energy_budget_j: 9000.0,
       payload_capacity: 8, samples_per_node: 0, noise_variance: 1.0, energy_per_kg_m: 3.0, speed_m_s: 1.0}
"""
VEHICLES = MISSION + """\
vehicles:
  carrier:
    system_id: 7
    payload:
      collect: {by: servo, channel: 9, pwm_us: 1900, duration_s: 5.0}
      drop: {by: gripper, move: release, duration_s: 3.0}
      unload: {by: manual}
    gate: time
    if_missing: go_on
ground_station: {system_id: 250}
"""  # fmt: skip

COLLECT, SYSTEM_ID = "vehicles.carrier.payload.collect", "vehicles.carrier.system_id"


def test_without_a_word_a_vehicle_runs_the_script_under_its_place_in_the_team() -> None:
    mission = parse_mission(MISSION)
    scout, carrier = mission.vehicle("scout"), mission.vehicle("carrier")
    assert (scout.system_id, carrier.system_id, carrier.component_id) == (1, 2, 1)
    assert (scout.payload.collect, scout.gate, scout.if_missing) == (ByScript(), "custody", "hold")
    assert (scout.max_items, scout.link, scout.signing_key) == (655, None, None)
    assert (mission.ground_station.system_id, mission.ground_station.component_id) == (255, 190)
    with pytest.raises(KeyError):
        mission.vehicle("nobody")


def test_each_action_has_its_own_means() -> None:
    mission = parse_mission(VEHICLES)
    payload = mission.vehicle("carrier").payload
    assert payload.collect == ByServo(by="servo", channel=9, pwm_us=1900, duration_s=5.0)
    assert payload.drop == ByGripper(by="gripper", move="release", duration_s=3.0)
    assert (payload.pick, payload.unload) == (ByScript(), ByHand(by="manual"))
    assert (mission.vehicle("carrier").system_id, mission.vehicle("scout").system_id) == (7, 1)


def test_one_word_stands_for_all_actions() -> None:
    payload = parse_mission(MISSION + "vehicles: {scout: {payload: manual}}").vehicle("scout").payload
    assert {payload.collect, payload.drop, payload.pick, payload.unload} == {ByHand(by="manual")}


def test_a_word_that_does_not_do_for_all_actions_is_told_with_those_that_do() -> None:
    with pytest.raises(InputError, match="expected script or manual for all actions, or keys for collect"):
        parse_mission(MISSION + "vehicles: {scout: {payload: servo}}")


@pytest.mark.parametrize(
    ("old", "new", "line", "key", "words"),
    [
        ("  carrier:\n", "  carier:\n", 18, "vehicles.carier", "did you mean 'carrier'?"),
        ("system_id: 7", "system_id: 1", 19, SYSTEM_ID, "1 of 'carrier' is that of 'scout' already"),
        ("system_id: 7", "system_id: 250", 19, SYSTEM_ID, "that of the ground station already"),
        ("system_id: 7", "system_id: 256", 19, SYSTEM_ID, "less than or equal to 255"),
        ("system_id: 250", "system_id: 1", None, "vehicles.scout", "that of the ground station already"),
        ("pwm_us: 1900", "pwm_us: 99999", 21, COLLECT, "less than or equal to 2500"),
        ("pwm_us: 1900, ", "", 21, COLLECT, "is missing"),
        ("channel: 9", "chanel: 9", 21, COLLECT, "unknown key"),
        ("move: release", "move: 2", 22, "vehicles.carrier.payload.drop", "'grab' or 'release'"),
        ("by: manual", "by: hand", 23, "vehicles.carrier.payload.unload",
         "expected 'by' to be 'script', 'manual', 'servo', 'relay', 'gripper'; found 'hand'"),
        ("{by: manual}", "servo", 23, "vehicles.carrier.payload.unload",
         "expected keys, such as {by: manual}, found 'servo'"),
        ("{by: manual}", "{move: grab}", 23, "vehicles.carrier.payload.unload", "'by' is missing"),
        ("      unload: ", "      unlaod: ", 23, "vehicles.carrier.payload.unlaod", "did you mean 'unload'?"),
        ("gate: time", "gate: never", 24, "vehicles.carrier.gate", "'custody' or 'time'"),
        ("if_missing: go_on", "if_missing: ignore", 25, "vehicles.carrier.if_missing", "'hold' or 'go_on'"),
        ("x_m: 50.0, y_m: -5.0", "x_m: 10.0, y_m: -5.0", 7, "site.nodes[1]", "'a' lies outside the fence"),
        ("{x_m: 50.0, y_m: -5.0}, {x_m: 50.0, y_m: 9.0}", "{x_m: 50.0, y_m: 9.0}, {x_m: 50.0, y_m: -5.0}", 8,
         "site.fence", "the outline crosses itself"),
    ],
)  # fmt: skip
def test_a_fault_is_told_with_its_line_and_key(
    old: str, new: str, line: int | None, key: str, words: str
) -> None:
    assert VEHICLES.count(old) == 1
    with pytest.raises(InputError) as caught:
        parse_mission(VEHICLES.replace(old, new))
    fault = caught.value
    assert fault.where.startswith(key), str(fault)
    assert words in fault.problem, str(fault)
    if line is not None:
        assert fault.line == line, str(fault)


def test_an_edge_may_not_leave_the_fence() -> None:
    bent = VEHICLES.replace("  complete: true\n", "  edges: [{from: base, to: a}]\n").replace(
        "{x_m: -5.0, y_m: -5.0}, ", "{x_m: -5.0, y_m: -5.0}, {x_m: 12.0, y_m: 3.0}, "
    )
    with pytest.raises(InputError, match=r"site\.edges\[0\]: the straight edge base to a leaves the fence"):
        parse_mission(bent)
