"""The page of benchmarks/exact.py, from rows that are there already: nothing is planned."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from malipp_field.bench import Results, Specification, Task, build, write_mission
from malipp_field.bench.tasks import unfinished

SPEC = Specification(2, 3)
MISSION = build(SPEC, 30.0)
PROVEN: dict[str, Any] = {
    "information": 2.0, "bound": 2.0, "energy_j": 20.0, "makespan_s": 9.0, "root_bound": 1.5,
    "peak_mib": 200.0,
}  # fmt: skip


@pytest.fixture(scope="module")
def exact() -> ModuleType:
    path = Path(__file__).parents[2] / "benchmarks" / "exact.py"
    spec = importlib.util.spec_from_file_location("exact_benchmark", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def run(module: ModuleType, folder: Path, monkeypatch: pytest.MonkeyPatch, literal: dict[str, Any]) -> int:
    """Run the benchmark over rows in which exact took 2 s and the literal model 100 s, ending as given."""
    write_mission(MISSION, folder / f"{SPEC.name}.yaml")
    results = Results(folder / "rows.jsonl")
    seq = Task(MISSION, "seq", handoffs=False, time_limit_s=600.0)
    seq_plan = {"information": 2.5, "sampled": 2, "candidates": 3}
    results.add(unfinished(seq, "feasible", "", 0.1).model_copy(update=seq_plan))
    for handoffs in (True, False):
        task = Task(MISSION, "exact", handoffs=handoffs, time_limit_s=60.0)
        results.add(unfinished(task, "optimal", "", 2.0).model_copy(update=PROVEN))
    task = Task(MISSION, "miqp", time_limit_s=900.0)
    results.add(unfinished(task, "optimal", "", 100.0).model_copy(update=PROVEN | literal))
    places = ["--results", str(folder / "rows.jsonl"), "--instances", str(folder)]
    monkeypatch.setattr(sys, "argv", ["exact.py", "--sizes", "2x3", "--seeds", "1", *places])
    return int(module.main())


def test_agreement_shares_gaps_and_ratio(
    exact: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(exact, tmp_path, monkeypatch, {}) == 0
    page = capsys.readouterr().out
    assert "Methods agree: 1 comparisons of proven J" in page
    line = "| 1 | 100 % | 100 % | 100 % | 2.0 | 2.0 | 25.00 % | 0.00 % | 0.00 % | 200 |"
    assert f"| 2 x 3 | exact {line}" in page
    assert f"| 2 x 3 | exact, no handoffs {line}" in page
    assert "| 2 x 3 | 1 | 1 (100 %) | 50.0 | 50.0 |" in page
    assert "| 2 x 3 | 1 | 67 % (67 to 67) | 20.00 % | 20.00 % | 0.0 |" in page


def test_a_literal_model_that_did_not_end_counts_as_a_lower_bound(
    exact: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(exact, tmp_path, monkeypatch, {"status": "feasible", "bound": 1.0}) == 0
    assert "| 2 x 3 | 1 | 0 (0 %) |  | 50.0 |" in capsys.readouterr().out


def test_a_disagreement_is_loud(
    exact: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(exact, tmp_path, monkeypatch, {"information": 2.1, "bound": 2.1}) == 1
    page = capsys.readouterr().out
    assert "DISAGREEMENTS OR FAULTS**" in page
    assert "proven optimum 2.100000 of r2-n3-s0 miqp lies above J = 2.000000" in page
