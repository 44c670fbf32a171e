"""Measure the link: missions uploaded and read back beside MAVSDK, and what an agent costs.

    python benchmarks/link.py --write

Both clients upload the same mission to the same simulated rovers, over UDP on this machine and in real time:
in turns on loopback, and all at once through relays that delay datagrams and lose some, by seeds that are the
same for both. Agents are measured in a process of their own, by the processor time of all its threads. What
they hear is sent, and what they say is heard, by another process.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import shlex
import statistics
import sys
from collections.abc import AsyncIterator, Iterator, Sequence
from contextlib import asynccontextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path

from link_clients import Transfer, by_mavsdk, by_us, mission_of
from link_roles import EXTRA, LOADS, ROLES, STATUS

from malipp_field.bench.machine import machine
from malipp_field.bench.page import table
from malipp_field.bench.script import ended

ROOT = Path(__file__).resolve().parent
_TRANSFER_HEADS = (
    "link", "client", "runs", "completed", "upload, s", "read-back, s", "both, s", "shortest, s",
    "longest, s", "of MAVSDK's", "processor, s",
)  # fmt: skip
_TRANSFER_WORDS = """\
*Loopback*: the clients take turns. *Late*: each datagram takes {delay_ms:.0f} ms. *Poor*: as late, and with a
probability of {loss:.0%} lost, both ways; run n of either client has the same seed. The rover asks for an
item again after 1 s and gives up after 8 s, as ArduPilot does; a stall of the machine can have the
effect of loss. Times are medians of completed runs."""
_PACKAGES = ("mavsdk", "pymavlink", "eclipse-zenoh", "pydantic")
_COST_HEADS = (
    "load", "vehicles", "frames of each, 1/s", "heard", "telemetry, 1/s", "core for each",
    "vehicles on a core", "longest wait, s",
)  # fmt: skip
_COST_WORDS = f"""\
*Core for each*: processor time of the process of all agents, threads included, by wall time and vehicle,
scaled to all frames where some did not arrive. *Vehicles on a core* is its inverse. *Telemetry*: as another
process has it from the bus. *Longest wait*: of somebody whose turn it was in the event loop.

- *default*: the streams of an ArduPilot telemetry port (attitude and speed at {EXTRA:.0f} Hz, the rest at
  {STATUS:.0f} Hz) and what the agent asks for (position and mission item at 5 Hz).
- *10-hz*: position, attitude, speed and mission item at 10 Hz; telemetry at 10 Hz.
- *all-10-hz*: every stream at 10 Hz, telemetry at 10 Hz.
"""
CLIENTS = (by_us, by_mavsdk)


async def uploads(options: argparse.Namespace) -> tuple[list[Transfer], dict[str, float]]:
    """Measure on loopback in turns, then on each of the other links all runs at once.

    Also returns the longest stall of the rovers' process, by link.
    """
    items, found, stalls_s = mission_of(options.items), [], {}
    arguments = ("--slow-repeats", options.slow_repeats, "--loss", options.loss, "--delay", options.delay)
    async with child("rovers", *arguments) as rovers:
        ports = json.loads(await rovers.readline())
        for repeat in range(options.repeats + 1):
            for client in CLIENTS:
                result = await client(ports["r0"]["loopback"], 1, items, "loopback")
                found += [result] if repeat else []  # the first of each loads code
        stalls_s["loopback"] = json.loads(await rovers.ask())
        for link in ("late", "poor"):
            # Each run has a rover of its own; relays 2k and 2k + 1 lose the same.
            runs = [
                client(ports[f"r{n}"][link], 1 + n, items, link)
                for n, client in enumerate(CLIENTS * options.slow_repeats)
            ]
            for ready in asyncio.as_completed(runs):
                found.append(await ready)
                print(found[-1], file=sys.stderr)
            stalls_s[link] = json.loads(await rovers.ask())
    return found, stalls_s


@dataclass(frozen=True)
class Cost:
    """What a number of agents in one process took over a while, and whether they kept up.

    ``heard_hz`` are frames of a vehicle, ``told_hz`` its telemetry as another process had it from the bus;
    ``late_s`` is the longest that the event loop let somebody wait.
    """

    load: str
    vehicles: int
    wall_s: float
    processor_s: float
    heard_hz: float
    told_hz: float
    late_s: float

    @property
    def share(self) -> float:
        """Part of a core that each vehicle takes when all that it sends arrives."""
        taken = self.processor_s / self.wall_s / self.vehicles
        return taken * sum(LOADS[self.load].rates_hz.values()) / self.heard_hz


async def costs(options: argparse.Namespace) -> list[Cost]:
    """Measure agents at every load."""
    found = []
    for name in LOADS:
        for vehicles in options.vehicles:
            async with child("team", "--load", name, "--vehicles", vehicles) as team:
                said = json.loads(await team.readline())
                arguments = ("--load", name, "--hub", said["hub"], "--seconds", options.seconds)
                async with child("agents", *arguments, "--ports", *said["ports"]) as measured:
                    cost = json.loads(await measured.readline())
                    told = json.loads(await team.ask())
            found.append(Cost(name, vehicles, **cost, **told))
            print(found[-1], file=sys.stderr)
    return found


# Children: rovers and what speaks for them have processes of their own.


class Child:
    """Another role of this script, in a process that ends with its standard input."""

    def __init__(self, process: asyncio.subprocess.Process) -> None:
        self._process = process

    async def readline(self) -> bytes:
        """Return the next line it says."""
        assert self._process.stdout is not None
        line = await self._process.stdout.readline()
        assert line, "a child has ended"
        return line

    async def ask(self) -> bytes:
        """Ask it to say its next line."""
        assert self._process.stdin is not None
        self._process.stdin.write(b"\n")
        return await self.readline()


@asynccontextmanager
async def child(*arguments: object) -> AsyncIterator[Child]:
    """Run a role while the context lasts."""
    process = await asyncio.create_subprocess_exec(
        sys.executable,
        __file__,
        *map(str, arguments),
        stdin=asyncio.subprocess.PIPE,
        stdout=asyncio.subprocess.PIPE,
    )
    try:
        yield Child(process)
    finally:
        assert process.stdin is not None
        process.stdin.close()
        await process.wait()


# The page.


def page(
    options: argparse.Namespace,
    transfers: Sequence[Transfer],
    stalls_s: dict[str, float],
    measured: Sequence[Cost],
) -> str:
    """Return the page as Markdown."""
    packages = ", ".join(f"{name} {version(name)}" for name in _PACKAGES)
    gave_up = [
        f"- {t.client}, {t.link}: gave up after {t.total_s:.1f} s ({t.failure})"
        for t in transfers
        if t.failure
    ]
    lines = [
        "# The link, measured", "",
        f"Made by `{shlex.join(['python', 'benchmarks/link.py', *sys.argv[1:]])}`.", "",
        f"- date: {datetime.now(UTC):%Y-%m-%d}",
        f"- machine: {machine()}",
        f"- versions: Python {sys.version.split()[0]}, {packages}",
        f"- load average at the end, other work included: {os.getloadavg()[0]:.1f}", "",
        f"## A mission of {options.items} items, uploaded and read back", "",
        *table(_TRANSFER_HEADS, _transfer_lines(transfers)), "",
        *gave_up,
        "- longest stall of the rovers' process, by the other work of the machine: "
        + ", ".join(f"{link} {stall_s:.2f} s" for link, stall_s in stalls_s.items()), "",
        _TRANSFER_WORDS.format(delay_ms=1000 * options.delay, loss=options.loss), "",
        "## What agents take", "",
        *table(_COST_HEADS, map(_cost_line, measured)), "",
        _COST_WORDS,
    ]  # fmt: skip
    return "\n".join(lines)


def _transfer_lines(transfers: Sequence[Transfer]) -> Iterator[list[str]]:
    for link in dict.fromkeys(t.link for t in transfers):
        medians: dict[str, float] = {}
        for client in ("MAVSDK", "malipp-field"):
            runs = [t for t in transfers if (t.link, t.client) == (link, client)]
            good = [t for t in runs if not t.failure]
            first = [link, client, str(len(runs)), str(len(good))]
            if not good:
                yield [*first, *[""] * 7]
                continue
            uploads_s, backs_s, totals_s, processors_s = zip(
                *((t.upload_s, t.read_back_s, t.total_s, t.processor_s) for t in good), strict=True
            )
            medians[client] = statistics.median(totals_s)
            figures_s = (
                statistics.median(uploads_s), statistics.median(backs_s), medians[client], min(totals_s),
                max(totals_s),
            )  # fmt: skip
            ratio = f"{medians[client] / medians['MAVSDK']:.2f}" if "MAVSDK" in medians else ""
            # What runs at the same time shares the processor time of the process.
            processor = f"{statistics.median(processors_s):.3f}" if link == "loopback" else ""
            yield [*first, *(f"{figure_s:.3g}" for figure_s in figures_s), ratio, processor]


def _cost_line(cost: Cost) -> list[str]:
    sent_hz = sum(LOADS[cost.load].rates_hz.values())
    return [
        cost.load, str(cost.vehicles), f"{sent_hz:.0f}", f"{cost.heard_hz / sent_hz:.1%}",
        f"{cost.told_hz:.1f}", f"{cost.share:.2%}", f"{1.0 / cost.share:.0f}", f"{cost.late_s:.2f}",
    ]  # fmt: skip


def main() -> int:
    """Measure, print the page, and write it where that is asked for."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("role", nargs="?", choices=ROLES, help=argparse.SUPPRESS)
    parser.add_argument("--items", type=int, default=100, help="items of the mission (default 100)")
    parser.add_argument(
        "--repeats", type=int, default=15, help="runs of each client on loopback (default 15)"
    )
    parser.add_argument("--slow-repeats", type=int, default=5, help="and on the other links (default 5)")
    parser.add_argument("--loss", type=float, default=0.1, help="part of datagrams lost (default 0.1)")
    parser.add_argument("--delay", type=float, default=0.2, help="seconds each is late (default 0.2)")
    parser.add_argument("--vehicles", type=int, nargs="+", default=[10, 50], help="agents (default 10 50)")
    parser.add_argument("--seconds", type=float, default=20.0, help="to measure agents for (default 20)")
    parser.add_argument("--write", action="store_true", help="replace benchmarks/link.md")
    for hidden in ("--load", "--hub"):
        parser.add_argument(hidden, help=argparse.SUPPRESS)
    parser.add_argument("--ports", type=int, nargs="*", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.role is not None:
        asyncio.run(ROLES[options.role](options))
        return 0
    text = page(options, *asyncio.run(uploads(options)), asyncio.run(costs(options)))
    print(text)
    if options.write:
        (ROOT / "link.md").write_text(text, encoding="utf-8")
    return 0


if __name__ == "__main__":
    raise SystemExit(ended(main))
