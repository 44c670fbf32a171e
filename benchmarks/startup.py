"""Measure what the main commands take in a fresh process, and print a page of it.

    python benchmarks/startup.py --write

replaces benchmarks/startup.md. All commands run in turn, several times over, after a first round that is not
counted: files are in memory and the planner's kernels compiled. With `--other FOLDER` the same commands of
another checkout run in between, for comparison. Wall times depend on what else the machine does, processor
times less so.
"""

from __future__ import annotations

import argparse
import datetime
import importlib.util
import os
import shlex
import statistics
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from malipp_field.bench.machine import machine, versions
from malipp_field.bench.page import table
from malipp_field.bench.script import ended
from malipp_field.cli.status import LIMIT_REACHED
from malipp_field.errors import MalippError

ROOT = Path(__file__).resolve().parent
TREE = ROOT.parent
MALIPP = "from malipp_field.cli.app import main; main()"
COMMANDS = (
    "--help",
    "plan missions/corridor.yaml -o OUT/auto.json",
    "plan missions/corridor.yaml -o OUT/exact.json --method exact",
    "plan missions/corridor.yaml -o OUT/plain.json --method no-handoffs",
    "plan missions/corridor.yaml -o OUT/seq.json --method seq",
    "plan missions/quarry.yaml -o OUT/quarry.json --time-limit 1",
    "verify missions/corridor.yaml OUT/auto.json",
    "export missions/corridor.yaml OUT/auto.json --format plan -o OUT/export",
)
PYTHON = {"python -c pass": "pass", "python -c 'import numba'": "import numba"}

_HOW_READ = """\
Each cell: median of the wall times (least of them; least processor time, user and system), in seconds. `OUT`
is a folder for results. Planning itself is within these times; the quarry takes all of its second.
"""


class Took(NamedTuple):
    """What one process took."""

    wall_s: float
    processor_s: float


Figures = dict[tuple[str, Path], list[Took]]


def main() -> int:
    """Measure, print the page, and write it where that is asked for."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rounds", type=int, default=7, help="how often each command runs (default 7)")
    parser.add_argument("--other", type=Path, help="another checkout, to compare with")
    parser.add_argument("--write", action="store_true", help="replace benchmarks/startup.md")
    options = parser.parse_args()
    trees = [TREE] if options.other is None else [options.other.resolve(), TREE]
    page = "\n".join(_page(trees, _measured(trees, options.rounds), options.rounds)) + "\n"
    print(page)
    if options.write:
        (ROOT / "startup.md").write_text(page, encoding="utf-8")
    return 0


def _measured(trees: Sequence[Path], rounds: int) -> Figures:
    figures: Figures = defaultdict(list)
    with tempfile.TemporaryDirectory() as out:
        for number in range(rounds + 1):
            print(f"round {number} of {rounds}", file=sys.stderr)
            for tree in trees:
                for name, arguments in _processes(Path(out) / str(trees.index(tree))):
                    took = _took(arguments, tree)
                    if number:
                        figures[name, tree].append(took)
    return figures


def _processes(out: Path) -> Iterator[tuple[str, list[str]]]:
    """Give every command's name, and what is given to Python for it."""
    yield from ((name, ["-c", code]) for name, code in PYTHON.items())
    for command in COMMANDS:
        yield f"malipp {command}", ["-c", MALIPP, *command.replace("OUT", str(out)).split()]


def _took(arguments: Sequence[str], tree: Path) -> Took:
    started = time.perf_counter()
    process = subprocess.Popen(  # noqa: S603 (our own commands)
        [sys.executable, *arguments],
        cwd=tree, env=os.environ | {"PYTHONPATH": str(tree)},
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    wall_s = time.perf_counter() - started
    if process.returncode not in {0, LIMIT_REACHED}:
        raise MalippError(f"status {process.returncode} in {tree}: {shlex.join(arguments)}")
    return Took(wall_s, usage.ru_utime + usage.ru_stime)


def _page(trees: Sequence[Path], figures: Figures, rounds: int) -> list[str]:
    heads = ("fresh process", *("this tree" if tree == TREE else "the other tree" for tree in trees))
    other = " --other FOLDER" * (len(trees) > 1)
    lines = [
        (f"`{name}`", *(_cell(figures[name, tree]) for tree in trees))
        for name in dict.fromkeys(name for name, _ in figures)
    ]
    return [
        "# Starting, measured",
        "",
        f"Made by `python benchmarks/startup.py --rounds {rounds}{other} --write`.",
        "",
        f"- machine: {machine()}",
        f"- versions: {versions()}",
        f"- date: {datetime.datetime.now(tz=datetime.UTC).date().isoformat()}; {rounds} rounds",
        f"- load average during the last rounds, other work included: {os.getloadavg()[0]:.1f}",
        f"- byte code of numba: {'stored' if _has_byte_code('numba') else 'compiled anew by every process'}",
        "",
        *table(heads, lines),
        "",
        _HOW_READ.rstrip(),
    ]


def _cell(took: Sequence[Took]) -> str:
    walls, processor_s = [t.wall_s for t in took], min(t.processor_s for t in took)
    return f"{statistics.median(walls):.2f} ({min(walls):.2f}; {processor_s:.2f})"


def _has_byte_code(package: str) -> bool:
    found = importlib.util.find_spec(package)
    return bool(found and found.origin and Path(importlib.util.cache_from_source(found.origin)).exists())


if __name__ == "__main__":
    sys.exit(ended(main))
