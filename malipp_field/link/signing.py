"""MAVLink 2 signatures, both ways: who may speak to us, and how we show that it is us.

Source: https://mavlink.io/en/guide/message_signing.html. pymavlink signs what is sent. What arrives is
checked here: pymavlink takes the timestamp of a forged frame for its stream's newest, which shuts the true
sender out, accepts unknown messages unsigned, and knows no age limit but for new streams.
"""

from __future__ import annotations

import hashlib
import hmac
from collections.abc import Callable
from typing import Literal, NoReturn, TypeAlias

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from malipp_field.link.frames import Frame

Stream: TypeAlias = tuple[int, int, int]
"""System, component and link id."""
Refusal: TypeAlias = Literal["unsigned", "forged", "replayed", "stale"]
"""Not signed; not with our key; not newer than the last of its stream; too far behind us."""

KEY_LENGTH = 32
TICKS_PER_S = 100_000
MAX_AGE_TICKS = 6_000_000
"""One minute."""
LINK_ID = 77
"""Ours; ground stations number their links from 0, and who shares a link id shares its timestamps."""

_EPOCH_S = 1_420_070_400  # 2015-01-01
_LAST_TICK = 2**48 - 1
_SIGNATURE_LENGTH = 6
_STAMP = slice(-12, -6)
_LINK_ID_AT = -13
_MAY_BE_UNSIGNED = frozenset({mavlink.MAVLINK_MSG_ID_RADIO_STATUS})


def ticks(time_s: float) -> int:
    """Return a time since the Unix epoch in units of 10 microseconds since 2015."""
    return max(0, int((time_s - _EPOCH_S) * TICKS_PER_S))


class Stamps:
    """The timestamps of one key: none is used twice, none is believed twice.

    Parameters
    ----------
    newest
        Where to begin.
    streams
        The last timestamp of every stream heard before.
    reserve
        Called when a timestamp is needed that is not below `limit`; it must raise the limit.

    Attributes
    ----------
    newest : int
        The newest timestamp sent or heard.
    limit : int
        Timestamps below are on record; see `KeyFile`.
    streams : dict of Stream to int
        The last timestamp of every stream.
    """

    def __init__(
        self,
        newest: int = 0,
        streams: dict[Stream, int] | None = None,
        reserve: Callable[[], None] | None = None,
    ) -> None:
        self.newest = newest
        self.limit = _LAST_TICK + 1
        self.streams = {} if streams is None else dict(streams)
        self._reserve = reserve

    def next(self, now_s: float) -> int:
        """Return the timestamp of a frame to be sent: the time, and above all that has been sent or heard."""
        self._advance(max(self.newest + 1, ticks(now_s)))
        return self.newest

    def refusal(self, stream: Stream, stamp: int, now_s: float) -> Refusal | None:
        """Return why a rightly signed frame is not new, or None and remember its timestamp."""
        if stamp <= self.streams.get(stream, -1):
            return "replayed"
        if stamp + MAX_AGE_TICKS < max(self.newest, ticks(now_s)):
            return "stale"
        self.streams[stream] = stamp
        self._advance(max(self.newest, stamp))
        return None

    def _advance(self, newest: int) -> None:
        self.newest = min(newest, _LAST_TICK)
        if self.newest >= self.limit and self._reserve is not None:
            self._reserve()


class SigningKey:
    """The key that one vehicle and we share; its text is in no representation of it.

    Parameters
    ----------
    secret
        32 bytes.
    stamps
        Timestamps used with this key before; without them they count from the clock.
    """

    def __init__(self, secret: bytes, stamps: Stamps | None = None) -> None:
        if len(secret) != KEY_LENGTH:
            raise ValueError(f"a signing key has {KEY_LENGTH} bytes, found {len(secret)}")
        self._secret = secret
        self._hash = hashlib.sha256(secret)
        self._stamps = Stamps() if stamps is None else stamps

    def __repr__(self) -> str:
        return "SigningKey(...)"

    def __reduce__(self) -> NoReturn:
        raise TypeError("a signing key is not written down")

    def pack(self, message: mavlink.MAVLink_message, packer: mavlink.MAVLink, now_s: float) -> bytes:
        """Return the signed frame of a message, sent as whom the packer says."""
        packer.signing.secret_key = self._secret
        packer.signing.link_id = LINK_ID
        packer.signing.timestamp = self._stamps.next(now_s)
        packer.signing.sign_outgoing = True
        return bytes(message.pack(packer))

    def refusal(self, frame: Frame, now_s: float) -> Refusal | None:
        """Return why a frame is not to be believed, or None when it is.

        A SiK radio reports on itself unsigned; ArduPilot, too, accepts that.
        """
        if not frame.signed:
            return None if frame.message_id in _MAY_BE_UNSIGNED else "unsigned"
        expected = self._hash.copy()
        expected.update(frame.data[:-_SIGNATURE_LENGTH])
        if not hmac.compare_digest(expected.digest()[:_SIGNATURE_LENGTH], frame.data[-_SIGNATURE_LENGTH:]):
            return "forged"
        stream = (frame.system, frame.component, frame.data[_LINK_ID_AT])
        return self._stamps.refusal(stream, int.from_bytes(frame.data[_STAMP], "little"), now_s)

    def setup(self, system: int, component: int, now_s: float) -> mavlink.MAVLink_message:
        """Return the message that gives a vehicle this key, in clear; keep it off radios and out of logs."""
        return mavlink.MAVLink_setup_signing_message(
            system, component, list(self._secret), self._stamps.next(now_s)
        )
