"""Studies run on Dask workers: kept as they come, resumed after a kill, workers lost on the way."""

from __future__ import annotations

import os
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import bench_cases
import pytest

from malipp_field.bench import Specification, build
from malipp_field.bench.campaign import Campaign, Piece, Standing, alone_in
from malipp_field.bench.farm import Done, Farm, local_cluster
from malipp_field.bench.instances import mission_text
from malipp_field.bench.labour import Made, NoInstanceError, Terms
from malipp_field.bench.tasks import unfinished
from malipp_field.errors import InputError, MalippError
from malipp_field.mission import read_mission

FIRST = bench_cases.CELLS[0]


@dataclass
class Bench:
    """Stands in for a farm: does every job at once, in this process."""

    slots: int = 2
    ended: list[Done[Piece]] = field(default_factory=list)
    given_out: list[Piece] = field(default_factory=list)
    lost: tuple[str, ...] = ()
    fault: Exception | None = None

    @property
    def running(self) -> int:
        return len(self.ended)

    def submit(self, tag: Piece, function: Any, *arguments: Any) -> None:
        self.given_out.append(tag)
        spec = tag.specification
        if self.fault is not None:
            self.ended.append(Done(tag, fault=self.fault))
        elif tag.arm is None:
            mission = build(spec, 30.0)
            self.ended.append(Done(tag, Made(30.0, mission_text(mission))))
        elif tag.arm.label in self.lost:
            self.ended.append(Done(tag, lost=True))
        else:
            self.ended.append(Done(tag, bench_cases.pretend_here(spec, tag.arm)))

    def done(self) -> list[Done[Piece]]:
        ended, self.ended = self.ended, []
        return ended


def run(campaign: Campaign, bench: Bench) -> list[Standing]:
    standings: list[Standing] = []
    campaign.run(bench, standings.append)  # type: ignore[arg-type]
    return standings


def test_a_study_is_run_instance_by_instance_and_kept(tmp_path: Path) -> None:
    study, bench = bench_cases.study(), Bench()
    campaign = Campaign([study], tmp_path)
    standings = run(campaign, bench)
    assert (standings[-1].done, standings[-1].total, standings[-1].left_s) == (12, 12, 0.0)
    begun = [piece.specification for piece in bench.given_out if piece.arm is None]
    assert begun == list(study.specifications)
    cases = campaign.cases(study)
    assert len(cases.rows) == 12
    assert cases.gains(FIRST, "full") == [20.0, 20.0]
    mission = read_mission(tmp_path / "instances" / "joint" / f"{FIRST.name}.yaml")
    assert mission == build(FIRST, 30.0)


def test_what_is_there_is_not_done_again(tmp_path: Path) -> None:
    study = bench_cases.study()
    run(Campaign([study], tmp_path), Bench())
    again = Bench()
    campaign = Campaign([study.changed(instances=3)], tmp_path)
    run(campaign, again)
    assert len(again.given_out) == 2 * (1 + 3)  # one more instance of each kind
    assert {piece.specification.seed for piece in again.given_out} == {2}


def test_another_generator_makes_its_instances_anew(tmp_path: Path) -> None:
    study = bench_cases.study()
    run(Campaign([study], tmp_path), Bench())
    path = tmp_path / "instances.jsonl"
    path.write_text(path.read_text().replace('"site":"', '"site":"x'))
    again = Bench()
    run(Campaign([study], tmp_path), again)
    assert sum(piece.arm is None for piece in again.given_out) == 4
    assert not any(piece.arm for piece in again.given_out)  # the same missions: their plans are known


def test_a_lost_worker_costs_its_plan_only(tmp_path: Path) -> None:
    study = bench_cases.study()
    campaign = Campaign([study], tmp_path)
    standings = run(campaign, Bench(lost=("full",)))
    assert standings[-1].faults == 4
    statuses = Counter(row.status for row in campaign.cases(study).rows.values())
    assert statuses == {"feasible": 8, "crashed": 4}


def test_workers_of_another_version_are_told(tmp_path: Path) -> None:
    bench = Bench()
    task = bench_cases.task_here(Specification(2, 3, seed=7), bench_cases.study().arms[0])

    def stranger() -> list[Done[Piece]]:
        ended, bench.ended = bench.ended, []
        other = unfinished(task, "no_plan", "", 0.0)
        return [done if isinstance(done.result, Made) else replace(done, result=other) for done in ended]

    bench.done = stranger  # type: ignore[method-assign]
    with pytest.raises(MalippError, match="another version"):
        run(Campaign([bench_cases.study()], tmp_path), bench)


def test_two_runs_in_a_folder_are_refused(tmp_path: Path) -> None:
    second = alone_in(tmp_path / "new")
    with alone_in(tmp_path / "new"), pytest.raises(InputError, match="another malipp bench"), second:
        pass
    with alone_in(tmp_path / "new"):
        pass
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match="cannot be written"), alone_in(tmp_path / "file"):
        pass


def test_the_standing_in_words() -> None:
    assert str(Standing(3, 12, 2, 2, 3725.0, 0)) == "3 of 12 plans, at work: 2, about 1:02:05 left"
    assert str(Standing(3, 12, 2, 2, 65.0, 1)) == "3 of 12 plans, at work: 2, 1 failed, about 1:05 left"
    assert str(Standing(0, 12, 0, 0, None, 0)) == "0 of 12 plans, waiting for workers"


def test_an_instance_that_cannot_be_made_is_told_and_a_sick_worker_ends_the_run(tmp_path: Path) -> None:
    study = bench_cases.study()
    without_plan = Bench(fault=NoInstanceError("no Seq-LIPP plan"))
    campaign = Campaign([study], tmp_path)
    assert run(campaign, without_plan)[-1].faults == 4
    assert campaign.faults[0] == "joint, r2-n3-s0: no Seq-LIPP plan"
    with pytest.raises(MalippError, match="a Dask worker cannot do its work: no such module"):
        run(Campaign([study], tmp_path), Bench(fault=ImportError("no such module")))


@pytest.fixture
def diary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv(bench_cases.DIARY, str(tmp_path / "diary"))
    return tmp_path / "diary"


@pytest.fixture
def two_workers(diary: Path) -> Iterator[str]:
    """Return the address of a scheduler with two workers, as one elsewhere would be given."""
    cluster = local_cluster(2)
    yield cluster.scheduler_address
    cluster.close(timeout=10.0)


def test_a_killed_worker_s_plan_is_made_by_another_and_given_up_when_that_dies_too(
    tmp_path: Path, two_workers: str
) -> None:
    study = bench_cases.study(instances=1)
    campaign = Campaign([study], tmp_path / "out", Terms(run=bench_cases.kill_workers))
    with Farm[Piece](two_workers, 1) as farm:
        assert farm.slots == 2
        campaign.run(farm)
    endings = {(row.instance, row.method): row.status for row in campaign.cases(study).rows.values()}
    assert len(endings) == 6
    begun = Counter(bench_cases.begun())
    assert [key for key, status in endings.items() if status != "feasible"] == [bench_cases.DEADLY]
    assert endings[bench_cases.DEADLY] == "crashed"
    assert begun[" ".join(bench_cases.DEADLY)] == 2
    assert begun[" ".join(bench_cases.DEADLY_ONCE)] == 2


def test_a_run_goes_on_after_a_kill(tmp_path: Path, diary: Path) -> None:
    folder = tmp_path / "out"
    program = "import sys, pathlib, campaign_to_kill as it; it.run_until_killed(pathlib.Path(sys.argv[1]))"
    with subprocess.Popen(
        [sys.executable, "-c", program, str(folder)],
        stdout=subprocess.PIPE,
        text=True,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)},
    ) as process:
        assert process.stdout is not None
        for line in process.stdout:  # one a second, until two plans are kept
            if int(line) == 2:
                break
        process.kill()
    assert len(bench_cases.begun()) == 2
    with (folder / "rows.jsonl").open("a") as rows:
        rows.write('{"key": "cut sho')
    study = bench_cases.study(instances=1)
    campaign = Campaign([study], folder, Terms(run=bench_cases.pretend))
    with Farm[Piece](None, 1) as farm:
        campaign.run(farm)
    assert len(campaign.cases(study).rows) == 6
    assert sorted(Counter(bench_cases.begun()).values()) == [1] * 6
    assert len((folder / "rows.jsonl").read_text().splitlines()) == 6


def test_an_address_where_no_scheduler_is() -> None:
    for address in ("tcp://127.0.0.1:9", "nowhere"):
        with pytest.raises(MalippError, match=r"--scheduler .*no Dask scheduler answers"):
            Farm[Piece](address, 1).__enter__()
