"""Plan files: what is written is read back, and what cannot be a plan is refused with its line."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from malipp_field.errors import InputError
from malipp_field.mission import parse_mission
from malipp_field.plan import (
    Bound,
    Objective,
    Plan,
    RobotPlan,
    Stop,
    parse_plan,
    plan_text,
    read_plan,
    read_plan_of,
    write_plan,
)

# The example of docs/formats.md, complete.
EXAMPLE = """\
{"format": "malipp-plan/1", "mission": "quarry", "method": "exact", "status": "optimal",
 "objective": {"information": 5.0433, "energy_j": 71.2, "makespan_s": 40.1},
 "bound": {"information": 5.0429}, "gap": 0.0001, "solve_time_s": 12.3, "seed": 0,
 "robots": [
  {"id": "scout", "route": [
    {"node": "base", "depart_s": 0.0, "payload": 0},
    {"node": "a1", "path": ["base", "h1", "a1"], "arrive_s": 12.0, "depart_s": 12.0, "leg_energy_j": 12.0,
     "collect": 1, "drop": {"carrier": 1}, "pick": {}, "unload": 0, "payload": 0},
    {"node": "base", "path": ["a1", "base"], "arrive_s": 24.0, "depart_s": 24.0, "leg_energy_j": 12.0,
     "collect": 0, "drop": {}, "pick": {}, "unload": 0, "payload": 0}]}]}
"""

finite = st.floats(-1e6, 1e6)
counts = st.integers(0, 5)
names = st.sampled_from(["scout", "carrier", "a1", "base"])
transfers = st.dictionaries(names, st.integers(1, 4), max_size=2)
stops = st.builds(
    Stop, node=names, path=st.none() | st.lists(names, min_size=1, max_size=3).map(tuple),
    arrive_s=st.none() | finite, depart_s=finite, leg_energy_j=st.none() | finite, collect=counts,
    drop=transfers, pick=transfers, unload=counts, payload=counts,
)  # fmt: skip
starts = st.builds(
    Stop, node=names, depart_s=finite, collect=counts, drop=transfers, pick=transfers, unload=counts,
    payload=counts,
)  # fmt: skip
routes = st.tuples(starts, st.lists(stops, max_size=3)).map(lambda found: (found[0], *found[1]))
plans = st.builds(
    Plan, mission=names, version=st.integers(1, 9), method=st.just("exact"),
    status=st.sampled_from(["optimal", "feasible", "infeasible", "no_plan"]),
    reason=st.none() | st.text(max_size=20),
    objective=st.none() | st.builds(Objective, information=finite, energy_j=finite, makespan_s=finite),
    bound=st.builds(Bound, information=st.none() | finite), gap=st.none() | finite, solve_time_s=finite,
    seed=counts, robots=st.lists(st.builds(RobotPlan, id=names, route=routes), max_size=2).map(tuple),
)  # fmt: skip


@settings(deadline=None)
@given(plans)
def test_what_is_written_is_read_back(plan: Plan) -> None:
    assert parse_plan(plan_text(plan)) == plan


def test_the_documented_example() -> None:
    plan = parse_plan(EXAMPLE)
    assert (plan.version, plan.reason, plan.handoffs) == (1, None, 1)
    assert (plan.robot("scout").energy_j, plan.robot("scout").collected) == (24.0, 1)
    assert plan.robots[0].route[1].path == ("base", "h1", "a1")
    with pytest.raises(KeyError):
        plan.robot("carrier")
    written = json.loads(plan_text(plan))
    assert written.pop("version") == 1
    assert written == json.loads(EXAMPLE)


def test_a_file_is_written_whole(tmp_path: Path) -> None:
    path = tmp_path / "new" / "plan.json"
    write_plan(parse_plan(EXAMPLE), path)
    assert read_plan(path) == parse_plan(EXAMPLE)
    assert [found.name for found in path.parent.iterdir()] == ["plan.json"]


def test_a_file_that_cannot_be_written(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot be written"):
        write_plan(parse_plan(EXAMPLE), tmp_path / "file" / "plan.json")


@pytest.mark.parametrize(
    ("old", "new", "line", "key", "words"),
    [
        ("malipp-plan/1", "malipp-plan/2", 1, "format", "'malipp-plan/1'"),
        (
            '"status": "optimal"',
            '"status": "best"',
            1,
            "status",
            "'optimal', 'feasible', 'infeasible' or 'no_plan'",
        ),
        ('"energy_j": 71.2, ', "", 2, "objective.energy_j", "is missing"),
        ('"seed": 0', '"seed": 0.5', 3, "seed", "expected a whole number, found 0.5"),
        ('"seed": 0', '"sead": 0', 3, "sead", "did you mean 'seed'?"),
        (
            '"depart_s": 0.0',
            '"depart_s": "noon"',
            6,
            "robots[0].route[0].depart_s",
            "expected a number, found 'noon'",
        ),
        ('"collect": 1', '"collect": -1', 8, "robots[0].route[1].collect", "greater than or equal to 0"),
        (
            '{"carrier": 1}',
            '{"carrier": 0}',
            8,
            "robots[0].route[1].drop.carrier",
            "greater than or equal to 1",
        ),
        (
            '"path": ["a1", "base"]',
            '"path": "a1"',
            9,
            "robots[0].route[2].path",
            "expected a list, found 'a1'",
        ),
        (
            '"solve_time_s": 12.3',
            '"solve_time_s": .inf',
            3,
            "solve_time_s",
            "expected a finite number, found inf",
        ),
    ],
)
def test_bad_plans(old: str, new: str, line: int, key: str, words: str) -> None:
    assert EXAMPLE.count(old) == 1
    with pytest.raises(InputError) as caught:
        parse_plan(EXAMPLE.replace(old, new), "plan.json")
    assert (caught.value.line, caught.value.where) == (line, key)
    assert words in caught.value.problem


def test_a_route_has_a_start() -> None:
    start = EXAMPLE.index('[\n    {"node"')
    with pytest.raises(InputError, match=r"robots\[0\]\.route: .*at least 1 item"):
        parse_plan(EXAMPLE[:start] + "[]}]}")


MISSION = parse_mission("""\
format: malipp-mission/1
name: quarry
site:
  nodes:
    - {id: base, x_m: 0.0, y_m: 0.0, role: depot}
    - {id: h1, x_m: 6.0, y_m: 0.0, role: via}
    - {id: a1, x_m: 12.0, y_m: 0.0}
  edges: [{from: base, to: h1}, {from: h1, to: a1}]
field:
  kernel: {family: rbf, length_scale_m: 20.0}
  test_points: [{x_m: 12.0, y_m: 5.0}]
team:
  sample_mass_kg: 1.0
  robots:
    - {id: scout, start: base, depots: [base], empty_mass_kg: 10.0, energy_budget_j: 2000.0,
       payload_capacity: 2, samples_per_node: 1, noise_variance: 0.1, energy_per_kg_m: 1.0, speed_m_s: 1.0}
    - {id: carrier, start: base, depots: [base], empty_mass_kg: 10.0, energy_budget_j: 2000.0,
       payload_capacity: 2, samples_per_node: 1, noise_variance: 0.1, energy_per_kg_m: 1.0, speed_m_s: 1.0}
""")


def test_a_plan_of_that_mission_is_read(tmp_path: Path) -> None:
    path = tmp_path / "plan.json"
    path.write_text(EXAMPLE)
    assert read_plan_of(MISSION, path) == parse_plan(EXAMPLE)


@pytest.mark.parametrize(
    ("old", "new", "line", "key", "words"),
    [
        ('"quarry"', '"query"', 1, "mission", "a plan of mission 'query'; the mission is 'quarry'"),
        ('"id": "scout"', '"id": "scot"', 5, "robots[0].id", "no robot 'scot'; did you mean 'scout'?"),
        ('{"node": "a1"', '{"node": "a11"', 7, "robots[0].route[1].node", "no node 'a11'; did you mean"),
        ('["base", "h1"', '["base", "h12"', 7, "robots[0].route[1].path[1]", "no node 'h12'; did you mean"),
        ('{"carrier": 1}', '{"carier": 1}', 8, "robots[0].route[1].drop.carier", "mean 'carrier'?"),
        ('"pick": {}, "unload": 0, "payload": 0},', '"pick": {"scotty": 1}, "unload": 0, "payload": 0},',
         8, "robots[0].route[1].pick.scotty", "no robot 'scotty'; did you mean 'scout'?"),
    ],
)  # fmt: skip
def test_a_name_the_mission_does_not_have(
    tmp_path: Path, old: str, new: str, line: int, key: str, words: str
) -> None:
    assert EXAMPLE.count(old) == 1
    path = tmp_path / "plan.json"
    path.write_text(EXAMPLE.replace(old, new))
    with pytest.raises(InputError) as fault:
        read_plan_of(MISSION, path)
    assert str(fault.value).startswith(f"{path}:{line}: {key}: ")
    assert words in str(fault.value)
