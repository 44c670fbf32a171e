"""`malipp bench` as a user meets it; nothing is planned, the farm and its work are stand-ins."""

from __future__ import annotations

from pathlib import Path

import pytest

from malipp_field.bench import campaign, farm
from malipp_field.bench.labour import task_of
from malipp_field.bench.studies import REDUCED
from malipp_field.bench.tasks import Ending, unfinished
from malipp_field.cli.app import main


def status(*arguments: object) -> int:
    with pytest.raises(SystemExit) as ended:
        main([str(argument) for argument in arguments])
    assert isinstance(ended.value.code, int)
    return ended.value.code


class NoFarm:
    """Has no workers, and is never asked for any."""

    def __init__(self, scheduler: str | None, jobs: int) -> None:
        pass

    def __enter__(self) -> NoFarm:
        return self

    def __exit__(self, *_: object) -> None:
        pass


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--study", "joing"], "--study joing: no such study; did you mean 'joint'?"),
        (["--study", "x"], "no such study; there are joint, sweep, optimality, scalability, growth"),
        (["--instances", "0"], "--instances"),
        (["--time-limit", "-1"], "--time-limit -1: wanted seconds above 0, or METHOD=seconds"),
        (["--time-limit", "fest=3"], "--time-limit fest=3: wanted seconds above 0"),
        (["--jobs", "none"], "--jobs"),
        (["--test-points", "nowhere"], "--test-points"),
        (["--scheduler", "tcp://127.0.0.1:9"], "no Dask scheduler answers there"),
    ],
)
def test_bad_options_are_one_line(
    arguments: list[str], words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert status("bench", *arguments, "--out", tmp_path / "out") == 2
    said = capsys.readouterr().err
    assert words in said
    assert "Traceback" not in said
    assert said.count("\n") == 1


def test_a_file_in_the_way_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "file").touch()
    assert status("bench", "--out", tmp_path / "file") == 2
    assert "file: cannot be written" in capsys.readouterr().err


@pytest.mark.parametrize(("ending", "code"), [("no_plan", 0), ("crashed", 1)])
def test_page_and_tables_are_written_and_failures_tell(
    ending: Ending,
    code: int,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def run(self: campaign.Campaign, *_: object) -> None:
        (study,) = self.studies
        assert study.name == "joint"
        assert study.instances == 1
        spec, arm = study.specifications[0], study.arms[0]
        task = task_of(spec, 30.0, arm, self.terms)
        row = unfinished(task, ending, "why", 1.0)
        self._known[study.name, spec, arm.label] = row

    monkeypatch.setattr(farm, "Farm", NoFarm)
    monkeypatch.setattr(campaign.Campaign, "run", run)
    page = tmp_path / "pages" / "scale.md"
    options = ("--reduced", "--study", "joint", "--instances", 1, "--out", tmp_path / "out", "--page", page)
    assert status("bench", *options) == code
    assert capsys.readouterr().out == f"bench: {page}\n"
    assert "8 of 9 runs are missing" in page.read_text()
    assert REDUCED["joint"].title in page.read_text()
    assert len((tmp_path / "out" / "joint.csv").read_text().splitlines()) == 2
