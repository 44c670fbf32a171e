"""What carries bytes: UDP, TCP or a serial port, in asyncio.

A wire takes bytes while it is `ready` and keeps no more than a few frames: what waits, waits in the `Outbox`
of its link. When it breaks it says so once, and is of no use any more.
"""

from __future__ import annotations

import asyncio
import errno
import os
import socket
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import Any, Protocol, TypeAlias, cast

import serial

from malipp_field.mission.link_url import LinkUrl

Address: TypeAlias = tuple[Any, ...]
"""Of a socket, as asyncio has it."""

CONNECT_LIMIT_S = 10.0
"""Wall seconds that a TCP connection may take to be made, or to fall silent without being lost."""
_READ_BYTES = 4096
_SOCKET_BUFFER_BYTES = 16384
"""Of a TCP connection towards a radio that is slower: what the system keeps there can be replaced no more."""


@dataclass(frozen=True)
class Ends:
    """Whom a wire tells.

    Attributes
    ----------
    received
        Bytes, and for a datagram of a listening socket whence.
    ready
        The wire takes bytes again.
    lost
        It is broken, and why.
    """

    received: Callable[[bytes, Address | None], None]
    ready: Callable[[], None]
    lost: Callable[[str], None]


class Wire(Protocol):
    """An open wire."""

    @property
    def ready(self) -> bool:
        """Whether it takes bytes now."""
        ...

    def write(self, data: bytes, to: Address | None) -> None:
        """Send one frame; ``to`` is for listening sockets."""
        ...

    def close(self) -> None:
        """Close it; nothing is said of that."""
        ...


OpenWire: TypeAlias = Callable[[LinkUrl, Ends], Awaitable[Wire]]


async def open_wire(url: LinkUrl, ends: Ends) -> Wire:
    """Open the wire of a URL.

    Raises
    ------
    OSError
        When it cannot be opened now.
    """
    loop = asyncio.get_running_loop()
    where = (url.place, url.number)
    match url.scheme:
        case "udpin":
            _, wire = await loop.create_datagram_endpoint(lambda: _Datagrams(ends, True), local_addr=where)
            return wire
        case "udpout":
            _, wire = await loop.create_datagram_endpoint(lambda: _Datagrams(ends, False), remote_addr=where)
            return wire
        case "tcp":
            async with asyncio.timeout(CONNECT_LIMIT_S):
                _, stream = await loop.create_connection(lambda: _TcpStream(ends), *where)
            return stream
        case "serial":
            port = await asyncio.to_thread(_open_port, url.place, url.number)
            return _SerialPort(port, ends)


class _Socket(asyncio.BaseProtocol):
    """What datagrams and streams have in common."""

    def __init__(self, ends: Ends) -> None:
        self._ends = ends
        self._transport: Any = None
        self._paused = self._closed = False

    @property
    def ready(self) -> bool:
        return not self._paused

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = transport
        self._transport.set_write_buffer_limits(high=0)  # paused as soon as the system takes no more

    def pause_writing(self) -> None:
        self._paused = True

    def resume_writing(self) -> None:
        self._paused = False
        self._ends.ready()

    def connection_lost(self, exc: Exception | None) -> None:
        if not self._closed:
            self._ends.lost(fault_in_words(exc))

    def close(self) -> None:
        self._closed = True
        self._transport.abort()


class _Datagrams(_Socket, asyncio.DatagramProtocol):
    """One UDP socket: one that calls hears one address only, one that listens hears all."""

    def __init__(self, ends: Ends, listens: bool) -> None:
        super().__init__(ends)
        self._listens = listens

    def datagram_received(self, data: bytes, addr: Address) -> None:
        self._ends.received(data, addr if self._listens else None)

    def error_received(self, exc: Exception) -> None:
        """Nobody listens there: a vehicle that is not there is noticed by its silence."""

    def write(self, data: bytes, to: Address | None) -> None:
        self._transport.sendto(data, to)


class _TcpStream(_Socket, asyncio.Protocol):
    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        super().connection_made(transport)
        connected = cast(socket.socket, transport.get_extra_info("socket"))
        connected.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SOCKET_BUFFER_BYTES)
        connected.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        patience_ms = getattr(socket, "TCP_USER_TIMEOUT", None)
        if patience_ms is not None:  # where the system has it, heartbeats find out that nobody is there
            connected.setsockopt(socket.IPPROTO_TCP, patience_ms, round(CONNECT_LIMIT_S * 1000))

    def data_received(self, data: bytes) -> None:
        self._ends.received(data, None)

    def write(self, data: bytes, _to: Address | None) -> None:
        self._transport.write(data)


def _open_port(device: str, baud: int) -> serial.Serial:
    try:
        port = serial.Serial(device, baud, timeout=0, write_timeout=0, exclusive=True)
    except ValueError as fault:
        raise OSError(str(fault)) from None
    except serial.SerialException as fault:
        raise OSError(_SERIAL_FAULTS.get(fault.errno) or _plain(fault)) from None
    os.set_blocking(port.fileno(), False)
    return port


_SERIAL_FAULTS = {errno.EAGAIN: "in use by another program", None: "not a serial port"}
"""What pyserial's errors come to; those without a number are about the settings of a terminal."""


def _plain(fault: OSError) -> str:
    return os.strerror(fault.errno) if fault.errno else str(fault)


class _SerialPort:
    def __init__(self, port: serial.Serial, ends: Ends) -> None:
        self._port, self._ends = port, ends
        self._file: int = port.fileno()
        self._loop = asyncio.get_running_loop()
        self._unsent = b""
        self._closed = False
        self._loop.add_reader(self._file, self._readable)

    @property
    def ready(self) -> bool:
        return not self._unsent

    def write(self, data: bytes, _to: Address | None) -> None:
        self._unsent += data
        self._write_on()
        if self._unsent and not self._closed:
            self._loop.add_writer(self._file, self._writable)

    def close(self) -> None:
        if not self._closed:
            self._closed = True
            self._loop.remove_reader(self._file)
            self._loop.remove_writer(self._file)
            self._port.close()

    def _readable(self) -> None:
        try:
            data = os.read(self._file, _READ_BYTES)
        except BlockingIOError:
            return
        except OSError as fault:
            self._break(fault)
            return
        if data:
            self._ends.received(data, None)
        else:
            self._break(None)  # unplugged

    def _writable(self) -> None:
        self._write_on()
        if not self._unsent and not self._closed:
            self._loop.remove_writer(self._file)
            self._ends.ready()

    def _write_on(self) -> None:
        try:
            self._unsent = self._unsent[os.write(self._file, self._unsent) :]
        except BlockingIOError:
            pass
        except OSError as fault:
            self._break(fault)

    def _break(self, fault: OSError | None) -> None:
        self.close()
        self._ends.lost(fault_in_words(fault))


def fault_in_words(fault: BaseException | None) -> str:
    """Return why a wire could not be opened, or broke."""
    if fault is None:
        return "closed at the other end"
    if isinstance(fault, TimeoutError) and not fault.errno:
        return "no answer"
    return (fault.strerror if isinstance(fault, OSError) else None) or str(fault) or type(fault).__name__
