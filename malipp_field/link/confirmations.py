"""Payload confirmations in order, each once, whatever the link does to them; no I/O."""

from __future__ import annotations

from malipp_field.vehicle.payload_protocol import REPEAT_S, PayloadReport

JOINING_S = 8 * REPEAT_S
"""How long to listen to a script that is in mid-count before its lowest number is taken for the next."""


class ConfirmationInbox:
    """Puts the confirmations of one payload script into order.

    The script numbers them from 1 without gaps and repeats each until it is acknowledged, the first that is
    not above all. An inbox that is younger than the script finds out where the count stands: what was
    acknowledged to somebody else is never said again. A number that comes again with other contents means
    that the script was restarted and counts anew.

    Attributes
    ----------
    heard : int
        Highest number that has been accepted, and all before it: what may be acknowledged; 0 while that is
        not known.
    """

    def __init__(self) -> None:
        self.heard = 0
        self._accepted: dict[int, PayloadReport] = {}
        self._early: dict[int, PayloadReport] = {}
        self._joined_s: float | None = None  # since when an unknown count is listened to

    def put(self, report: PayloadReport, now_s: float) -> None:
        """Take in a report as it arrives."""
        if report.number <= self.heard:
            if self._accepted.get(report.number) == report:
                return
            self.heard, self._joined_s = 0, None
            self._accepted.clear()
            self._early.clear()
        self._early[report.number] = report
        if self.heard or 1 in self._early:
            return
        if self._joined_s is None:
            self._joined_s = now_s
        elif now_s >= self._joined_s + JOINING_S:
            self.heard = min(self._early) - 1

    def next(self) -> PayloadReport | None:
        """Return the next report in order, or None when it has not arrived; see `accept`."""
        return self._early.get(self.heard + 1)

    def accept(self) -> None:
        """Note that the next report is safe: published, so that it may be acknowledged."""
        report = self._early.pop(self.heard + 1)
        self.heard += 1
        self._accepted[self.heard] = report
