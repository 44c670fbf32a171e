"""Payload confirmations in order, each once, whatever the link does to them; no I/O."""

from __future__ import annotations

from malipp_field.vehicle.payload_protocol import PayloadReport


class ConfirmationInbox:
    """Puts the confirmations of one payload script into order.

    The script numbers them from 1 without gaps and repeats each until it is acknowledged. A number that comes
    again with other contents means that the script was restarted and counts anew.

    Attributes
    ----------
    heard : int
        Highest number that has been accepted, and all before it: what may be acknowledged.
    """

    def __init__(self) -> None:
        self.heard = 0
        self._accepted: dict[int, PayloadReport] = {}
        self._early: dict[int, PayloadReport] = {}

    def put(self, report: PayloadReport) -> None:
        """Take in a report as it arrives."""
        if report.number > self.heard:
            self._early[report.number] = report
        elif self._accepted[report.number] != report:
            self.heard = 0
            self._accepted.clear()
            self._early = {report.number: report}

    def next(self) -> PayloadReport | None:
        """Return the next report in order, or None when it has not arrived; see `accept`."""
        return self._early.get(self.heard + 1)

    def accept(self) -> None:
        """Note that the next report is safe: published, so that it may be acknowledged."""
        report = self._early.pop(self.heard + 1)
        self.heard += 1
        self._accepted[self.heard] = report
