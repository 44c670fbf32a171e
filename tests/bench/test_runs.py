"""Tasks, their rows, the file that keeps them, the child process that runs them, and their comparison."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from malipp_field.bench import Results, Row, Specification, Task, Worker, build, compare, run_task, tasks
from malipp_field.bench.page import provenance, table
from malipp_field.bench.script import ended
from malipp_field.bench.tasks import unfinished
from malipp_field.errors import InputError
from malipp_field.planner import solve

MISSION = build(Specification(2, 3), 30.0)
TASK = Task(MISSION, "exact", time_limit_s=30.0)


def row(method: str = "exact", **values: Any) -> Row:
    proven: dict[str, Any] = {
        "information": 4.0, "bound": 4.0, "energy_j": 20.0, "makespan_s": 9.0
    }  # fmt: skip
    return unfinished(replace(TASK, method=method), "optimal", "", 1.0).model_copy(update=proven | values)


def test_a_task_gives_the_figures_of_its_plan() -> None:
    found = run_task(TASK)
    plan = solve(MISSION, method="exact")
    assert plan.objective is not None
    assert found.status == "optimal"
    assert found.certified
    assert found.information == pytest.approx(plan.objective.information)
    assert found.energy_j == pytest.approx(plan.objective.energy_j)
    assert found.sampled == len({s.node for r in plan.robots for s in r.route if s.collect})
    assert found.candidates == 3
    assert found.root_bound is not None
    assert found.time_s > 0.0
    assert Row.model_validate_json(found.model_dump_json()) == found


def test_an_unknown_method_and_a_fault_of_the_planner_are_rows(monkeypatch: pytest.MonkeyPatch) -> None:
    assert run_task(replace(TASK, method="oracle")).status == "not available"

    def broken(*_: object, **__: object) -> None:
        raise RuntimeError("the planner made a plan that breaks a rule")

    monkeypatch.setattr(tasks, "solve", broken)
    found = run_task(TASK)
    assert found.status == "fault"
    assert found.reason == "RuntimeError: the planner made a plan that breaks a rule"
    assert not found.certified


def test_an_unproven_plan_is_not_certified() -> None:
    assert not row(bound=3.9).certified
    assert row(bound=3.9996).certified
    assert row(bound=3.0).gap == pytest.approx(0.25)
    assert row(root_bound=2.0).root_gap == pytest.approx(0.5)
    assert row(bound=None).gap is None


def test_keys_tell_tasks_apart() -> None:
    others = [
        replace(TASK, method="seq"),
        replace(TASK, handoffs=False),
        replace(TASK, time_limit_s=31.0),
        replace(TASK, mission=build(Specification(2, 3), 31.0)),
    ]
    assert len({task.key for task in (TASK, *others)}) == 5
    assert Task(build(Specification(2, 3), 30.0), "exact", time_limit_s=30.0).key == TASK.key


def test_results_are_found_again_after_a_kill(tmp_path: Path) -> None:
    path = tmp_path / "below" / "rows.jsonl"
    first = row()
    Results(path).add(first)
    with path.open("a", encoding="utf-8") as stream:
        stream.write(first.model_dump_json()[:40])  # the write that the kill cut short
    resumed = Results(path)
    assert resumed.find(TASK) == first
    other = row("miqp")
    resumed.add(other)
    assert list(Results(path).rows.values()) == [first, other]


def test_a_file_of_something_else_is_refused_in_one_line(tmp_path: Path) -> None:
    path = tmp_path / "rows.jsonl"
    path.write_text(row().model_dump_json() + "\nsomething else\n")
    with pytest.raises(InputError, match=r"rows.jsonl:2: not a result of this benchmark"):
        Results(path)
    with pytest.raises(InputError, match="Is a directory"):
        Results(tmp_path)
    with pytest.raises(InputError, match="cannot be written"):
        Results(path / "below").add(row())


def test_scripts_end_with_a_line_and_a_code(capsys: pytest.CaptureFixture[str]) -> None:
    def interrupted() -> int:
        raise KeyboardInterrupt

    def misused() -> int:
        raise InputError("rows.jsonl", 2, "", "not a result")

    assert (ended(lambda: 1), ended(interrupted), ended(misused)) == (1, 130, 2)
    lines = capsys.readouterr().err.split("\n")
    assert lines[1:3] == ["stopped; the same command goes on from here", "rows.jsonl:2: not a result"]


def test_what_failed_is_tried_again_when_the_code_has_changed(tmp_path: Path) -> None:
    results = Results(tmp_path / "rows.jsonl")
    failed = unfinished(TASK, "fault", "RuntimeError", 1.0)
    results.add(failed)
    assert results.find(TASK) == failed
    results.add(failed.model_copy(update={"code": "other"}))
    assert results.find(TASK) is None
    results.add(row(code="other"))
    assert results.find(TASK) is not None


def test_a_fresh_process_measures_its_own_memory() -> None:
    with Worker() as worker:
        found = worker.fresh(TASK)
    assert found.status == "optimal"
    assert found.peak_mib is not None
    assert 30.0 < found.peak_mib < 2000.0


def misbehave(task: Task) -> Row:
    """Do what the method's name says; run in a child."""
    if task.method == "crash":
        os._exit(3)
    if task.method == "hang":
        while True:
            pass
    if task.method == "eat":
        eaten = bytearray(400 * 2**20)
        eaten[::4096] = b"x" * len(eaten[::4096])
        while True:
            pass
    return unfinished(task, "no_plan", "as it should be", 0.0)


def test_a_crash_a_hang_and_a_hunger_for_memory_cost_one_row_each() -> None:
    with Worker(misbehave, memory_limit_mib=400.0, grace_s=0.5) as worker:
        well = worker.run(replace(TASK, method="well"))
        crashed = worker.run(replace(TASK, method="crash"))
        hung = worker.run(replace(TASK, method="hang", time_limit_s=0.1))
        fed = worker.run(replace(TASK, method="eat"))
    assert well.reason == "as it should be"
    assert crashed.status == "crashed"
    assert crashed.reason == "the process ended with code 3"
    assert hung.status == "killed"
    assert fed.status == "out of memory"
    assert fed.peak_mib is not None
    assert fed.peak_mib > 400.0


def test_methods_that_agree() -> None:
    total = compare([row(), row("arcs", information=4.0 + 1e-7), row("miqp")])
    assert (total.information, total.energy, total.makespan, total.faults) == (3, 3, 3, ())


def test_later_stages_are_compared_only_between_the_same_plans_so_far() -> None:
    near = compare([row(), row("arcs", information=4.0002, bound=4.0, energy_j=15.0)])
    assert (near.information, near.energy, near.faults) == (1, 0, ())
    unproven = compare([row(), row("arcs", status="feasible", bound=3.0, information=4.1, energy_j=15.0)])
    assert (unproven.information, unproven.faults) == (0, ())


@pytest.mark.parametrize(
    ("other", "word"),
    [
        ({"information": 4.01, "bound": 4.01}, "proven optimum"),
        ({"information": 4.5, "bound": 4.1, "status": "feasible"}, "bound"),
        ({"energy_j": 21.0}, "energy"),
        ({"makespan_s": 9.1}, "makespan"),
        ({"status": "infeasible", "information": None, "bound": None}, "infeasible"),
        ({"status": "fault", "information": None, "bound": None, "reason": "RuntimeError"}, "RuntimeError"),
    ],
)
def test_disagreements_are_found_whichever_comes_first(other: dict[str, Any], word: str) -> None:
    for rows in ([row(), row("arcs", **other)], [row("arcs", **other), row()]):
        faults = compare(rows).faults
        assert faults
        assert any(word in fault for fault in faults)


def test_two_proofs_of_infeasibility_agree() -> None:
    nothing: dict[str, Any] = {"status": "infeasible", "information": None, "bound": None}
    assert compare([row(**nothing), row("arcs", **nothing)]).information == 1


def test_pages_say_of_which_code_their_figures_are() -> None:
    assert table(("a", "b"), [("x", "1")]) == ["| a | b |", "| --- | ---: |", "| x | 1 |"]
    assert "(this tree's)" in provenance([row()])[-1]
    assert "not only this" in provenance([row(), row(code="old")])[-1]
