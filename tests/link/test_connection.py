from __future__ import annotations

import asyncio
import random
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from link_cases import SYSTEM, UNHURRIED, ack
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from malipp_field.errors import LinkError
from malipp_field.link.connection import FrameReader, MavConnection

PACKER = mavlink.MAVLink(None, srcSystem=SYSTEM, srcComponent=1)
MESSAGES = [
    mavlink.MAVLink_heartbeat_message(10, 3, 0, 4, 3, 3),
    ack(mavlink.MAV_MISSION_ACCEPTED),
    mavlink.MAVLink_statustext_message(6, b"MLP 1 collect 3 ok"),
]
FRAMES = [bytes(message.pack(PACKER)) for message in MESSAGES]


def reader() -> FrameReader:
    return FrameReader(mavlink.MAVLink(None))


def kinds(messages: list[Any]) -> list[str]:
    return [message.get_type() for message in messages]


@UNHURRIED
@given(st.binary(max_size=300))
def test_any_bytes_are_survived(data: bytes) -> None:
    found = reader()
    found.feed(data)
    assert found.malformed <= 1


# Without the markers in it, garbage can neither hide a frame nor be one.
GARBAGE = st.binary(max_size=40).map(lambda data: data.replace(b"\xfd", b"").replace(b"\xfe", b""))


@UNHURRIED
@given(st.lists(st.tuples(GARBAGE, st.sampled_from(range(len(FRAMES)))), max_size=6), GARBAGE)
def test_good_frames_between_garbage_are_found(parts: list[tuple[bytes, int]], tail: bytes) -> None:
    found = reader()
    data = b"".join(garbage + FRAMES[index] for garbage, index in parts) + tail
    assert kinds(found.feed(data)) == [MESSAGES[index].get_type() for _, index in parts]
    assert found.malformed == (tail != b"" or any(garbage for garbage, _ in parts))


def test_a_false_start_hides_no_frame() -> None:
    found = reader()
    for false_start in (b"\xfd\xff", b"\xfe\xff\x00", FRAMES[0][:-1], b"\xfd\x01\xff\x00"):
        assert kinds(found.feed(false_start + FRAMES[1])) == ["MISSION_ACK"]
    assert found.malformed == 4


def test_every_broken_bit_is_noticed() -> None:
    for frame in FRAMES:
        for position in range(len(frame) * 8):
            broken = bytearray(frame)
            broken[position // 8] ^= 1 << position % 8
            found = reader()
            assert found.feed(bytes(broken)) == []
            assert found.malformed + found.unknown >= 1


def test_an_unknown_message_is_passed_over() -> None:
    found = reader()
    frame = b"\xfd\x01\x00\x00\x00\x07\x01\xff\xff\x7f\x00\x12\x34"
    assert kinds(found.feed(frame + FRAMES[0])) == ["HEARTBEAT"]
    assert (found.unknown, found.malformed) == (1, 0)


@pytest.mark.parametrize(
    "url",
    ["", "tcp:127.0.0.1:1", "udpout:127.0.0.1", "udpout::5", "udpout:h:0", "udpout:h:99999", "udpout:h:x"],
)
def test_a_bad_url_is_one_clear_line(url: str) -> None:
    with pytest.raises(LinkError, match="expected udpout:HOST:PORT"):
        asyncio.run(MavConnection.open(url, lambda message: None))


class Peer(asyncio.DatagramProtocol):
    def __init__(self) -> None:
        self.queue: asyncio.Queue[tuple[bytes, Any]] = asyncio.Queue()

    def datagram_received(self, data: bytes, addr: Any) -> None:
        self.queue.put_nowait((data, addr))


def test_both_ways_over_udp_with_fuzz_and_a_handler_that_fails() -> None:
    async def talk() -> None:
        loop = asyncio.get_running_loop()
        transport, peer = await loop.create_datagram_endpoint(Peer, local_addr=("127.0.0.1", 0))
        heard: asyncio.Queue[Any] = asyncio.Queue()

        def on_message(message: Any) -> None:
            if message.get_type() == "HEARTBEAT":
                raise RuntimeError("a fault in a handler")
            heard.put_nowait(message)

        port = transport.get_extra_info("sockname")[1]
        connection = await MavConnection.open(f"udpout:127.0.0.1:{port}", on_message)
        for _ in range(2):
            connection.send(MESSAGES[0])
        data, address = await peer.queue.get()
        first = mavlink.MAVLink(None).decode(bytearray(data))
        second = mavlink.MAVLink(None).decode(bytearray((await peer.queue.get())[0]))
        assert (first.get_srcSystem(), first.get_srcComponent(), first.get_seq()) == (255, 190, 0)
        assert second.get_seq() == 1

        noise = random.Random(5)
        for _ in range(200):
            transport.sendto(noise.randbytes(noise.randrange(1, 120)), address)
            await asyncio.sleep(0)  # so that the receiving socket does not overflow
        transport.sendto(FRAMES[0], address)
        transport.sendto(FRAMES[2], address)
        assert (await heard.get()).text == "MLP 1 collect 3 ok"
        assert connection.faults == 1
        assert connection.reader.malformed == 200
        connection.close()
        connection.send(MESSAGES[0])
        transport.close()
        await asyncio.sleep(0)

    asyncio.run(asyncio.wait_for(talk(), 10.0))


def test_nobody_there_is_no_fault() -> None:
    async def talk() -> None:
        connection = await MavConnection.open("udpout:127.0.0.1:9", lambda message: None)
        for _ in range(3):
            connection.send(MESSAGES[0])
            await asyncio.sleep(0)
        connection.close()
        await asyncio.sleep(0)

    asyncio.run(talk())
