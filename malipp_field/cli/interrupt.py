"""Ctrl-C as a request to end well: the first is noted, the second interrupts."""

from __future__ import annotations

import signal
from types import FrameType, TracebackType


class Interruption:
    """While this is entered, the first SIGINT sets `asked`; a second one raises `KeyboardInterrupt`."""

    def __init__(self) -> None:
        self.asked = False

    def __enter__(self) -> Interruption:
        self._before = signal.signal(signal.SIGINT, self._heard)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, fault: BaseException | None, trace: TracebackType | None
    ) -> None:
        signal.signal(signal.SIGINT, self._before)

    def _heard(self, _number: int, _frame: FrameType | None) -> None:
        if self.asked:
            raise KeyboardInterrupt
        self.asked = True
