"""MAVLink frames in whatever bytes arrive: datagrams, or a stream that may begin anywhere and lose some.

Frames are found, checked and routed by their header; only those that somebody wants are decoded.
Source: https://mavlink.io/en/guide/serialization.html.
"""

from __future__ import annotations

import re
from typing import NamedTuple

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from malipp_field.link.exchange import MavMessage

SIGNATURE_LENGTH = 13

_V1, _V2 = mavlink.PROTOCOL_MARKER_V1, mavlink.PROTOCOL_MARKER_V2
_MARKER = re.compile(bytes((ord("["), _V2, _V1, ord("]"))))
_CRC_LENGTH = 2
_SIGNED = 0x01


class Frame(NamedTuple):
    """One whole frame.

    Attributes
    ----------
    data
        All of it, signature included.
    message_id, system, component
        From its header.
    signed
        It ends with a signature block, right or wrong.
    """

    data: bytes
    message_id: int
    system: int
    component: int
    signed: bool

    @property
    def known(self) -> bool:
        """Whether the dialect has this message; the checksum of another cannot be verified."""
        return self.message_id in mavlink.mavlink_map


class FrameReader:
    """Finds the frames in datagrams, each of which holds whole frames.

    pymavlink's own stream parser takes a length from garbage and swallows the good frames behind it; here
    what is no valid frame costs one byte, and the search goes on at the next.

    Attributes
    ----------
    malformed : int
        Stretches of bytes that were no valid frames.
    unknown : int
        Frames of a message that the dialect does not know; they are passed over.
    """

    def __init__(self) -> None:
        self.malformed = 0
        self.unknown = 0
        self._clean = True

    def feed(self, data: bytes) -> list[Frame]:
        """Return the valid frames in a datagram."""
        self._clean = True
        frames, at = self._search(data, whole=True)
        assert at == len(data)
        return frames

    def break_off(self) -> None:
        """Forget what was begun: the wire is broken."""
        self._clean = True

    def _search(self, data: bytes, *, whole: bool) -> tuple[list[Frame], int]:
        """Return the frames in ``data``, and up to where it was searched: a frame may end in later data."""
        frames, at = [], 0
        while at < len(data):
            length = _announced_length(data, at)
            if length > len(data) - at and not whole and self._may_begin(data, at):
                break
            frame = _frame(data, at, length) if 0 < length <= len(data) - at else None
            if frame is None or not self._credible(frame.message_id):
                self.malformed += self._clean
                self._clean = False
                at = _next_marker(data, at + 1)
                continue
            self._clean, at = True, at + length
            if frame.known:
                frames.append(frame)
            else:
                self.unknown += 1
        return frames, at

    def _may_begin(self, data: bytes, at: int) -> bool:
        message_id = _message_id(data, at)
        return message_id is None or self._credible(message_id)

    def _credible(self, message_id: int) -> bool:
        """Whether such a message is one: what cannot be verified is taken for garbage amid garbage."""
        return self._clean or message_id in mavlink.mavlink_map


class StreamReader(FrameReader):
    """Finds the frames in a stream of bytes, as a serial port or TCP delivers it.

    After garbage it finds its way at the next frame that is right; a frame cut in two is put together.
    """

    def __init__(self) -> None:
        super().__init__()
        self._rest = b""

    def feed(self, data: bytes) -> list[Frame]:
        """Return the valid frames that are whole now."""
        data = self._rest + data
        frames, at = self._search(data, whole=False)
        self._rest = data[at:]
        return frames

    def break_off(self) -> None:
        """Forget what was begun: the wire is broken."""
        super().break_off()
        self._rest = b""


def decoded(frame: Frame) -> MavMessage | None:
    """Return the message of a frame, or None when its fields cannot be made out.

    Signatures are not looked at: whoever wants them checked has done that.
    """
    kind = mavlink.mavlink_map[frame.message_id]
    if sum(kind.lengths) == len(kind.lengths):
        return _numbers(frame, kind)
    try:
        return _decoder.decode(bytearray(frame.data))
    except mavlink.MAVError:
        return None


def _numbers(frame: Frame, kind: type[MavMessage]) -> MavMessage:
    """Return a message that holds nothing but numbers: most of them, at half of pymavlink's pains.

    It would verify the checksum once more.
    """
    data, version_2 = frame.data, frame.data[0] == _V2
    size, begin = kind.unpacker.size, mavlink.HEADER_LEN_V2 if version_2 else mavlink.HEADER_LEN_V1
    payload = data[begin : begin + min(data[1], size)]
    values = kind.unpacker.unpack(payload.ljust(size, b"\0"))
    message = kind(*(values[i] for i in kind.orders))
    flags = (data[2], data[3]) if version_2 else (0, 0)
    seq = data[4] if version_2 else data[2]
    message._header = mavlink.MAVLink_header(
        frame.message_id, *flags, data[1], seq, frame.system, frame.component
    )
    return message


_decoder = mavlink.MAVLink(None)


def _next_marker(data: bytes, at: int) -> int:
    """Return where the next frame may begin, the end of the data where none does."""
    found = _MARKER.search(data, at)
    return len(data) if found is None else found.start()


def _announced_length(data: bytes, at: int) -> int:
    """Return the length of the frame that may begin at ``at``; 0 when none can."""
    marker = data[at]
    if marker not in (_V1, _V2):
        return 0
    if at + 3 > len(data):
        return len(data) - at + 1  # not to be known yet: longer than what is here
    if marker == _V1:
        return int(mavlink.HEADER_LEN_V1) + data[at + 1] + _CRC_LENGTH
    if data[at + 2] & ~_SIGNED:
        return 0  # flags that one must understand, and nobody has defined
    signature = SIGNATURE_LENGTH if data[at + 2] & _SIGNED else 0
    return int(mavlink.HEADER_LEN_V2) + data[at + 1] + _CRC_LENGTH + signature


def _message_id(data: bytes, at: int) -> int | None:
    """Return the message id of the frame that begins at ``at``; None while it has not arrived."""
    if data[at] == _V1:
        return data[at + 5] if at + 6 <= len(data) else None
    return int.from_bytes(data[at + 7 : at + 10], "little") if at + 10 <= len(data) else None


def _frame(data: bytes, at: int, length: int) -> Frame | None:
    """Return the frame of that length at ``at`` when its checksum is right, or cannot be verified."""
    message_id = _message_id(data, at)
    if message_id is None:
        return None
    version_2 = data[at] == _V2
    signed = version_2 and bool(data[at + 2] & _SIGNED)
    sender = at + (5 if version_2 else 3)
    frame = Frame(data[at : at + length], message_id, data[sender], data[sender + 1], signed)
    message = mavlink.mavlink_map.get(message_id)
    if message is None:
        return frame
    end = length - (SIGNATURE_LENGTH if signed else 0) - _CRC_LENGTH
    checksum = mavlink.x25crc(frame.data[1:end] + bytes((message.crc_extra,))).crc
    return frame if checksum == int.from_bytes(frame.data[end : end + _CRC_LENGTH], "little") else None
