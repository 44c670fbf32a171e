"""Signatures: ours against pymavlink's and the simulated vehicle's, and every way of not having the key."""

from __future__ import annotations

import copy
import pickle
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from malipp_field.link.frames import Frame, FrameReader
from malipp_field.link.signing import LINK_ID, MAX_AGE_TICKS, SigningKey, Stamps, ticks
from malipp_field.sim.fleet import parse
from malipp_field.sim.signing import RadioSigning

SECRET = bytes(range(32))
NOW_S = 1_700_000_000.0
NOW = ticks(NOW_S)
HEARTBEAT = mavlink.MAVLink_heartbeat_message(10, 3, 0, 4, 3, 3)
RADIO = mavlink.MAVLink_radio_status_message(1, 2, 3, 4, 5, 6, 7)


def packer(system: int = 7, secret: bytes | None = SECRET, stamp: int = NOW, link_id: int = 1) -> Any:
    made = mavlink.MAVLink(None, srcSystem=system, srcComponent=1)
    made.signing.secret_key, made.signing.sign_outgoing = secret, secret is not None
    made.signing.timestamp, made.signing.link_id = stamp, link_id
    return made


def frame_of(data: bytes) -> Frame:
    (frame,) = FrameReader().feed(data)
    return frame


def vehicle_says(message: Any = HEARTBEAT, **how: Any) -> Frame:
    return frame_of(bytes(message.pack(packer(**how))))


def test_what_pymavlink_and_the_simulated_vehicle_sign_is_believed() -> None:
    key = SigningKey(SECRET)
    assert key.refusal(vehicle_says(), NOW_S) is None
    radio, theirs = RadioSigning(SECRET, NOW + 100), mavlink.MAVLink(None, srcSystem=8, srcComponent=1)
    radio.prepare(theirs)
    assert key.refusal(frame_of(bytes(HEARTBEAT.pack(theirs))), NOW_S) is None


def test_what_we_sign_is_believed_by_pymavlink_and_by_the_simulated_vehicle() -> None:
    key, ours = SigningKey(SECRET), mavlink.MAVLink(None, srcSystem=255, srcComponent=190)
    reference, radio = mavlink.MAVLink(None), RadioSigning(SECRET, NOW)
    reference.signing.secret_key = SECRET
    for _ in range(3):  # within one tick of the clock
        data = key.pack(HEARTBEAT, ours, NOW_S)
        assert reference.decode(bytearray(data)).get_signed()
        (message,) = parse(data)
        assert radio.accepts(message)
        assert not radio.accepts(message)
    assert radio.timestamp == NOW + 2
    assert frame_of(data).data[-13] == LINK_ID


@pytest.mark.parametrize("where", ["first byte of the payload", "signature", "timestamp", "link id"])
def test_one_bit_changed_is_a_forgery(where: str) -> None:
    data = bytearray(vehicle_says().data)
    at = {"first byte of the payload": 10, "signature": -1, "timestamp": -12, "link id": -13}[where]
    data[at] ^= 1
    if at == 10:  # with a checksum that is right
        extra = mavlink.mavlink_map[0].crc_extra
        data[-15:-13] = mavlink.x25crc(bytes(data[1:-15]) + bytes((extra,))).crc.to_bytes(2, "little")
    key = SigningKey(SECRET)
    assert key.refusal(frame_of(bytes(data)), NOW_S) == "forged"


def test_every_other_way_in_is_refused_by_its_reason() -> None:
    key = SigningKey(SECRET)
    assert key.refusal(vehicle_says(secret=None), NOW_S) == "unsigned"
    old = frame_of(bytes(HEARTBEAT.pack(packer(secret=None), force_mavlink1=True)))
    assert key.refusal(old, NOW_S) == "unsigned"
    assert key.refusal(vehicle_says(secret=bytes(31) + b"x"), NOW_S) == "forged"
    first = vehicle_says(stamp=NOW + 5)
    assert key.refusal(first, NOW_S) is None
    assert key.refusal(first, NOW_S) == "replayed"
    assert key.refusal(vehicle_says(stamp=NOW + 4), NOW_S) == "replayed"
    assert key.refusal(vehicle_says(stamp=NOW + 4, link_id=2), NOW_S) is None  # another stream
    assert key.refusal(vehicle_says(stamp=NOW + 5 - MAX_AGE_TICKS - 1, link_id=3), NOW_S) == "stale"
    assert key.refusal(vehicle_says(stamp=NOW + 5 - MAX_AGE_TICKS, link_id=3), NOW_S) is None
    assert key.refusal(vehicle_says(stamp=NOW + 9), NOW_S + 60.1) == "stale"  # held back for a minute


def test_a_forgery_does_not_shut_its_victim_out() -> None:
    """The timestamp of a frame that is not signed rightly is not believed either."""
    key = SigningKey(SECRET)
    assert key.refusal(vehicle_says(secret=bytes(32), stamp=2**48 - 1), NOW_S) == "forged"
    assert key.refusal(vehicle_says(), NOW_S) is None


def test_a_radio_reports_on_itself_unsigned() -> None:
    key, radio = SigningKey(SECRET), RadioSigning(SECRET, NOW)
    data = bytes(RADIO.pack(packer(system=51, secret=None)))
    assert key.refusal(frame_of(data), NOW_S) is None
    assert radio.accepts(parse(data)[0])
    assert radio.refused == 0


def test_timestamps_only_rise_and_follow_what_is_heard() -> None:
    stamps = Stamps()
    assert [stamps.next(NOW_S), stamps.next(NOW_S), stamps.next(NOW_S - 100.0)] == [NOW, NOW + 1, NOW + 2]
    assert stamps.next(NOW_S + 1.0) == NOW + 100_000
    assert stamps.refusal((7, 1, 0), NOW + 500_000, NOW_S) is None
    assert stamps.next(NOW_S) == NOW + 500_001
    assert ticks(0.0) == 0


def test_nothing_shows_a_key() -> None:
    key = SigningKey(SECRET)
    for text in (repr(key), str(key), f"{[key]}", repr(RadioSigning(SECRET, 0))):
        assert SECRET.hex() not in text
        assert "1, 2, 3" not in text
        assert "\\x01\\x02" not in text
    for write_down in (pickle.dumps, copy.deepcopy):
        with pytest.raises(TypeError, match="not written down"):
            write_down(key)
    with pytest.raises(ValueError, match="has 32 bytes, found 31"):
        SigningKey(SECRET[:31])


def test_the_simulated_vehicle_keeps_to_the_rules_of_the_c_library() -> None:
    radio = RadioSigning(SECRET, NOW)

    def accepted(**how: Any) -> bool:
        return radio.accepts(parse(bytes(HEARTBEAT.pack(packer(**how))))[0])

    assert not accepted(secret=None)
    assert not accepted(secret=bytes(32), stamp=2**47)
    assert not accepted(stamp=NOW - MAX_AGE_TICKS - 1)
    assert accepted(stamp=NOW - MAX_AGE_TICKS)
    assert not accepted(stamp=NOW - MAX_AGE_TICKS)
    assert accepted(stamp=NOW + 5)
    assert radio.timestamp == NOW + 5
    assert [accepted(link_id=link_id, stamp=NOW) for link_id in range(2, 20)] == [True] * 15 + [False] * 3
    assert RadioSigning(None, 0).accepts(parse(bytes(HEARTBEAT.pack(packer(secret=None))))[0])


def test_a_key_given_by_setup_signing_is_taken_on_and_zeros_end_it() -> None:
    radio, key = RadioSigning(None, NOW), SigningKey(SECRET)
    radio.set_up(key.setup(7, 1, NOW_S + 1.0))
    assert radio.timestamp == NOW + 100_000
    data = key.pack(HEARTBEAT, mavlink.MAVLink(None, srcSystem=255, srcComponent=190), NOW_S)
    assert radio.accepts(parse(data)[0])
    radio.set_up(mavlink.MAVLink_setup_signing_message(7, 1, [0] * 32, 0))
    assert radio.accepts(parse(bytes(HEARTBEAT.pack(packer(secret=None))))[0])
