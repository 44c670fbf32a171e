from __future__ import annotations

import random
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from link_cases import SYSTEM, UNHURRIED, ack
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from malipp_field.link.frames import Frame, FrameReader, StreamReader, decoded

PACKER = mavlink.MAVLink(None, srcSystem=SYSTEM, srcComponent=1)
MESSAGES = [
    mavlink.MAVLink_heartbeat_message(10, 3, 0, 4, 3, 3),
    ack(mavlink.MAV_MISSION_ACCEPTED),
    mavlink.MAVLink_statustext_message(6, b"MLP 1 collect 3 ok"),
]
FRAMES = [bytes(message.pack(PACKER)) for message in MESSAGES]
OLD = bytes(MESSAGES[0].pack(PACKER, force_mavlink1=True))
UNKNOWN = b"\xfd\x01\x00\x00\x00\x07\x01\xff\xff\x7f\x00\x12\x34"
READERS = [FrameReader, StreamReader]


def kinds(frames: list[Frame]) -> list[str]:
    messages: list[Any] = [decoded(frame) for frame in frames]
    return [message.get_type() for message in messages]


@UNHURRIED
@given(st.lists(st.binary(max_size=300), max_size=8), st.sampled_from(READERS))
def test_any_bytes_are_survived(pieces: list[bytes], reader: type[FrameReader]) -> None:
    found = reader()
    for piece in pieces:
        for frame in found.feed(piece):
            decoded(frame)


# Without the markers in it, garbage can neither hide a frame nor be one.
GARBAGE = st.binary(max_size=40).map(lambda data: data.replace(b"\xfd", b"").replace(b"\xfe", b""))


@UNHURRIED
@given(st.lists(st.tuples(GARBAGE, st.sampled_from(range(len(FRAMES)))), max_size=6), GARBAGE)
def test_good_frames_between_garbage_are_found(parts: list[tuple[bytes, int]], tail: bytes) -> None:
    data = b"".join(garbage + FRAMES[index] for garbage, index in parts) + tail
    for reader in (FrameReader(), StreamReader()):
        assert kinds(reader.feed(data)) == [MESSAGES[index].get_type() for _, index in parts]
        assert reader.malformed == (tail != b"") + sum(garbage != b"" for garbage, _ in parts)


@UNHURRIED
@given(st.lists(st.sampled_from(FRAMES), max_size=6), st.lists(st.integers(1, 30), min_size=1))
def test_a_stream_may_be_cut_anywhere(frames: list[bytes], lengths: list[int]) -> None:
    data, reader, found = b"".join(frames), StreamReader(), []
    while data:
        length, lengths = lengths[0], lengths[1:] + lengths[:1]
        found += reader.feed(data[:length])
        data = data[length:]
    assert [frame.data for frame in found] == frames
    assert reader.malformed == 0


@pytest.mark.parametrize("false_start", [b"\xfd\xff", b"\xfe\xff\x00", FRAMES[0][:-1], b"\xfd\x01\xff\x00"])
def test_a_false_start_in_a_datagram_hides_no_frame(false_start: bytes) -> None:
    found = FrameReader()
    assert kinds(found.feed(false_start + FRAMES[1])) == ["MISSION_ACK"]
    assert found.malformed == 1
    assert kinds(found.feed(FRAMES[1])) == ["MISSION_ACK"]


@pytest.mark.parametrize("seed", range(20))
def test_a_stream_that_lost_bytes_is_found_into_again(seed: int) -> None:
    """Whatever bytes come between, frames are found again before three more of the longest have gone by."""
    noise = random.Random(seed)
    reader = StreamReader()
    reader.feed(FRAMES[0])
    reader.feed(noise.randbytes(noise.randrange(1, 400)))
    after = sum(len(reader.feed(FRAMES[2])) for _ in range(60))
    assert after >= 60 - 3 * 280 // len(FRAMES[2]) - 1


def test_a_broken_wire_ends_what_it_began() -> None:
    reader = StreamReader()
    assert reader.feed(FRAMES[0][:5]) == []
    reader.break_off()
    assert kinds(reader.feed(FRAMES[1])) == ["MISSION_ACK"]
    assert reader.malformed == 0


def test_every_broken_bit_is_noticed() -> None:
    for whole in (*FRAMES, OLD):
        for position in range(len(whole) * 8):
            broken = bytearray(whole)
            broken[position // 8] ^= 1 << position % 8
            found = FrameReader()
            assert found.feed(bytes(broken)) == []
            assert found.malformed + found.unknown >= 1


def test_an_unknown_message_is_passed_over_unless_it_stands_in_garbage() -> None:
    for found in (FrameReader(), StreamReader()):
        assert kinds(found.feed(UNKNOWN + FRAMES[0])) == ["HEARTBEAT"]
        assert (found.unknown, found.malformed) == (1, 0)
        assert kinds(found.feed(b"\x00" + UNKNOWN + FRAMES[0])) == ["HEARTBEAT"]
        assert (found.unknown, found.malformed) == (1, 1)


def test_headers_are_read_without_decoding() -> None:
    first, old = FrameReader().feed(FRAMES[2] + OLD)
    assert (first.message_id, first.system, first.component, first.signed) == (253, SYSTEM, 1, False)
    assert (old.message_id, old.system, old.component, old.signed) == (0, SYSTEM, 1, False)


KINDS = [
    (kind, old) for kind in mavlink.mavlink_map.values() for old in (False, True) if not old or kind.id < 256
]


def test_decoding_agrees_with_pymavlink() -> None:
    """Whatever the fields hold, trailing zeros left out or not, and fields of a later version behind them."""
    rng = random.Random(1)
    for kind, version_1 in KINDS:
        for length in (kind.unpacker.size, kind.unpacker.size // 2, min(255, kind.unpacker.size + 3)):
            data = framed(kind, rng.randbytes(max(1, length)), version_1)
            (frame,) = FrameReader().feed(data)
            ours, theirs = decoded(frame), mavlink.MAVLink(None).decode(bytearray(data))
            assert ours is not None
            assert (str(ours), ours.get_srcSystem(), ours.get_srcComponent(), ours.get_seq()) == (
                str(theirs), theirs.get_srcSystem(), theirs.get_srcComponent(), theirs.get_seq(),
            )  # fmt: skip


def framed(kind: Any, payload: bytes, version_1: bool) -> bytes:
    body = (
        bytes((len(payload), 9, SYSTEM, 1, kind.id))
        if version_1
        else bytes((len(payload), 0, 0, 9, SYSTEM, 1)) + kind.id.to_bytes(3, "little")
    ) + payload
    checksum = mavlink.x25crc(body + bytes((kind.crc_extra,))).crc
    return b"%c%b%b" % (0xFE if version_1 else 0xFD, body, checksum.to_bytes(2, "little"))
