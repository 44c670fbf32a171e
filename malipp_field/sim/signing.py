"""MAVLink 2 signing as an ArduPilot does it: what it accepts and what it puts at the end of its own frames.

Written after the rules of the MAVLink C library, apart from the ground's (`malipp_field.link.signing`),
so that each is tested against the other.
"""

from __future__ import annotations

import hashlib
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

MAX_STREAMS = 16
"""Of the C library: who speaks first, first."""
NEW_STREAM_MAX_AGE = 6_000_000
"""Timestamps are in units of 10 microseconds since 2015; a new stream may be a minute behind."""

_EPOCH_S = 1_420_070_400
_BLOCK = 13
_UNSIGNED_TOO = (mavlink.MAVLINK_MSG_ID_RADIO_STATUS, mavlink.MAVLINK_MSG_ID_RADIO)


def ticks(time_s: float) -> int:
    """Return a time since the Unix epoch as a timestamp."""
    return max(0, int((time_s - _EPOCH_S) * 1e5))


class RadioSigning:
    """The signing of one vehicle's radio; without a key it accepts all and signs nothing.

    Parameters
    ----------
    secret
        32 bytes, or None.
    timestamp
        What it remembers from before, or has from its satellite receiver.

    Attributes
    ----------
    refused : int
        Messages not accepted.
    """

    def __init__(self, secret: bytes | None, timestamp: int) -> None:
        self._secret, self.timestamp = secret, timestamp
        self._streams: dict[tuple[int, int, int], int] = {}
        self.refused = 0

    def __repr__(self) -> str:
        return "RadioSigning(...)"

    def set_up(self, message: Any) -> None:
        """Take on the key of a SETUP_SIGNING; one of zeros ends signing."""
        secret = bytes(message.secret_key)
        self._secret = secret if any(secret) else None
        self.timestamp = max(self.timestamp, message.initial_timestamp)
        self._streams.clear()

    def accepts(self, message: Any) -> bool:
        """Return whether a message is acted upon, and remember its timestamp if so."""
        if self._secret is None or message.get_msgId() in _UNSIGNED_TOO:
            return True
        accepted = self._is_signed_anew(message, bytes(message.get_msgbuf()))
        self.refused += not accepted
        return accepted

    def _is_signed_anew(self, message: Any, frame: bytes) -> bool:
        if frame[0] != mavlink.PROTOCOL_MARKER_V2 or not frame[2] & mavlink.MAVLINK_IFLAG_SIGNED:
            return False
        if self._signature(frame[:-6]) != frame[-6:]:
            return False
        stamp = int.from_bytes(frame[-12:-6], "little")
        stream = (message.get_srcSystem(), message.get_srcComponent(), frame[-_BLOCK])
        last = self._streams.get(stream)
        if last is None:
            fresh = len(self._streams) < MAX_STREAMS and stamp + NEW_STREAM_MAX_AGE >= self.timestamp
        else:
            fresh = stamp > last
        if fresh:
            self._streams[stream] = stamp
            self.timestamp = max(self.timestamp, stamp)
        return fresh

    def prepare(self, packer: mavlink.MAVLink) -> None:
        """Have a packer sign the next message, if messages are signed."""
        packer.signing.sign_outgoing = self._secret is not None
        if self._secret is not None:
            self.timestamp += 1
            packer.signing.secret_key, packer.signing.timestamp = self._secret, self.timestamp

    def _signature(self, frame: bytes) -> bytes:
        return hashlib.sha256((self._secret or b"") + frame).digest()[:6]
