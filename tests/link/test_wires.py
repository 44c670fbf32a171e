"""Wires on real sockets and a pseudo-terminal; each end of theirs is played by the test."""

from __future__ import annotations

import asyncio
import os
import pty
import socket
from collections.abc import Awaitable, Callable
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from wire_cases import HEARTBEAT, said_by

from malipp_field.clock import WallClock
from malipp_field.errors import LinkError
from malipp_field.link import Links, VehicleLink
from malipp_field.link.frames import StreamReader
from malipp_field.link.wires import Ends, open_wire
from malipp_field.mission.link_url import parse_link_url

LIMIT_S = 20.0


class News:
    """What the ground hears, and waiting for it."""

    def __init__(self) -> None:
        self.heard: list[str] = []
        self.events: list[str] = []
        self.waiting = asyncio.Event()

    def message(self, message: Any) -> None:
        self.heard.append(message.get_type())
        self.waiting.set()

    def event(self, severity: str, text: str) -> None:
        self.events.append(text)
        self.waiting.set()

    async def until(self, condition: Callable[[], bool]) -> None:
        while not condition():
            self.waiting.clear()
            await asyncio.wait_for(self.waiting.wait(), LIMIT_S)


def run(scene: Callable[[Links, News], Awaitable[None]]) -> None:
    async def whole() -> None:
        async with Links(WallClock()) as links:
            await scene(links, News())

    asyncio.run(asyncio.wait_for(whole(), 2 * LIMIT_S))


def where(url: str) -> VehicleLink:
    return VehicleLink(parse_link_url(url), 7)


async def read(file: int) -> bytes:
    return await asyncio.wait_for(asyncio.to_thread(os.read, file, 4096), LIMIT_S)


def test_tcp_both_ways_through_a_loss_and_back() -> None:
    async def scene(links: Links, news: News) -> None:
        peers: asyncio.Queue[tuple[asyncio.StreamReader, asyncio.StreamWriter]] = asyncio.Queue()
        server = await asyncio.start_server(lambda r, w: peers.put_nowait((r, w)), "127.0.0.1", 0)
        port = server.sockets[0].getsockname()[1]
        channel = await links.open(where(f"tcp:127.0.0.1:{port}"), news.message, news.event)
        for turn in range(2):
            reader, writer = await peers.get()
            writer.write(b"\xfd\xff noise" + said_by(7)[:5])
            writer.write(said_by(7)[5:])
            await news.until(lambda turn=turn: len(news.heard) == turn + 1)  # type: ignore[misc]
            channel.send(HEARTBEAT)
            assert (await reader.readexactly(21))[0] == 0xFD
            writer.close()
            await news.until(lambda turn=turn: len(news.events) >= 2 * turn + 1)  # type: ignore[misc]
        assert news.events[0].endswith("is lost (closed at the other end); trying again")
        assert news.events[1].endswith("is back")
        server.close()

    run(scene)


def test_a_serial_port_through_a_pseudo_terminal() -> None:
    async def scene(links: Links, news: News) -> None:
        radio, device = pty.openpty()
        url = f"serial:{os.ttyname(device)}:57600"
        channel = await links.open(where(url), news.message, news.event)
        os.close(device)
        with pytest.raises(OSError, match="in use by another program"):
            await open_wire(parse_link_url(url), Ends(lambda data, to: None, lambda: None, lambda why: None))
        os.write(radio, b"garbage" + said_by(7) + said_by(7)[:9])
        os.write(radio, said_by(7)[9:])
        await news.until(lambda: len(news.heard) == 2)
        channel.send(HEARTBEAT)
        assert len(await read(radio)) == 21
        os.close(radio)
        await news.until(lambda: bool(news.events))
        assert "is lost (" in news.events[0]

    run(scene)


def test_a_serial_port_that_is_slow_loses_no_protocol_message() -> None:
    async def scene(links: Links, news: News) -> None:
        radio, device = pty.openpty()
        channel = await links.open(where(f"serial:{os.ttyname(device)}:57600"), news.message, news.event)
        wire: Any = channel._link._wire  # type: ignore[attr-defined]
        texts: list[bytes] = []
        while wire.ready or len(texts) < 100:
            texts.append(f"{len(texts):050d}".encode())
            channel.send(mavlink.MAVLink_statustext_message(6, texts[-1]))
        for number in range(100):
            texts.append(f"{len(texts):050d}".encode())
            channel.send(type(HEARTBEAT)(10, 3, 0, number, 3, 3))
            channel.send(mavlink.MAVLink_statustext_message(6, texts[-1]))
        data = b""
        while texts[-1] not in data:
            data += await read(radio)
        frames = [frame.data for frame in StreamReader().feed(data)]
        assert [frame[11:61] for frame in frames if len(frame) > 50] == texts
        assert [frame[10] for frame in frames if len(frame) < 50] == [99]
        assert news.events == []
        os.close(radio)
        os.close(device)

    run(scene)


def test_udp_listening_and_calling_find_each_other() -> None:
    async def scene(links: Links, news: News) -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.bind(("127.0.0.1", 0))
            port = probe.getsockname()[1]
        listening = await links.open(where(f"udpin:127.0.0.1:{port}"), news.message, news.event)
        loop = asyncio.get_running_loop()
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as vehicle:
            vehicle.bind(("127.0.0.1", 0))
            vehicle.setblocking(False)
            await loop.sock_sendto(vehicle, said_by(7), ("127.0.0.1", port))
            await news.until(lambda: news.heard == ["HEARTBEAT"])
            listening.send(HEARTBEAT)
            assert len(await loop.sock_recv(vehicle, 100)) == 21
            calling = await links.open(
                where(f"udpout:127.0.0.1:{vehicle.getsockname()[1]}"), news.message, news.event
            )
            calling.send(HEARTBEAT)
            data, address = await loop.sock_recvfrom(vehicle, 100)
            assert len(data) == 21
            await loop.sock_sendto(vehicle, said_by(7), address)
            await news.until(lambda: len(news.heard) == 2)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
            taken.bind(("127.0.0.1", 0))
            with pytest.raises(LinkError, match=r"^udpin:127\.0\.0\.1:\d+: .*in use"):
                await links.open(where(f"udpin:127.0.0.1:{taken.getsockname()[1]}"), news.message, news.event)

    run(scene)


def test_nobody_there_is_no_fault_on_udp() -> None:
    async def scene(links: Links, news: News) -> None:
        channel = await links.open(where("udpout:127.0.0.1:9"), news.message, news.event)
        for _ in range(3):
            channel.send(HEARTBEAT)
            await asyncio.sleep(0)
        assert news.events == []

    run(scene)


def test_what_cannot_be_opened_is_one_clear_line(tmp_path: Any) -> None:
    plain = tmp_path / "plain"
    plain.touch()

    async def scene(links: Links, news: News) -> None:
        with socket.socket() as closed:
            closed.bind(("127.0.0.1", 0))
            for url, words in {
                f"tcp:127.0.0.1:{closed.getsockname()[1]}": "refused|failed",
                f"serial:{tmp_path}/none:57600": "No such file or directory",
                f"serial:{plain}:57600": "not a serial port",
            }.items():
                with pytest.raises(LinkError, match=f"^{url}: .*({words})") as caught:
                    await links.open(where(url), news.message, news.event)
                assert "\n" not in str(caught.value)

    run(scene)
