"""The options of `malipp plan`: they reach the planner, Ctrl-C keeps the plan, and `--explain` explains."""

from __future__ import annotations

import signal
from dataclasses import replace
from pathlib import Path
from typing import Any, get_args

import pytest
from rich.console import Console

from malipp_field.cli.app import main
from malipp_field.cli.display import ProgressLine
from malipp_field.cli.explain import explanation_view, print_explanation
from malipp_field.cli.interrupt import Interruption
from malipp_field.cli.plan import Method
from malipp_field.mission.schema import Method as SchemaMethod
from malipp_field.plan import read_plan
from malipp_field.planner import Progress
from malipp_field.planner.bounds.relaxation import RelaxedValue
from malipp_field.planner.explanation import DropPlace, Explanation, Place, Resource, Trial, Usage

MISSIONS = Path(__file__).parents[2] / "missions"


def status(*arguments: object) -> int:
    with pytest.raises(SystemExit) as ended:
        main([str(argument) for argument in arguments])
    assert isinstance(ended.value.code, int)
    return ended.value.code


def test_the_command_line_knows_every_method_of_the_mission_file() -> None:
    assert {method.value for method in Method} == set(get_args(SchemaMethod))


def test_every_option_reaches_the_planner(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    given: dict[str, Any] = {}

    def caught(_: object, **options: Any) -> None:
        given.update(options)
        raise KeyboardInterrupt

    monkeypatch.setattr("malipp_field.planner.solve", caught)
    options = [
        "--method", "arcs", "--no-handoffs", "--time-limit", "7", "--gap", "0.01", "--seed", "4",
        "--threads", "1", "--work", "3",
    ]  # fmt: skip
    assert status("plan", MISSIONS / "corridor.yaml", "-o", tmp_path / "p.json", *options) == 130
    assert {name: given[name] for name in given if name not in {"on_progress", "cancelled"}} == {
        "method": "arcs",
        "handoffs": False,
        "time_limit_s": 7.0,
        "mip_gap": 0.01,
        "seed": 4,
        "threads": 1,
        "work_limit": 3,
    }


def test_what_is_not_given_is_the_mission_files(tmp_path: Path) -> None:
    path = tmp_path / "p.json"
    assert status("plan", MISSIONS / "corridor.yaml", "-o", path, "--method", "seq", "--seed", "4") == 0
    plan = read_plan(path)
    assert (plan.method, plan.seed, plan.handoffs) == ("seq", 4, 0)


@pytest.mark.parametrize("option", [("--work", "0"), ("--explain-limit", "0"), ("--threads", "0")])
def test_an_impossible_limit_is_one_line(
    option: tuple[str, str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert status("plan", MISSIONS / "corridor.yaml", "-o", tmp_path / "p.json", *option) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert option[0] in said


@pytest.mark.parametrize("method", ["exact", "arcs"])
def test_ctrl_c_writes_the_best_plan_so_far(
    method: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    path, heard = tmp_path / "p.json", list[Progress]()

    def press(_: ProgressLine, progress: Progress) -> None:
        heard.append(progress)
        if len(heard) == 1:
            signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(ProgressLine, "planning", press)
    before = signal.getsignal(signal.SIGINT)
    assert status("plan", MISSIONS / "quarry.yaml", "-o", path, "--method", method, "--time-limit", 100) == 0
    assert signal.getsignal(signal.SIGINT) is before
    assert "interrupted: this is the best plan so far" in capsys.readouterr().err
    plan = read_plan(path)
    assert plan.status == "feasible"
    assert plan.solve_time_s < 30.0
    assert plan.objective is not None
    assert status("verify", MISSIONS / "quarry.yaml", path) == 0


def test_a_second_ctrl_c_interrupts() -> None:
    with Interruption() as interruption:
        signal.raise_signal(signal.SIGINT)
        assert interruption.asked
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)


def test_the_progress_line_says_what_is_found_and_what_is_proven(capsys: pytest.CaptureFixture[str]) -> None:
    with ProgressLine("planning") as line:
        line.planning(Progress(12.3, "branch and cut", 2.0, 1.5, 0.25, 4))
    said = capsys.readouterr().err
    assert "planning: branch and cut, 12 s, J = 2.0000, J >= 1.5000, gap 25.00 %, round 4" in said
    with ProgressLine("planning") as line:
        line.planning(Progress(0.0, "relaxation", None, float("inf"), None, 0))
    assert "planning: relaxation, 0 s\n" in capsys.readouterr().err


def test_explain_prints_tables_that_fit_a_page(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "p.json"
    mission = tmp_path / "one.yaml"
    mission.write_text(ONE_ROBOT)
    assert status("plan", mission, "-o", path, "--explain", "--explain-limit", "20") == 0
    said = capsys.readouterr().out
    explained = said[said.index("Why the plan is as it is") :]
    assert max(map(len, explained.splitlines())) <= 100
    assert "proven to be the least possible" in said
    assert "Scarce (more of it lowers J): rover's room for samples" in said
    assert "What the drops save" not in said
    assert read_plan(path).status == "optimal"


ONE_ROBOT = """\
format: malipp-mission/1
name: one
site:
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
    - {id: rover, start: base, depots: [base], empty_mass_kg: 10.0, energy_budget_j: 2000.0,
       payload_capacity: 1, samples_per_node: 1, noise_variance: 0.1, energy_per_kg_m: 1.0, speed_m_s: 1.0}
"""

PROVEN = Trial(step=1.0, fall=0.5, most=0.5, proven=True, energy_j=-3.0)
OPEN = replace(PROVEN, proven=False)
NOTHING = replace(PROVEN, fall=0.0, most=0.0)
ENERGY = Usage("rover", "energy", 2000.0, 1500.0)
ROOM = Usage("rover", "room", 2, 2)
SLOTS = Usage("rover", "slots", 1, 1, 2, 3)


def explanation(**changes: Any) -> Explanation:
    base = Explanation(
        information=2.0,
        searched_j=0.0,
        proven=True,
        gap=1e-5,
        sample_mass_kg=2.0,
        resources=(
            Resource(ENERGY, NOTHING, "slack"),
            Resource(ROOM, PROVEN, "binds"),
            Resource(SLOTS, OPEN, "open"),
        ),
        without_drops=None,
        places=(),
        relaxed=None,
        asked=3,
        time_s=1.0,
    )
    return replace(base, **changes)


def shown(given: Explanation) -> str:
    console = Console(width=100, record=True, file=None, quiet=False)
    with console.capture() as captured:
        for part in explanation_view(given):
            console.print(part)
    text = captured.get()
    return "\n".join(" ".join(line.split()) for line in text.splitlines())


def test_each_figure_says_what_is_known_of_it() -> None:
    said = shown(explanation())
    assert "rover 2.00 kJ 1.50 kJ no +1.0 J nothing; saves 3.0 J -" in said
    assert "2 on board 2 at most yes +1 on board 0.5000 (25.0 %) 0.25 per kg" in said
    assert "1 per node all at 2 of 3 open +1 per node 0.5000 (25.0 %) 0.5 per slot" in said
    assert "Scarce (more of it lowers J): rover's room for samples." in said
    assert "Open (not decided in the time given): rover's samples at a node." in said


def test_what_binds_without_a_proof_of_how_much_is_at_least_that() -> None:
    assert "at least 0.5000 (25.0 %)" in shown(explanation(resources=(Resource(ROOM, OPEN, "binds"),)))


def test_a_team_too_large_to_ask_about_is_given_the_relaxation() -> None:
    given = explanation(
        proven=False,
        searched_j=0.25,
        resources=tuple(Resource(use, None, "open") for use in (ENERGY, ROOM, SLOTS)),
        relaxed={"rover": RelaxedValue(per_joule=2e-3, per_sample=0.5)},
    )
    said = shown(given)
    assert "rover 2.00 kJ 1.50 kJ open - not asked - 2 per kJ" in said
    assert "2 on board 2 at most open - not asked - 0.25 per kg" in said
    assert "lowered J by 0.2500" in " ".join(said.split())
    assert "Open: not decided in the time given" in said


def test_what_drops_save_is_told_by_place() -> None:
    place = Place("hub", (("scout", "carrier", 2),), 0.75)
    dear, cheap = replace(PROVEN, fall=-0.5), replace(PROVEN, fall=0.0, energy_j=40.0)
    said = shown(
        explanation(
            places=(
                DropPlace(place, dear),
                DropPlace(replace(place, node="quay"), cheap),
                DropPlace(replace(place, node="pit", left_out=None), None),
            ),
            without_drops=replace(dear, proven=False),
        )
    )
    assert "hub 2 from scout to carrier 0.5000 (25.0 %) 0.7500 (37.5 %)" in said
    assert "quay 2 from scout to carrier nothing; 40.0 J more 0.7500 (37.5 %)" in said
    assert "pit 2 from scout to carrier not known they must come home" in said
    assert "anywhere all of it at most 0.5000 (25.0 %)" in said


def test_what_is_piped_is_a_page_wide(tmp_path: Path) -> None:
    with (tmp_path / "out.txt").open("w") as file:
        print_explanation(explanation(), Console(file=file, width=40))
    lines = (tmp_path / "out.txt").read_text().splitlines()
    assert 80 < max(map(len, lines)) <= 100
