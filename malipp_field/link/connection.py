"""MAVLink frames over UDP, in asyncio: whatever bytes arrive, only whole and valid messages come out."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable
from typing import cast

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from malipp_field.errors import LinkError
from malipp_field.link.exchange import GROUND_COMPONENT, GROUND_SYSTEM, MavMessage

_MARKERS = (mavlink.PROTOCOL_MARKER_V1, mavlink.PROTOCOL_MARKER_V2)
_CRC_LENGTH = 2
_SIGNATURE_LENGTH = 13
_SIGNED = 0x01

log = logging.getLogger(__name__)


class FrameReader:
    """Finds MAVLink frames in datagrams, each of which holds whole frames.

    pymavlink's own stream parser takes a length from garbage and swallows the good frames behind it; here a
    frame that does not decode costs one byte, and the search goes on at the next.

    Attributes
    ----------
    malformed : int
        Datagrams that held something other than valid frames.
    unknown : int
        Frames of a message that the dialect does not know.
    """

    def __init__(self, mav: mavlink.MAVLink) -> None:
        self._mav = mav
        self.malformed = 0
        self.unknown = 0

    def feed(self, datagram: bytes) -> list[MavMessage]:
        """Return the valid messages of a datagram."""
        messages, at, clean = [], 0, True
        while at < len(datagram):
            length = _frame_length(datagram, at)
            message = self._decode(datagram[at : at + length]) if length else None
            unknown = isinstance(message, mavlink.MAVLink_unknown)
            # The checksum of an unknown message cannot be verified: amid garbage it is taken for garbage.
            clean = clean and message is not None
            valid = message is not None and (clean or not unknown)
            at += length if valid else 1
            self.unknown += valid and unknown
            if valid and not unknown:
                messages.append(message)
        self.malformed += not clean
        return messages

    def _decode(self, frame: bytes) -> MavMessage | None:
        try:
            return self._mav.decode(bytearray(frame))
        except mavlink.MAVError:
            return None


def _frame_length(data: bytes, at: int) -> int:
    """Return the length of the frame that may begin at ``at``, 0 when none can."""
    if data[at] not in _MARKERS or at + 3 > len(data):
        return 0
    version_2 = data[at] == mavlink.PROTOCOL_MARKER_V2
    header = mavlink.HEADER_LEN_V2 if version_2 else mavlink.HEADER_LEN_V1
    signature = _SIGNATURE_LENGTH if version_2 and data[at + 2] & _SIGNED else 0
    length = int(header) + data[at + 1] + _CRC_LENGTH + signature
    return length if at + length <= len(data) else 0


class MavConnection(asyncio.DatagramProtocol):
    """One UDP endpoint towards one vehicle; make it with `open`.

    Attributes
    ----------
    reader : FrameReader
        Counts what was malformed.
    faults : int
        Messages whose handling raised an exception; logged, and never the end of the connection.
    """

    def __init__(self, on_message: Callable[[MavMessage], None], system_id: int, component_id: int) -> None:
        self._mav = mavlink.MAVLink(None, srcSystem=system_id, srcComponent=component_id)
        self._on_message = on_message
        self._transport: asyncio.DatagramTransport | None = None
        self.reader = FrameReader(self._mav)
        self.faults = 0

    @classmethod
    async def open(
        cls,
        url: str,
        on_message: Callable[[MavMessage], None],
        system_id: int = GROUND_SYSTEM,
        component_id: int = GROUND_COMPONENT,
    ) -> MavConnection:
        """Open an endpoint that sends to, and hears, one address.

        Parameters
        ----------
        url
            ``udpout:HOST:PORT``.
        on_message
            Called in the event loop for every valid message.
        system_id, component_id
            As whom to speak. ArduPilot's ground station failsafe counts heartbeats of 255 by default.

        Raises
        ------
        LinkError
            When the URL is not of that form, or the address cannot be used.
        """
        host, port = _address(url)
        loop = asyncio.get_running_loop()
        try:
            _, connection = await loop.create_datagram_endpoint(
                lambda: cls(on_message, system_id, component_id), remote_addr=(host, port)
            )
        except OSError as fault:
            raise LinkError(f"{url}: {fault.strerror or fault}") from None
        return connection

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Keep the transport (asyncio's callback)."""
        self._transport = cast(asyncio.DatagramTransport, transport)

    def datagram_received(self, data: bytes, _addr: object) -> None:
        """Hand on the messages of a datagram (asyncio's callback)."""
        for message in self.reader.feed(data):
            try:
                self._on_message(message)
            except Exception:
                self.faults += 1
                log.exception("handling %s failed", message.get_type())

    def send(self, message: MavMessage) -> None:
        """Send a message; a vehicle that is not there is noticed by its silence, not here."""
        if self._transport is None or self._transport.is_closing():
            return
        self._transport.sendto(message.pack(self._mav))
        self._mav.seq = (self._mav.seq + 1) % 256

    def close(self) -> None:
        """Close the endpoint."""
        if self._transport is not None:
            self._transport.close()


def _address(url: str) -> tuple[str, int]:
    scheme, _, rest = url.partition(":")
    host, _, port = rest.rpartition(":")
    if scheme != "udpout" or not host or not port.isdecimal() or not 0 < int(port) < 2**16:
        raise LinkError(f"'{url}' is not a link: expected udpout:HOST:PORT")
    return host, int(port)
