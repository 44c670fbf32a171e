"""The commands as a user meets them: what they make, and one clear line for one mistake."""

from __future__ import annotations

import json
import os
import socket
from pathlib import Path

import pytest
from rich.console import Console

from malipp_field.cli.app import main
from malipp_field.cli.display import plan_table
from malipp_field.cli.plan import Method
from malipp_field.mission import read_mission
from malipp_field.plan import Plan, read_plan

TINY = """\
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


@pytest.fixture
def mission(tmp_path: Path) -> Path:
    path = tmp_path / "tiny.yaml"
    path.write_text(TINY)
    return path


@pytest.fixture
def plan(mission: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Path:
    path = tmp_path / "plan.json"
    assert status("plan", mission, "-o", path) == 0
    capsys.readouterr()
    return path


def status(*arguments: object) -> int:
    with pytest.raises(SystemExit) as ended:
        main([str(argument) for argument in arguments])
    assert isinstance(ended.value.code, int)
    return ended.value.code


def one_line(captured: pytest.CaptureFixture[str]) -> str:
    """Return what was said on stderr, which must be one line and no traceback."""
    said = captured.readouterr().err
    assert said.count("\n") == 1, said
    assert "Traceback" not in said
    return said


def edit(path: Path, old: str, new: str) -> Path:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    return path


def test_plan_verify_and_export(mission: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "out" / "plan.json"
    assert status("plan", mission, "-o", path) == 0
    assert read_plan(path).status == "optimal"
    assert "rover" in capsys.readouterr().out
    assert status("verify", mission, path) == 0
    assert "every rule is kept" in capsys.readouterr().out
    assert status("export", mission, path, "--format", "plan", "-o", tmp_path / "plans") == 0
    assert status("export", mission, path, "--format", "wpl", "-o", tmp_path / "wpl") == 0
    written = [Path(line) for line in capsys.readouterr().out.split()]
    assert {p.suffix for p in written} == {".plan", ".waypoints", ".json"}
    assert all(p.stat().st_size > 0 for p in written)


@pytest.mark.parametrize("method", [method.value for method in Method])
def test_every_method_plans(method: str, mission: Path, tmp_path: Path) -> None:
    path = tmp_path / "plan.json"
    assert status("plan", mission, "--method", method, "-o", path) == 0
    found = read_plan(path)
    assert found.robot("rover").collected == 2


def test_an_infeasible_mission_is_status_3_with_the_reason(
    mission: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    edit(
        mission,
        "x_m: 0, y_m: 0, role: depot}",
        "x_m: 0, y_m: 0, role: depot}\n    - {id: s, x_m: 500, y_m: 0, role: start}",
    )
    edit(mission, "start: base", "start: s")
    path = tmp_path / "plan.json"
    assert status("plan", mission, "-o", path) == 3
    assert "rover" in capsys.readouterr().out
    found = read_plan(path)
    assert (found.status, found.robots) == ("infeasible", ())
    assert found.reason is not None
    assert "rover" in found.reason


def test_help_says_what_each_command_does(capsys: pytest.CaptureFixture[str]) -> None:
    assert status("--help") == 0
    said = capsys.readouterr().out
    for command in ("plan", "verify", "check", "export", "sim", "run", "review"):
        assert f"  {command} " in said
        assert status(command, "--help") == 0
        assert len(capsys.readouterr().out) > 200


def test_the_version_is_told(capsys: pytest.CaptureFixture[str]) -> None:
    assert status("--version") == 0
    assert capsys.readouterr().out.startswith("malipp 0.")


COMMANDS_ON_A_MISSION = [
    ("plan", "{}", "-o", "out.json"),
    ("verify", "{}", "plan.json"),
    ("check", "{}", "plan.json"),
    ("export", "{}", "plan.json", "--format", "plan", "-o", "out"),
    ("sim", "{}"),
    ("run", "{}", "-o", "out"),
]


@pytest.mark.parametrize("command", COMMANDS_ON_A_MISSION, ids=lambda command: command[0])
def test_a_mission_file_that_is_not_there(
    command: tuple[str, ...],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert status(*(part.format("nowhere.yaml") for part in command)) == 2
    assert one_line(capsys) == "nowhere.yaml: no such file\n"


@pytest.mark.parametrize("command", COMMANDS_ON_A_MISSION, ids=lambda command: command[0])
def test_a_mistake_in_the_mission_file(
    command: tuple[str, ...],
    mission: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(mission.parent)
    edit(mission, "start: base", "start: bse")
    assert status(*(part.format("tiny.yaml") for part in command)) == 2
    assert one_line(capsys) == (
        "tiny.yaml:17: team.robots[0].start: unknown node 'bse'; did you mean 'base'?\n"
    )


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("plan", "{m}"), "malipp plan: Missing option '--output'"),
        (("plan", "{m}", "-o", "p.json", "--method", "magic"), "'magic' is not one of"),
        (("plan", "{m}", "-o", "p.json", "--time-limit", "-1"), "--time-limit"),
        (("plan", "{m}", "-o", "p.json", "--gap", "-1"), "--gap"),
        (("plan", "{m}", "-o", "."), "cannot be written"),
        (("plan", "{m}", "-o", "tiny.yaml/x/p.json"), "cannot be made"),
        (("plan", "{m}", "-o", "{m}"), "tiny.yaml: cannot be written: it is what is to be read"),
        (("run", "{m}", "-o", "{m}"), "tiny.yaml: is not a folder"),
        (("export", "{m}", "plan.json", "--format", "gpx", "-o", "out"), "'gpx' is not one of"),
        (("sim", "{m}", "--port", "80"), "--port"),
        (("run", "{m}", "-o", "out", "--speed", "0"), "--speed"),
        (("run", "{m}", "-o", "out", "--plan", "nowhere.json"), "nowhere.json: no such file"),
        (("verify", "{m}", "nowhere.json"), "nowhere.json: no such file"),
        (("review", "nowhere.mcap"), "nowhere.mcap"),
        (("review", "tiny.yaml"), "tiny.yaml"),
        (("review", "."), ".: is a folder; name the recording"),
        (("verify", "{m}", "{m}"), "format: should be 'malipp-plan/1', found 'malipp-mission/1'"),
        (("fly", "{m}"), "No such command 'fly'"),
        (("plan", "{m}", "extra", "-o", "p.json"), "unexpected extra argument"),
    ],
)
def test_one_mistake_is_one_line_and_status_2(
    arguments: tuple[str, ...],
    words: str,
    mission: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(mission.parent)
    assert status(*(part.format(m="tiny.yaml") for part in arguments)) == 2
    line = one_line(capsys)
    assert words in line
    assert "Value error" not in line


def break_plan(path: Path) -> None:
    data = json.loads(path.read_text())
    data["robots"][0]["route"][1]["payload"] = 2
    path.write_text(json.dumps(data))


def test_a_plan_that_breaks_a_rule_is_not_used(
    mission: Path, plan: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    break_plan(plan)
    assert status("verify", mission, plan) == 2
    assert "rover" in capsys.readouterr().err
    assert status("export", mission, plan, "--format", "plan", "-o", tmp_path / "out") == 2
    assert str(plan) in one_line(capsys)
    assert not (tmp_path / "out").exists()
    assert status("run", mission, "--plan", plan, "-o", tmp_path / "run") == 2
    assert str(plan) in one_line(capsys)


def test_a_plan_file_with_an_unknown_key_names_the_line(
    mission: Path, plan: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    edit(plan, '"depart_s"', '"departs_s"')
    assert status("verify", mission, plan) == 2
    said = one_line(capsys)
    assert "robots[0].route[0].departs_s: unknown key; did you mean 'depart_s'?" in said
    assert said.split(":")[1].isdigit()


def test_an_abstract_site_is_not_exported(
    mission: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    edit(mission, "  origin: {lat_deg: 50.0, lon_deg: 8.0}\n", "")
    path = tmp_path / "plan.json"
    assert status("plan", mission, "-o", path) == 0
    capsys.readouterr()
    assert status("export", mission, path, "--format", "plan", "-o", tmp_path / "out") == 2
    assert "origin" in one_line(capsys)


def test_a_port_in_use_is_one_line(mission: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        port = taken.getsockname()[1]
        assert status("sim", mission, "--port", port) == 2
    assert str(port) in one_line(capsys)


def test_a_plan_of_another_mission(mission: Path, plan: Path, capsys: pytest.CaptureFixture[str]) -> None:
    found = read_plan(plan)
    plan.write_text(found.model_copy(update={"mission": "other"}).model_dump_json())
    assert Plan.model_validate_json(plan.read_text()).mission == "other"
    assert status("verify", mission, plan) == 2
    assert "other" in capsys.readouterr().err


def test_no_command_is_a_call_for_help(capsys: pytest.CaptureFixture[str]) -> None:
    assert status() == 0
    assert "Commands:" in capsys.readouterr().out


def test_a_pipe_or_device_is_never_replaced_by_a_result(
    mission: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    assert status("plan", mission, "-o", pipe) == 2
    assert "not an ordinary file" in one_line(capsys)
    assert pipe.is_fifo()


@pytest.mark.parametrize("name", ["plan.json", "run.mcap", "review.rrd"])
def test_a_run_that_could_not_write_its_results_does_not_begin(
    name: str, mission: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "out" / name).mkdir(parents=True)
    assert status("run", mission, "-o", tmp_path / "out") == 2
    assert name in one_line(capsys)


def without_routes(plan: Plan) -> Plan:
    return plan.model_copy(
        update={
            "status": "no_plan",
            "reason": "the limit came before a first plan",
            "objective": None,
            "bound": plan.bound.model_copy(update={"information": None}),
            "gap": None,
            "robots": (),
        }
    )


def test_a_limit_that_comes_first_is_status_4(
    mission: Path,
    plan: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    nothing = without_routes(read_plan(plan))
    monkeypatch.setattr("malipp_field.planner.solve", lambda *_, **__: nothing)
    path = tmp_path / "none.json"
    assert status("plan", mission, "-o", path) == 4
    assert status("run", mission, "-o", tmp_path / "run") == 4
    assert status("run", mission, "--plan", path, "-o", tmp_path / "run") == 4
    assert status("verify", mission, path) == 4
    said = capsys.readouterr().out
    assert said.count("no_plan: the limit came before a first plan") == 4
    assert "every rule is kept" not in said


def test_a_tiny_time_limit_still_brings_everybody_home(mission: Path, tmp_path: Path) -> None:
    path = tmp_path / "plan.json"
    assert status("plan", mission, "--time-limit", "0.001", "-o", path) == 0
    assert status("verify", mission, path) == 0


def interrupt(*_: object, **__: object) -> None:
    raise KeyboardInterrupt


def test_ctrl_c_is_one_line_and_status_130(
    mission: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("malipp_field.planner.solve", interrupt)
    assert status("plan", mission, "-o", tmp_path / "plan.json") == 130
    assert one_line(capsys) == "interrupted\n"
    monkeypatch.setattr("malipp_field.sim.Fleet.__aenter__", interrupt)
    assert status("sim", mission) == 130
    assert one_line(capsys) == "interrupted\n"


def test_an_interrupted_run_leaves_no_review_of_an_earlier_one(
    mission: Path,
    plan: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    (tmp_path / "review.rrd").touch()
    monkeypatch.setattr("malipp_field.cli.whole_run.fly", interrupt)
    assert status("run", mission, "--plan", plan, "-o", tmp_path) == 130
    assert one_line(capsys) == "interrupted\n"
    assert not (tmp_path / "review.rrd").exists()


def test_a_run_and_the_review_of_its_recording_whole_and_cut(
    mission: Path, plan: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    assert status("run", mission, "--plan", plan, "--speed", "60", "-o", out) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "Every sample taken is home." in said
    made = ["plan.json", "export/tiny-rover.plan", "export/tiny-rover.waypoints", "run.mcap", "review.rrd"]
    for name in made:
        assert str(out / name) in said
        assert (out / name).stat().st_size > 0
    steps = json.loads((out / "export" / "tiny-steps.json").read_text())
    assert steps["robots"][0]["file"] == "tiny-rover.plan"

    cut = tmp_path / "cut.mcap"
    whole = (out / "run.mcap").read_bytes()
    cut.write_bytes(whole[: 2 * len(whole) // 3])
    assert status("review", cut) == 0
    assert "cut off" in capsys.readouterr().out
    assert (tmp_path / "cut.rrd").stat().st_size > 0


def test_the_plan_fits_a_terminal_of_80_columns(
    mission: Path, plan: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    found = read_plan(plan)
    table = plan_table(read_mission(mission), found)
    Console(width=80).print(table)
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 2 + len(found.robots)
    headings = " ".join(lines[1].split())
    assert headings == "robot stops samples drops picks home kJ of budget ends at after s"
