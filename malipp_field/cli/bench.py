"""`malipp bench`: the paper's experiments, run, tabulated and drawn."""

from __future__ import annotations

import importlib.util
import os
import shlex
import sys
from collections.abc import Sequence
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, get_args

import typer

from malipp_field.errors import MalippError

if TYPE_CHECKING:
    from malipp_field.bench.campaign import Piece
    from malipp_field.bench.farm import Farm
    from malipp_field.bench.labour import Terms
    from malipp_field.bench.studies import Study

_NEEDED = ("distributed", "matplotlib")


class TestPoints(StrEnum):
    """Where prediction errors count in random instances."""

    RANDOM = "random"
    CANDIDATES = "candidates"


def bench(
    study: Annotated[
        list[str] | None,
        typer.Option(
            "--study",
            metavar="NAME",
            help="joint, sweep, optimality, scalability or growth; may be given again. All if not given.",
        ),
    ] = None,
    reduced: Annotated[
        bool, typer.Option("--reduced", help="Few instances and short limits: all studies in ten minutes.")
    ] = False,
    instances: Annotated[
        int | None, typer.Option(min=1, metavar="N", help="Instances of each kind; the study's if not given.")
    ] = None,
    time_limit: Annotated[
        list[str] | None,
        typer.Option(
            "--time-limit",
            metavar="[METHOD=]S",
            help="Seconds for each plan, Seq-LIPP's apart, or for those of one method; may be given again.",
        ),
    ] = None,
    test_points: Annotated[
        TestPoints, typer.Option(help="Where prediction errors count; gains differ by a factor of about two.")
    ] = TestPoints.RANDOM,
    out: Annotated[
        Path, typer.Option("--out", "-o", metavar="DIR", help="Folder for missions and results.")
    ] = Path("runs/bench"),
    page: Annotated[
        Path | None,
        typer.Option(metavar="FILE.md", help="Where the page and its figures go; DIR/scale.md if not given."),
    ] = None,
    jobs: Annotated[
        int | None, typer.Option(min=1, metavar="N", help="Plans at once here; all cores if not given.")
    ] = None,
    threads: Annotated[int, typer.Option(min=1, metavar="N", help="Threads of each plan.")] = 1,
    memory_limit: Annotated[
        float, typer.Option(min=100.0, metavar="MIB", help="Memory at which a plan is ended.")
    ] = 8192.0,
    scheduler: Annotated[
        str | None,
        typer.Option(
            metavar="tcp://HOST:PORT", help="A Dask scheduler to plan with; workers here if not given."
        ),
    ] = None,
) -> None:
    """Run the paper's experiments on random instances and write missions, tables, figures and a page.

    Stopped, or killed, it goes on when given again. Exit status: 0 when no plan failed, 1 when one did.
    """
    for package in _NEEDED:
        if importlib.util.find_spec(package) is None:
            raise MalippError(f"malipp bench needs {package}: pip install 'malipp-field[bench]'")
    from malipp_field.bench.farm import Farm
    from malipp_field.bench.labour import Terms

    known = _studies(study or [], reduced=reduced)
    limits_s = dict(map(_limit, time_limit or []))
    studies = [one.changed(instances, limits_s, test_points.value) for one in known]
    terms = Terms(threads=threads, memory_limit_mib=memory_limit)
    farm: Farm[Piece] = Farm(scheduler, jobs or max(1, (os.cpu_count() or 1) // threads))
    target = page or out / "scale.md"
    well = _run(studies, terms, farm, out, target)
    typer.echo(f"bench: {target}")
    if not well:
        raise typer.Exit(1)


def _limit(text: str) -> tuple[str | None, float]:
    """Return the method, or None for all, and the seconds of a time limit."""
    from malipp_field.mission.schema import Method

    method, given, seconds = text.rpartition("=")
    try:
        limit_s = float(seconds)
    except ValueError:
        limit_s = 0.0
    if not 0.0 < limit_s < float("inf") or (given and method not in get_args(Method)):
        raise MalippError(f"--time-limit {text}: wanted seconds above 0, or METHOD=seconds, as in lns=120")
    return method or None, limit_s


def _studies(names: Sequence[str], *, reduced: bool) -> list[Study]:
    """Return the studies of the names given; all of them where there is none."""
    from malipp_field.bench.studies import REDUCED, STUDIES

    known = REDUCED if reduced else STUDIES
    for name in names:
        if name not in known:
            from malipp_field.documents import suggest

            hint = suggest(name, list(known)) or f"; there are {', '.join(known)}"
            raise MalippError(f"--study {name}: no such study{hint}")
    return [known[name] for name in dict.fromkeys(names or known)]


def _run(studies: Sequence[Study], terms: Terms, farm: Farm[Piece], out: Path, page: Path) -> bool:
    """Run studies, write tables, figures and the page, and tell whether nothing failed."""
    from malipp_field.bench.campaign import Campaign, alone_in
    from malipp_field.bench.export import write_tables
    from malipp_field.bench.figures import draw
    from malipp_field.bench.report import report
    from malipp_field.bench.tasks import FAILED
    from malipp_field.cli.display import ProgressLine

    with alone_in(out):
        campaign = Campaign(studies, out, terms)
        with ProgressLine("bench") as line, farm:
            campaign.run(farm, lambda standing: line.show(str(standing)))
        found = [campaign.cases(study) for study in studies]
        figures = {}
        for cases in found:
            write_tables(campaign, cases.study)
            drawn = draw(cases, page.with_name(f"{page.stem}-{cases.study.name}"))
            if drawn:
                figures[cases.study.name] = Path(drawn[0].name)
        command = shlex.join(["malipp", *sys.argv[1:]])
        from malipp_field.documents import whole_file

        with whole_file(page) as partial:
            partial.write_text(report(found, command, campaign.faults, figures), encoding="utf-8")
    failed = any(row.status in FAILED for cases in found for row in cases.rows.values())
    return not failed and not campaign.faults
