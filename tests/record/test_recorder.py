"""The recorder on a bus: it writes what it hears, soon, and finishes its file whatever happens."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest
from record_cases import KEY, TEXT, telemetry

from malipp_field.bus import Bus, Event, Ledger, Message
from malipp_field.bus.messages import root, vehicle_key
from malipp_field.errors import InputError
from malipp_field.record import Recorder, RunWriter, read_run, recorder

END = Event(time_s=1009.0, source="test", severity="info", text="end")


async def _say(bus: Bus, messages: list[tuple[str, Message]]) -> None:
    """Publish, and return when everything has reached every subscriber of this session."""
    ends = 0
    both = asyncio.Event()

    def count(_key: str, _event: Event) -> None:
        nonlocal ends
        ends += 1
        if ends == 2:  # deliveries are in order: with the second end, the first one is through for all
            both.set()

    await bus.subscribe(f"{root('patch')}/event", Event, count)
    for key, message in [*messages, (f"{root('patch')}/event", END), (f"{root('patch')}/event", END)]:
        bus.publish(key, message)
    await asyncio.wait_for(both.wait(), timeout=20.0)


def test_records_what_is_said_of_its_mission_and_nothing_else(tmp_path: Path) -> None:
    async def main() -> int:
        async with Bus() as bus:
            async with Recorder(bus, "patch", tmp_path / "run.mcap"):
                await _say(
                    bus,
                    [
                        (KEY, TEXT),
                        (vehicle_key("patch", "r1", "telemetry"), telemetry(1001.0)),
                        (vehicle_key("other", "r1", "telemetry"), telemetry(1002.0)),
                        (vehicle_key("patch", "r1", "telemetry"), telemetry(1003.0)),
                        (f"{root('patch')}/ledger", Ledger(time_s=1004.0, samples=())),
                    ],
                )
            bus.publish(f"{root('patch')}/event", END)  # too late, and no harm
            return bus.rejected

    assert asyncio.run(main()) == 0
    run = read_run(tmp_path / "run.mcap")
    assert run.complete
    assert run.mission.name == "patch"
    assert [report.time_s for report in run.telemetry["r1"]] == [1001.0, 1003.0]
    assert len(run.ledgers) == 1
    assert {event.text for event in run.events} == {"end"}


def test_the_file_is_finished_when_the_run_fails(tmp_path: Path) -> None:
    async def main() -> None:
        async with Bus() as bus, Recorder(bus, "patch", tmp_path / "run.mcap"):
            await _say(bus, [(KEY, TEXT)])
            raise RuntimeError("coordinator lost")

    with pytest.raises(RuntimeError, match="coordinator lost"):
        asyncio.run(main())
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
        async with Bus() as bus, Recorder(bus, "patch", tmp_path / "run.mcap"):
            await _say(bus, [(KEY, TEXT)])
            for _ in range(syncs.qsize() + 2):  # the second from now follows a flush that has the message
                await asyncio.wait_for(syncs.get(), timeout=20.0)
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
