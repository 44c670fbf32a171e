"""The recorder on a bus: it writes what it hears, soon, and finishes its file whatever happens."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from pathlib import Path
from typing import cast

import pytest
from record_cases import KEY, TEXT, telemetry

from malipp_field.bus import Bus, Event, Ledger, Message
from malipp_field.bus.messages import root, vehicle_key
from malipp_field.errors import InputError
from malipp_field.record import Recorder, RunWriter, read_run, recorder

END = Event(time_s=1009.0, source="test", severity="info", text="end")


@pytest.fixture(autouse=True)
def _settle_soon(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recorder, "SETTLE_S", 0.02)


class Watch:
    """Tells how many messages recorders have written, and waits for more."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self._count = 0
        self._changed = asyncio.Event()
        write = RunWriter.write

        def write_and_tell(writer: RunWriter, key: str, message: Message) -> None:
            write(writer, key, message)
            self._count += 1
            self._changed.set()

        monkeypatch.setattr(RunWriter, "write", write_and_tell)

    async def until(self, count: int) -> None:
        """Return when ``count`` messages have been written."""
        async with asyncio.timeout(30.0):
            while self._count < count:
                self._changed.clear()
                await self._changed.wait()


def test_records_what_is_said_of_its_mission_and_nothing_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def main() -> int:
        watch = Watch(monkeypatch)
        async with Bus() as bus:
            async with Recorder(bus, "patch", tmp_path / "run.mcap"):
                bus.publish(vehicle_key("other", "r1", "telemetry"), telemetry(1002.0))
                bus.publish(KEY, TEXT)
                bus.publish(vehicle_key("patch", "r1", "telemetry"), telemetry(1001.0))
                bus.publish(vehicle_key("patch", "r1", "telemetry"), telemetry(1003.0))
                bus.publish(f"{root('patch')}/ledger", Ledger(time_s=1004.0, samples=()))
                bus.publish(f"{root('patch')}/event", END)
                await watch.until(5)
            bus.publish(f"{root('patch')}/event", END)  # too late, and no harm
            return bus.rejected

    assert asyncio.run(main()) == 0
    run = read_run(tmp_path / "run.mcap")
    assert run.complete
    assert run.mission.name == "patch"
    assert [report.time_s for report in run.telemetry["r1"]] == [1001.0, 1003.0]
    assert len(run.ledgers) == 1
    assert run.events == (END,)


def test_the_file_is_finished_when_the_run_fails(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    async def main() -> None:
        watch = Watch(monkeypatch)
        async with Bus() as bus, Recorder(bus, "patch", tmp_path / "run.mcap"):
            bus.publish(KEY, TEXT)
            await watch.until(1)
            raise RuntimeError("coordinator lost")

    with pytest.raises(RuntimeError, match="coordinator lost"):
        asyncio.run(main())
    assert read_run(tmp_path / "run.mcap").complete


class SlowBus:
    """Delivers by hand, as late as a test wants."""

    def __init__(self) -> None:
        self.callbacks: dict[str, Callable[[str, Message], None]] = {}

    async def subscribe(
        self, key_expr: str, kind: type[Message], callback: Callable[[str, Message], None]
    ) -> None:
        self.callbacks[key_expr] = callback

    async def present(self, key: str) -> None:
        assert self.callbacks, "present before it listens"

    def deliver(self, key: str, message: Message) -> None:
        """Deliver now, to the subscription on that very key."""
        self.callbacks[key](key, message)


def test_leaving_waits_for_what_is_on_its_way(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recorder, "SETTLE_S", 0.2)
    event_key = f"{root('patch')}/event"

    async def main() -> None:
        bus = SlowBus()
        async with Recorder(cast("Bus", bus), "patch", tmp_path / "run.mcap"):
            bus.deliver(KEY, TEXT)
            for delay_s in (0.05, 0.25):  # the second comes while the first is being waited out
                asyncio.get_running_loop().call_later(delay_s, bus.deliver, event_key, END)

    asyncio.run(main())
    assert len(read_run(tmp_path / "run.mcap").events) == 2


def test_a_bus_that_does_not_fall_silent_is_left_all_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(recorder, "SETTLE_LIMIT_S", 0.1)

    async def main() -> None:
        bus = SlowBus()

        async def chatter() -> None:
            while True:
                bus.deliver(f"{root('patch')}/event", END)
                await asyncio.sleep(0.002)

        async with Recorder(cast("Bus", bus), "patch", tmp_path / "run.mcap"):
            bus.deliver(KEY, TEXT)
            talking = asyncio.create_task(chatter())
        talking.cancel()

    asyncio.run(asyncio.wait_for(main(), timeout=20.0))
    assert read_run(tmp_path / "run.mcap").complete


def test_what_was_heard_is_on_the_disk_soon(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recorder, "FLUSH_INTERVAL_S", 0.01)
    syncs: asyncio.Queue[None] = asyncio.Queue()
    sync = RunWriter.sync

    async def main() -> None:
        loop = asyncio.get_running_loop()

        def sync_and_tell(writer: RunWriter) -> None:
            sync(writer)
            loop.call_soon_threadsafe(syncs.put_nowait, None)

        monkeypatch.setattr(RunWriter, "sync", sync_and_tell)
        bus = SlowBus()
        async with Recorder(cast("Bus", bus), "patch", tmp_path / "run.mcap"):
            bus.deliver(KEY, TEXT)
            for _ in range(syncs.qsize() + 2):  # the second from now follows a flush that has the message
                await asyncio.wait_for(syncs.get(), timeout=30.0)
            assert not read_run(tmp_path / "run.mcap").complete

    asyncio.run(main())


def test_flushes_often_enough_for_the_second_it_promises() -> None:
    assert recorder.FLUSH_INTERVAL_S <= 0.5


def test_a_place_that_cannot_be_written_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")

    async def main() -> None:
        async with Bus() as bus, Recorder(bus, "patch", tmp_path / "file" / "run.mcap"):
            pass

    with pytest.raises(InputError, match="cannot be written"):
        asyncio.run(main())
