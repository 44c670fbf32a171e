"""The recorder: one more listener on the bus, which writes down all it hears."""

from __future__ import annotations

import asyncio
import contextlib
from pathlib import Path
from types import TracebackType

from malipp_field.bus.messages import (
    Confirmation,
    Event,
    Ledger,
    Message,
    MissionText,
    PlanAdopted,
    Telemetry,
    presence_key,
    root,
    vehicle_key,
)
from malipp_field.bus.session import Bus
from malipp_field.record.writer import RunWriter

RECORDER_PRESENCE = "recorder"
"""Under this name the recorder is present on the bus (`presence_key`)."""

FLUSH_INTERVAL_S = 0.5
"""Wall time between two flushes. With the disk's own time to write, a power cut costs less than a second."""

SETTLE_S = 0.5
"""On leaving, the wall time without news (telemetry is none) after which nothing more is on its way."""
SETTLE_LIMIT_S = 5.0
"""The longest wait for that, on a bus that does not fall silent."""


class Recorder:
    """Records one mission's messages while the context lasts.

    Enter it before the coordinator publishes the mission. On leaving it waits for what is still on its way,
    then finishes the file, also when the run failed; messages that come later are ignored.

    Parameters
    ----------
    bus
        An open session.
    mission
        Name of the mission, as in the keys on the bus.
    path
        The MCAP file to write.

    Raises
    ------
    InputError
        When the file cannot be written.
    """

    def __init__(self, bus: Bus, mission: str, path: Path) -> None:
        self._bus, self._mission, self._path = bus, mission, path
        self._news = 0

    async def __aenter__(self) -> Recorder:
        self._writer = RunWriter(self._path)
        try:
            await self._listen()
        except BaseException:
            self._writer.close()
            raise
        self._flushing = asyncio.create_task(self._flush_now_and_then(), name="recorder")
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, fault: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            await self._settle()
            self._flushing.cancel()
            # What ended the flushing other than this cancellation (a full disk) is the caller's to know.
            with contextlib.suppress(asyncio.CancelledError):
                await self._flushing
        finally:
            self._flushing.cancel()
            self._writer.close()

    async def _settle(self) -> None:
        """Wait for messages said before now: each subscription delivers from a thread of its own."""
        limit_s = asyncio.get_running_loop().time() + SETTLE_LIMIT_S
        before = -1
        while self._news != before and asyncio.get_running_loop().time() < limit_s:
            before = self._news
            await asyncio.sleep(SETTLE_S)

    async def _listen(self) -> None:
        keys: dict[str, type[Message]] = {
            f"{root(self._mission)}/mission": MissionText,
            f"{root(self._mission)}/plan": PlanAdopted,
            f"{root(self._mission)}/ledger": Ledger,
            f"{root(self._mission)}/event": Event,
            vehicle_key(self._mission, "*", "telemetry"): Telemetry,
            vehicle_key(self._mission, "*", "confirmation"): Confirmation,
        }
        for key, kind in keys.items():
            await self._bus.subscribe(key, kind, self._record)
        # Last: whoever sees it can be sure that what it says now is written down.
        await self._bus.present(presence_key(self._mission, RECORDER_PRESENCE))

    def _record(self, key: str, message: Message) -> None:
        if not self._writer.closed:
            self._writer.write(key, message)
            self._news += not isinstance(message, Telemetry)

    async def _flush_now_and_then(self) -> None:
        """Flush by the wall's clock, whatever the mission's clock does: power fails in real time."""
        while True:
            await asyncio.sleep(FLUSH_INTERVAL_S)
            self._writer.flush()
            await asyncio.to_thread(self._writer.sync)
