"""MAVProxy as a program of its own, driven as by a person at its prompt."""

from __future__ import annotations

import asyncio
import importlib.util
import os
import re
import signal
import sys
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager, suppress

import pytest
from flight_cases import Assignment, Operated
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from pymavlink.mavwp import MAVWPLoader

from malipp_field.link.compare import differences
from malipp_field.vehicle.items import WITH_PLACE, MissionItem, degrees_e7
from malipp_field.vehicle.layout import lay_out
from malipp_field.vehicle.steps import Step

_SAID_BY_VEHICLE = re.compile(r"AP: (.*)")
_CURRENT_ITEM = re.compile(r"\bwaypoint (\d+)$")
_ITEM_TAKEN = "Got COMMAND_ACK: DO_SET_MISSION_CURRENT: ACCEPTED"
RETYPE_S = 5.0
"""Of wall time, after which a person types again what has had no effect."""


class MavProxy(Operated):
    """MAVProxy with one vehicle: what it prints, and what is typed."""

    def __init__(self, told: Assignment, process: asyncio.subprocess.Process) -> None:
        super().__init__(told.vehicle)
        self._told = told
        self._process = process
        self._news = asyncio.Event()
        self.lines: list[str] = []

    @property
    def group(self) -> int:
        """The process group of MAVProxy and of what it starts."""
        return self._process.pid

    async def upload(self) -> None:
        await self.heard("online system")
        file = self._told.file(".waypoints")
        await self.type(f"wp load {file}", answer="Got MISSION_ACK: TYPE_MISSION: ACCEPTED")
        back = file.with_suffix(".back")
        await self.type(f"wp save {back}", answer=f"waypoints to {back}")
        loader = MAVWPLoader()
        loader.load(str(back))
        read_back = [_item(loader.wp(seq)) for seq in range(loader.count())]
        assert differences(lay_out(self._told.vehicle).items, read_back) == []

    async def start(self) -> None:
        await self.type("arm throttle", answer="AP: Throttle armed")
        await self.type("mode auto", answer="Mode AUTO")

    async def release(self, gate: Step, item: int) -> bool:
        """Type `wp set` until it is seen to have worked: on a busy machine packets of either way are lost."""
        before = len(self.lines)
        while not self._went_on(item, before):
            with suppress(TimeoutError):
                await asyncio.wait_for(self._set_current(item, before), RETYPE_S)
        return True

    async def _set_current(self, item: int, since: int) -> None:
        self._write(f"wp set {item}")
        await self._until(lambda: self._went_on(item, since))

    def _went_on(self, item: int, since: int) -> bool:
        """Return whether the vehicle has said that it took the item, or is seen to be there or beyond."""
        numbers = (_CURRENT_ITEM.search(line) for line in self.lines[since:])
        return any(_ITEM_TAKEN in line for line in self.lines[since:]) or any(
            int(number[1]) >= item for number in numbers if number is not None
        )

    async def type(self, command: str, answer: str) -> None:
        """Type a command, and wait for what MAVProxy prints when it is done."""
        before = len(self.lines)
        self._write(command)
        await self.heard(answer, before)

    async def heard(self, text: str, since: int = 0) -> None:
        """Wait for a line with that text."""
        await self._until(lambda: any(text in line for line in self.lines[since:]))

    def _write(self, command: str) -> None:
        assert self._process.stdin is not None
        self._process.stdin.write(f"{command}\n".encode())

    async def _until(self, seen: Callable[[], bool]) -> None:
        while not seen():
            self._news.clear()
            await self._news.wait()

    async def read(self) -> None:
        """Take in what MAVProxy prints, until it has ended."""
        assert self._process.stdout is not None
        async for data in self._process.stdout:
            line = data.decode(errors="replace").rstrip()
            self.lines.append(line)
            if (said := _SAID_BY_VEHICLE.search(line)) is not None:
                self.shows_text(said[1])
            elif (current := _CURRENT_ITEM.search(line)) is not None:
                self.shows_item(int(current[1]))
            self._news.set()
        self._news.set()


@asynccontextmanager
async def mavproxy(told: Assignment) -> AsyncIterator[MavProxy]:
    """Run MAVProxy for one vehicle; it is gone afterwards, with all it started."""
    if importlib.util.find_spec("MAVProxy") is None:
        pytest.fail("MAVProxy is not installed; `make setup` installs it")
    host, port = told.endpoint
    process = await asyncio.create_subprocess_exec(
        sys.executable, "-u", "-m", "MAVProxy.mavproxy", f"--master=udpout:{host}:{port}", "--no-state",
        cwd=told.folder, env=os.environ | {"HOME": str(told.folder)}, start_new_session=True,
        stdin=asyncio.subprocess.PIPE, stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.STDOUT,
    )  # fmt: skip
    client = MavProxy(told, process)
    reading = asyncio.ensure_future(client.read())
    try:
        yield client
    except BaseException:
        print("\n".join(client.lines[-40:]))  # for whoever looks into the failure
        raise
    finally:
        with suppress(ProcessLookupError):
            os.killpg(client.group, signal.SIGKILL)
        await asyncio.gather(reading, process.wait(), return_exceptions=True)


def _item(row: mavlink.MAVLink_mission_item_message) -> MissionItem:
    """Return a row of a waypoint file as an item."""
    with_place = row.command in WITH_PLACE
    x, y = (degrees_e7(row.x), degrees_e7(row.y)) if with_place else (int(row.x), int(row.y))
    return MissionItem(
        row.seq, row.frame, row.command, row.current, row.autocontinue,
        row.param1, row.param2, row.param3, row.param4, x, y, row.z,
    )  # fmt: skip
