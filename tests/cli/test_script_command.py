"""`malipp script`: the payload script, whole and unchanged."""

from __future__ import annotations

from pathlib import Path

import pytest

from malipp_field.cli.app import main
from malipp_field.link.lua import payload_script


def status(*arguments: str) -> object:
    with pytest.raises(SystemExit) as ended:
        main(list(arguments))
    return ended.value.code


def test_it_writes_the_script_that_is_tested(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "scripts" / "payload.lua"
    path.parent.mkdir()
    assert status("script", "-o", str(path)) == 0
    assert path.read_text() == payload_script()
    assert capsys.readouterr().out == f"script: {path}\n"


def test_where_it_cannot_be_written_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert status("script", "-o", str(tmp_path)) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_every_parameter_of_the_script_is_explained() -> None:
    page = (Path(__file__).parents[2] / "docs" / "vehicles.md").read_text()
    for name in ("CAP", "ABOARD", "SW_PIN", "SW_ON", "COL_TYPE", "COL_NUM", "COL_ON", "COL_OFF", "COL_TIME"):
        assert f"`MLP_{name}`" in page
