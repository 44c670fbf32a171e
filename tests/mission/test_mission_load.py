"""The mission reader: what it accepts, and each fault with its file, line, key and a hint."""

from __future__ import annotations

from pathlib import Path

import pytest

from malipp_field.documents import parse_document
from malipp_field.errors import InputError
from malipp_field.mission import parse_mission, read_mission
from malipp_field.mission.schema import PlannerOptions, Replanning, Simulation

VALID = """\
format: malipp-mission/1
name: test
site:
  origin: {lat_deg: 52.48, lon_deg: 13.785}
  nodes:
    - {id: base, x_m: 0.0, y_m: 0.0, role: depot}
    - {id: start, lat_deg: 52.4801, lon_deg: 13.7851, role: start}
    - {id: a1, x_m: 30.0, y_m: 0.0}
    - {id: a2, x_m: 60.0, y_m: 0.0}
    - {id: v1, x_m: 30.0, y_m: 30.0, role: via}
  edges:
    - {from: start, to: base}
    - {from: base, to: a1}
    - {from: a1, to: a2, energy_factor: {carrier: 1.4}, speed_factor: {carrier: 0.5}, closed_to: [scout]}
    - {from: a1, to: v1, one_way: true, length_m: 50.0}
    - {from: v1, to: a2}
  keep_outs:
    - id: pond
      polygon: [{x_m: 40.0, y_m: 5.0}, {x_m: 50.0, y_m: 5.0}, {x_m: 45.0, y_m: 10.0}]
field:
  kernel: {family: rbf, length_scale_m: 20.0}
  test_points:
    - {x_m: 10.0, y_m: 10.0}
team:
  sample_mass_kg: 2.0
  robots:
    - {id: scout, start: start, depots: [base], empty_mass_kg: 20.0, energy_budget_j: 1000.0,
       payload_capacity: 2, samples_per_node: 1, noise_variance: 0.1, energy_per_kg_m: 3.0, speed_m_s: 1.0}
    - {id: carrier, start: base, depots: [base], empty_mass_kg: 90.0, energy_budget_j: 9000.0,
       payload_capacity: 8, samples_per_node: 0, noise_variance: 1.0, energy_per_kg_m: 3.0, speed_m_s: 1.0}
simulation:
  terrain: [{x_m: 1.0, y_m: 2.0, radius_m: 3.0}]
"""
MISSIONS = Path(__file__).parents[2] / "missions"


def test_the_valid_mission_and_its_defaults() -> None:
    mission = parse_mission(VALID)
    assert mission.robot("carrier").payload_capacity == 8
    assert mission.site.edges[0].from_ == "start"
    assert (mission.planner.method, mission.planner.time_limit_s, mission.planner.energy_reserve) == (
        "auto",
        60.0,
        0.0,
    )
    assert (mission.replanning.slip_s, mission.simulation.speed) == (30.0, 20.0)
    assert (mission.team.service_time_s, mission.field.kernel.variance) == (0.0, 1.0)
    with pytest.raises(KeyError):
        mission.robot("nobody")


@pytest.mark.parametrize(
    ("old", "new", "line", "key", "words"),
    [
        ("format: malipp-mission/1", "format: malipp-mission/2", 1, "format", "'malipp-mission/1'"),
        ("name: test", "name: 'no good'", 2, "name", "without blanks, found 'no good'"),
        ("name: test\n", "", None, "name", "is missing"),
        ("team:", "teams:", 24, "teams", "unknown key; did you mean 'team'?"),
        (
            "  origin: {lat_deg: 52.48,",
            "  origin: {lat_deg: 92.48,",
            4,
            "site.origin.lat_deg",
            "less than or equal to 90",
        ),
        (
            "    - {id: a1, x_m: 30.0,",
            "    - {id: a1, x_m: far,",
            8,
            "site.nodes[2].x_m",
            "expected a number, found 'far'",
        ),
        (
            "{id: a1, x_m: 30.0, y_m: 0.0}",
            "{id: a1, x_m: 30.0}",
            8,
            "site.nodes[2]",
            "either x_m and y_m, or lat_deg",
        ),
        (
            "{id: a1, x_m: 30.0,",
            "{id: a1, lat_deg: 52.0, x_m: 30.0,",
            8,
            "site.nodes[2]",
            "either x_m and y_m, or",
        ),
        ("role: via", "role: shop", 10, "site.nodes[4].role", "'candidate', 'depot', 'start' or 'via'"),
        ("{id: a2,", "{id: a1,", 9, "site.nodes[3].id", "node 'a1' is given already by nodes[2]"),
        (
            "{id: a2,",
            "{id: a2, color: red,",
            9,
            "site.nodes[3].color",
            "unknown key; known here: x_m, y_m, lat_deg",
        ),
        ("to: base}", "to: bse}", 12, "site.edges[0].to", "unknown node 'bse'; did you mean 'base'?"),
        (
            "{from: base, to: a1}",
            "{from: a1, to: a1}",
            13,
            "site.edges[1].to",
            "two different nodes, found 'a1' twice",
        ),
        (
            "{from: v1, to: a2}",
            "{from: a1, to: base}",
            16,
            "site.edges[4]",
            "a1 to base is given already by edges[1]",
        ),
        (
            "energy_factor: {carrier",
            "energy_factor: {carier",
            14,
            "site.edges[2].energy_factor.carier",
            "did you mean 'carrier'",
        ),
        (
            "speed_factor: {carrier: 0.5}",
            "speed_factor: {carrier: 0.0}",
            14,
            "site.edges[2].speed_factor.carrier",
            "greater than 0",
        ),
        (
            "closed_to: [scout]",
            "closed_to: [snout]",
            14,
            "site.edges[2].closed_to[0]",
            "unknown robot 'snout'; did you mean 'scout'?",
        ),
        ("length_m: 50.0", "length_m: -1.0", 15, "site.edges[3].length_m", "greater than 0, found -1.0"),
        (
            "{x_m: 45.0, y_m: 10.0}]",
            "{x_m: 45.0, y_m: -5.0}]",
            14,
            "site.edges[2]",
            "a1 to a2 crosses keep-out 'pond'; lead it round",
        ),
        (
            ", {x_m: 45.0, y_m: 10.0}]",
            "]",
            19,
            "site.keep_outs[0].polygon",
            "at least 3 items needed, found 2",
        ),
        (
            "{x_m: 45.0, y_m: 10.0}]",
            "{x_m: 40.0, y_m: 10.0}, {x_m: 50.0, y_m: 10.0}]",
            19,
            "site.keep_outs[0].polygon",
            "'pond' crosses itself",
        ),
        ("family: rbf", "family: cubic", 21, "field.kernel.family", "'rbf', 'matern32' or 'matern52'"),
        ("length_scale_m: 20.0", "length_scale_m: 0.0", 21, "field.kernel.length_scale_m", "greater than 0"),
        (
            "    - {x_m: 10.0, y_m: 10.0}",
            "    []",
            22,
            "field.test_points",
            "at least 1 item needed, found 0",
        ),
        (
            "sample_mass_kg: 2.0",
            "sample_mass_kg: .nan",
            25,
            "team.sample_mass_kg",
            "expected a finite number, found nan",
        ),
        (
            "start: start,",
            "start: stat,",
            27,
            "team.robots[0].start",
            "unknown node 'stat'; did you mean 'start'?",
        ),
        (
            "depots: [base], empty_mass_kg: 20",
            "depots: [a1], empty_mass_kg: 20",
            27,
            "team.robots[0].depots[0]",
            "has role candidate, a depot is needed",
        ),
        (
            "depots: [base], empty_mass_kg: 20",
            "depots: [], empty_mass_kg: 20",
            27,
            "team.robots[0].depots",
            "at least 1 item needed, found 0",
        ),
        (
            "depots: [base], empty_mass_kg: 20",
            "depots: [base, base], empty_mass_kg: 20",
            27,
            "team.robots[0].depots",
            "the same depot is listed twice",
        ),
        (
            "payload_capacity: 2,",
            "payload_capacity: 2.5,",
            28,
            "team.robots[0].payload_capacity",
            "expected a whole number, found 2.5",
        ),
        ("noise_variance: 0.1,", "", 27, "team.robots[0].noise_variance", "is missing"),
        (
            "{id: carrier,",
            "{id: scout,",
            14,
            "site.edges[2].energy_factor.carrier",
            "unknown robot 'carrier'",
        ),
        (
            "terrain: [{x_m: 1.0,",
            "terrain: [{lat_deg: 1.0,",
            32,
            "simulation.terrain[0]",
            "either x_m and y_m",
        ),
    ],
)
def test_each_fault_has_its_line_key_and_hint(
    old: str, new: str, line: int | None, key: str, words: str
) -> None:
    assert VALID.count(old) == 1
    with pytest.raises(InputError) as caught:
        parse_mission(VALID.replace(old, new), "test.yaml")
    fault = caught.value
    assert (fault.source, fault.where) == ("test.yaml", key)
    assert words in fault.problem
    if line is not None:
        assert fault.line == line
        assert str(fault).startswith(f"test.yaml:{line}: {key}: ")
    assert "\n" not in str(fault)


@pytest.mark.parametrize(
    ("old", "new", "line", "words"),
    [
        ("team:", "planner: {method: magic}\nteam:", 24, "'no-handoffs', 'seq', 'miqp', 'arcs'"),
        ("team:", "planner: {energy_reserve: 1.0}\nteam:", 24, "less than 1"),
        ("team:", "planner: {seed: -1}\nteam:", 24, "greater than or equal to 0"),
        ("team:", "replanning: {slip_s: 0}\nteam:", 24, "greater than 0"),
        ("team:", "simulation: {speed: fast}\nteam:", 24, "found duplicate key"),
    ],
)
def test_optional_sections(old: str, new: str, line: int, words: str) -> None:
    text = VALID.replace(old, new)
    with pytest.raises(InputError) as caught:
        parse_mission(text)
    assert words in caught.value.problem
    if "duplicate" not in words:
        assert caught.value.line == line


def test_duplicate_robots() -> None:
    text = VALID.replace("{id: carrier,", "{id: scout,").replace("carrier", "scout")
    with pytest.raises(
        InputError, match=r"mission:29: team\.robots\[1\]\.id: robot 'scout' is given already by robots\[0\]"
    ):
        parse_mission(text)


@pytest.mark.parametrize(
    ("old", "line", "key"),
    [
        ("", 7, "site.nodes[1]"),
        ("start", 22, "field.test_points[0]"),
    ],
)
def test_degrees_need_an_origin(old: str, line: int, key: str) -> None:
    text = VALID.replace("  origin: {lat_deg: 52.48, lon_deg: 13.785}\n", "  complete: false\n")
    if old:
        text = text.replace("lat_deg: 52.4801, lon_deg: 13.7851", "x_m: 5.0, y_m: 5.0")
        text = text.replace("    - {x_m: 10.0, y_m: 10.0}", "    - {lat_deg: 52.0, lon_deg: 13.0}")
        line = 23
    with pytest.raises(InputError) as caught:
        parse_mission(text)
    assert (caught.value.line, caught.value.where) == (line, key)
    assert caught.value.problem == "a place in degrees needs site.origin"


def test_a_site_that_cannot_be_left() -> None:
    start, end = VALID.index("  edges:"), VALID.index("  keep_outs:")
    with pytest.raises(InputError, match="no node can be left: give edges, or complete: true"):
        parse_mission(VALID[:start] + VALID[end:])


def test_the_file_is_named_as_the_user_named_it(tmp_path: Path) -> None:
    path = tmp_path / "m.yaml"
    path.write_text(VALID.replace("to: base}", "to: bse}"))
    with pytest.raises(InputError, match=f"{path}:12: site"):
        read_mission(path)


@pytest.mark.parametrize("name", ["corridor", "quarry"])
def test_the_shipped_missions_are_read(name: str) -> None:
    mission = read_mission(MISSIONS / f"{name}.yaml")
    assert mission.name == name
    assert mission.site.origin is not None


def test_the_quarry_is_what_its_comments_say() -> None:
    mission = read_mission(MISSIONS / "quarry.yaml")
    assert sum(node.role == "candidate" for node in mission.site.nodes) == 14
    assert all(node.lat_deg is not None for node in mission.site.nodes)
    assert (len(mission.site.keep_outs), len(mission.team.robots), len(mission.simulation.terrain)) == (
        4,
        3,
        1,
    )
    assert mission.planner.energy_reserve > 0


def test_the_optional_sections_are_documented_with_their_defaults() -> None:
    text = (MISSIONS.parent / "docs" / "formats.md").read_text()
    blocks = [parse_document(part.split("```")[0], "formats.md").data for part in text.split("```yaml\n")[1:]]
    planner, optional = blocks[0]["planner"], blocks[1]
    optional["simulation"].pop("terrain")
    assert PlannerOptions.model_validate(planner) == PlannerOptions()
    assert set(planner) == set(PlannerOptions.model_fields)
    assert Replanning.model_validate(optional["replanning"]) == Replanning()
    assert set(optional["replanning"]) == set(Replanning.model_fields)
    assert Simulation.model_validate(optional["simulation"]) == Simulation()
    assert {*optional["simulation"], "terrain"} == set(Simulation.model_fields)
