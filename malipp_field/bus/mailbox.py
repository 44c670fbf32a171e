"""What has arrived on the bus and waits for the event loop to deliver it."""

from __future__ import annotations

import logging
import threading
from collections import OrderedDict, deque
from collections.abc import Callable, Hashable
from typing import Any

TELEMETRY_BACKLOG = 64
"""Telemetry kept of one key while the event loop is behind: about 13 s of it in real time."""
_AT_ONCE = 100
"""Deliveries after which the event loop gets to do something else."""

log = logging.getLogger(__name__)

_Delivery = tuple[Callable[..., None], tuple[Any, ...]]


class Mailbox:
    """Deliveries in the order of their arrival, put in by other threads and made in the event loop.

    Of telemetry only the newest is kept where the loop is behind; all else waits as long as it takes.

    Parameters
    ----------
    wake
        Has the event loop call `deliver`; called from whatever thread puts something in.

    Attributes
    ----------
    dropped : int
        Deliveries of telemetry that were never made.
    """

    def __init__(self, wake: Callable[[Callable[[], None]], None]) -> None:
        self._wake = wake
        self._lock = threading.Lock()
        self._waiting: OrderedDict[int, _Delivery] = OrderedDict()
        self._telemetry: dict[Hashable, deque[int]] = {}
        self._put = 0
        self._awake = False
        self.dropped = 0

    def __len__(self) -> int:
        return len(self._waiting)

    def put(self, subject: Hashable | None, callback: Callable[..., None], *arguments: Any) -> None:
        """Have ``callback(*arguments)`` called; ``subject`` is given for telemetry, and says of what."""
        with self._lock:
            self._put += 1
            self._waiting[self._put] = (callback, arguments)
            if subject is not None:
                self._keep_newest(subject)
            asleep, self._awake = not self._awake, True
        if asleep:
            self._wake(self.deliver)

    def _keep_newest(self, subject: Hashable) -> None:
        numbers = self._telemetry.setdefault(subject, deque())
        numbers.append(self._put)
        # Those delivered meanwhile have left the front of the line.
        while numbers[0] not in self._waiting:
            numbers.popleft()
        if len(numbers) > TELEMETRY_BACKLOG:
            del self._waiting[numbers.popleft()]
            self.dropped += 1

    def deliver(self) -> None:
        """Make the deliveries that wait, in the event loop; after some, let it do other things first."""
        for _ in range(_AT_ONCE):
            with self._lock:
                if not self._waiting:
                    self._awake = False
                    return
                _, (callback, arguments) = self._waiting.popitem(last=False)
            try:
                callback(*arguments)
            except Exception:  # the fault of one listener; the next delivery may be another's
                log.exception("what arrived on the bus could not be handled")
        self._wake(self.deliver)
