"""`malipp check` as a user meets it, and what `export` and `run` say of the same faults."""

from __future__ import annotations

import io
from pathlib import Path

import pytest
from rich.console import Console

from malipp_field.cli.app import main
from malipp_field.cli.check import print_findings
from malipp_field.vehicle.finding import Spot

MISSION = """\
format: malipp-mission/1
name: tiny
site:
  origin: {lat_deg: 50.0, lon_deg: 8.0}
  complete: true
  nodes:
    - {id: base, x_m: 0, y_m: 0, role: depot}
    - {id: a, x_m: 30, y_m: 0}
    - {id: b, x_m: 30, y_m: 20}
field:
  kernel: {family: rbf, length_scale_m: 20}
  test_points: [{x_m: 30, y_m: 10}]
team:
  sample_mass_kg: 1.0
  robots:
    - id: rover
      start: base
      depots: [base]
      empty_mass_kg: 10.0
      energy_budget_j: 2000.0
      payload_capacity: 2
      samples_per_node: 1
      noise_variance: 0.1
      energy_per_kg_m: 1.0
      speed_m_s: 1.0
"""
VEHICLE = """\
vehicles:
  rover:
    link: udpin:0.0.0.0:14550
    signing_key: rover.key
    max_items: 9
    payload: {collect: {by: servo, channel: 9, pwm_us: 1900, rest_us: 1100, duration_s: 30.0}}
"""


def status(*arguments: object) -> int:
    with pytest.raises(SystemExit) as ended:
        main([str(argument) for argument in arguments])
    assert isinstance(ended.value.code, int)
    return ended.value.code


@pytest.fixture
def mission(tmp_path: Path) -> Path:
    path = tmp_path / "tiny.yaml"
    path.write_text(MISSION)
    return path


@pytest.fixture
def plan(mission: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Path:
    path = tmp_path / "plan.json"
    assert status("plan", mission, "--method", "seq", "-o", path) == 0
    capsys.readouterr()
    return path


def test_a_sound_mission_is_ready(mission: Path, plan: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert status("check", mission, plan) == 0
    said = capsys.readouterr()
    assert said.out.splitlines() == [
        "team",
        "  warning rover: no link: nothing can be sent there",
        "          -> under vehicles, give a link (udpin, udpout, tcp or serial)",
        f"{plan}: ready, with 1 warning",
    ]
    assert said.err == ""


def test_faults_are_told_with_their_remedies(
    mission: Path, plan: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    mission.write_text(MISSION + VEHICLE)
    assert status("check", mission, plan) == 2
    said = capsys.readouterr().out
    assert said.startswith("rover\n  error   its signing key ")
    assert (
        "items with home, the vehicle stores 9: it refuses all of them\n          -> plan fewer stops" in said
    )
    assert "its actions take 30 s, the plan gives a stop 0 s" in said
    assert said.endswith(f"{plan}: 2 errors, 1 warning: not to be uploaded\n")
    assert "\x1b" not in said
    key = tmp_path / "rover.key"
    key.write_text("0" * 64)
    key.chmod(0o644)
    assert status("check", mission, plan) == 2
    assert f"others may read its signing key {key}\n          -> chmod 600 {key}" in capsys.readouterr().out
    key.chmod(0o600)
    mission.write_text(MISSION + VEHICLE.replace("max_items: 9", "max_items: 99"))
    assert status("check", mission, plan) == 0
    assert capsys.readouterr().out.endswith(f"{plan}: ready, with 1 warning\n")


def test_the_worst_comes_first_and_what_is_found_at_many_items_is_said_once() -> None:
    drops = [Spot("rover", item, f"hub: drop {item}") for item in (4, 7)]
    findings = [
        Spot("rover", 2, "a").warning("rounded", "is rounded", "do not"),
        Spot("scout").note("operator", "holds", "be there"),
        *(spot.error("hangs", "hangs", "use 0 or 1") for spot in drops),
    ]
    console = Console(file=io.StringIO(), width=40)
    print_findings(findings, console)
    assert isinstance(console.file, io.StringIO)
    assert console.file.getvalue().splitlines() == [
        "rover",
        "  error   item 4 (hub: drop 4); item 7 (hub: drop 7): hangs",
        "          -> use 0 or 1",
        "  warning item 2 (a): is rounded",
        "          -> do not",
        "scout",
        "  note    holds",
        "          -> be there",
    ]


def test_one_robot_and_a_start(mission: Path, plan: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert status("check", mission, plan, "--robot", "rover", "--start", "2027-05-04T09:30") == 0
    capsys.readouterr()
    assert status("check", mission, plan, "--robot", "rower") == 2
    assert capsys.readouterr().err == f"{mission}: has no robot 'rower'; did you mean 'rover'?\n"
    assert status("check", mission, plan, "--start", "soon") == 2
    assert "'soon' is no time such as 2026-11-22T16:00Z" in capsys.readouterr().err


def test_a_plan_that_breaks_a_rule_is_not_looked_at(
    mission: Path, plan: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    mission.write_text(MISSION.replace("energy_budget_j: 2000.0", "energy_budget_j: 100.0"))
    assert status("check", mission, plan) == 2
    said = capsys.readouterr()
    assert (said.out, said.err.count("\n")) == ("", 1)
    assert "eq:energy_budget" in said.err


def test_export_tells_of_faults_and_run_does_not_fly_with_errors(
    mission: Path, plan: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    mission.write_text(MISSION + VEHICLE)
    assert status("export", mission, plan, "--format", "plan", "-o", tmp_path / "out") == 0
    said = capsys.readouterr()
    assert "error   " in said.err
    assert "link" not in said.err
    assert [Path(line).name for line in said.out.split()] == ["tiny-rover.plan", "tiny-steps.json"]
    assert status("run", mission, "--plan", plan, "-o", tmp_path / "flight") == 2
    assert capsys.readouterr().err.endswith("the missions of the plan are not to be uploaded\n")
    assert not (tmp_path / "flight" / "run.mcap").exists()
