"""Malformed and hostile bytes on the link, beside an agent and its vehicle at work, both ways and seeded."""

from __future__ import annotations

import random
from collections.abc import Callable
from typing import Any

import pytest
from agent_cases import ROUND, WHERE, WORK_DONE, Yard, fly
from link_cases import SYSTEM
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from wire_cases import MemoryWires

from malipp_field.bus.messages import Event, Load, Start, Telemetry
from malipp_field.link import Channel, Links, SigningKey, VehicleLink
from malipp_field.link.channels import OnEvent, OnMessage
from malipp_field.link.compare import differences
from malipp_field.link.wires import Address
from malipp_field.mission.link_url import parse_link_url
from malipp_field.sim.fleet import parse
from malipp_field.sim.signing import RadioSigning, ticks
from malipp_field.vehicle.layout import lay_out

SECRET = bytes(range(32))
OTHER = bytes(range(1, 33))
START_S = 1.7e9
HERE, THERE = ("10.0.0.7", 7), ("10.0.0.66", 66)
HARMLESS = {"HEARTBEAT", "COMMAND_LONG 511"}
"""What an agent says that nobody has given an order to."""


class AttackedYard(Yard):
    """A yard whose messages are bytes, on a wire that somebody else can speak on, too.

    Parameters
    ----------
    signed
        The vehicle and the ground share a key.
    """

    def __init__(self, seed: int, *, signed: bool, url: str = "udpin:0.0.0.0:14550") -> None:
        super().__init__(seed, start_s=START_S)
        self._opener = MemoryWires(self.clock)
        self.links = Links(self.clock, self._opener.open)
        key = SigningKey(SECRET) if signed else None
        self._address = VehicleLink(parse_link_url(url), SYSTEM, key=key)
        self.radio = RadioSigning(SECRET if signed else None, ticks(START_S))
        self._packer = mavlink.MAVLink(None, srcSystem=SYSTEM, srcComponent=1)
        self._carried = self.frames = 0
        self.overheard: list[tuple[bool, bytes]] = []
        self.said: list[str] = []
        self.attack: Callable[[AttackedYard], None] = lambda yard: None

    async def open(
        self, where: VehicleLink, on_message: OnMessage, on_event: OnEvent, skip: frozenset[int]
    ) -> Any:
        assert where == WHERE
        self.channel = await self.links.open(self._address, on_message, on_event, skip)
        self.link = self.links._links[self._address.url]
        honest = self.link.reader.feed

        def feed(data: bytes) -> Any:
            frames = honest(data)
            self.frames += len(frames)
            return frames

        self.link.reader.feed = feed  # type: ignore[method-assign]
        return self.channel

    def _carry(self, now_s: float) -> None:
        if not self._opener.wires:
            return  # the agent has not begun
        self.attack(self)
        wire = self._opener.last
        for data, to in wire.written[self._carried :]:
            assert to != THERE
            self.overheard.append((True, data))
            self.to_vehicle(data)
        self._carried = len(wire.written)
        self.rover.step(now_s)
        outbox, self.rover.outbox = self.rover.outbox, []
        for _, message in outbox:
            self.radio.prepare(self._packer)
            data = bytes(message.pack(self._packer))
            self._packer.seq = (self._packer.seq + 1) % 256
            self.overheard.append((False, data))
            wire.ends.received(data, self._from(HERE))

    def to_vehicle(self, data: bytes) -> None:
        for message in parse(data):
            if self.radio.accepts(message):
                self._note(message)
                self.rover.receive(message, "ground", self.clock.now_s())

    def _note(self, message: Any) -> None:
        kind = message.get_type()
        self.said.append(f"{kind} {message.command}" if kind == "COMMAND_LONG" else kind)

    def to_ground(self, data: bytes) -> None:
        self._opener.last.ends.received(data, self._from(THERE))

    def _from(self, address: Address) -> Address | None:
        return address if self._address.url.scheme == "udpin" else None

    def counted(self) -> int:
        channel: Channel = self.channel
        return (
            self.link.strangers + channel.heard + channel.skipped + channel.undecodable
            + channel.refused.total()
        )  # fmt: skip


def packed(message: Any, system: int, component: int, secret: bytes | None = None, stamp: int = 0) -> bytes:
    packer = mavlink.MAVLink(None, srcSystem=system, srcComponent=component)
    packer.signing.secret_key, packer.signing.sign_outgoing = secret, secret is not None
    packer.signing.timestamp = stamp
    return bytes(message.pack(packer))


def lies(yard: AttackedYard) -> list[Any]:
    """Messages that would change a mission, start one, or confirm work, were they believed."""
    noise, ground = yard.noise, (255, 190)
    seq = noise.randrange(0, 12)
    return [
        mavlink.MAVLink_statustext_message(6, f"MLP {noise.randrange(1, 9)} collect {seq} ok".encode()),
        mavlink.MAVLink_statustext_message(6, f"MLP {noise.randrange(10**9)} unload {seq} missing".encode()),
        mavlink.MAVLink_mission_ack_message(*ground, noise.randrange(0, 16)),
        mavlink.MAVLink_mission_count_message(*ground, noise.randrange(0, 2**16)),
        mavlink.MAVLink_mission_request_message(*ground, seq),
        mavlink.MAVLink_mission_request_int_message(*ground, noise.randrange(2**16)),
        mavlink.MAVLink_mission_current_message(seq, 9, noise.randrange(6)),
        mavlink.MAVLink_mission_item_reached_message(seq),
        mavlink.MAVLink_command_ack_message(noise.choice((176, 224, 400)), noise.randrange(6), 0, 0, *ground),
        mavlink.MAVLink_heartbeat_message(10, 3, 217, noise.choice((4, 10)), 4, 3),
        mavlink.MAVLink_named_value_float_message(1, b"MLP_WH", 1e9),
        mavlink.MAVLink_global_position_int_message(1, 1, 1, 1, 1, 1, 1, 1, 1),
        mavlink.MAVLink_param_value_message(b"FS_ACTION", 0.0, 9, 1, 1),
    ]


def orders(yard: AttackedYard) -> list[Any]:
    """Messages that a vehicle would obey."""
    vehicle = (SYSTEM, 1)
    return [
        mavlink.MAVLink_mission_clear_all_message(*vehicle),
        mavlink.MAVLink_mission_count_message(*vehicle, 3),
        mavlink.MAVLink_mission_set_current_message(*vehicle, 2),
        mavlink.MAVLink_command_long_message(*vehicle, 400, 0, 1, 0, 0, 0, 0, 0, 0),
        mavlink.MAVLink_command_long_message(*vehicle, 176, 0, 1, 10, 0, 0, 0, 0, 0),
        mavlink.MAVLink_command_long_message(*vehicle, 176, 0, 1, 4, 0, 0, 0, 0, 0),
        mavlink.MAVLink_setup_signing_message(*vehicle, [1] * 32, 2**47),
        mavlink.MAVLink_named_value_int_message(0, b"MLP_ACK", 10**6),
    ]


def mangled(yard: AttackedYard) -> bytes:
    """Return bytes that are no frame of anybody: random, cut short, with bits changed, or far too long."""
    noise = yard.noise
    heard = noise.choice([data for _, data in yard.overheard[-50:]] or [b"\xfd"])
    match noise.randrange(5):
        case 0:
            return noise.randbytes(noise.randrange(1, 300))
        case 1:
            return heard[: noise.randrange(len(heard))]
        case 2:
            broken = bytearray(heard)
            for at in noise.sample(range(len(broken)), min(len(broken), noise.randrange(1, 4))):
                broken[at] ^= 1 << noise.randrange(8)
            return bytes(broken)
        case 3:  # more payload than the message has, with a checksum that is right
            body = bytes((255, 0, 0, 0, noise.randrange(1, 7), 1, 47, 0, 0)) + noise.randbytes(255)
            crc = mavlink.x25crc(body + bytes((mavlink.mavlink_map[47].crc_extra,))).crc
            return b"\xfd" + body + int(crc).to_bytes(2, "little")
        case _:
            return noise.randbytes(2000) + b"\xfd" * 500


def strangers(yard: AttackedYard) -> None:
    """Lies of other systems and of other components, and mangled frames."""
    noise = yard.noise
    for _ in range(noise.randrange(1, 5)):
        sender = noise.choice([(SYSTEM, 99), (SYSTEM, 190), (8, 1), (0, 0), (255, 190), (1, SYSTEM)])
        yard.to_ground(packed(noise.choice(lies(yard)), *sender))
        yard.to_ground(mangled(yard))


def impostors(yard: AttackedYard) -> None:
    """Who says to be the vehicle, or the ground, without the key: unsigned, forged, replayed."""
    strangers(yard)
    noise, now = yard.noise, ticks(yard.clock.now_s())
    stamp = noise.choice((0, now - 10**8, now, now + 10**3, 2**48 - 1))
    secret = noise.choice((None, OTHER, bytes(32)))
    yard.to_ground(packed(noise.choice(lies(yard)), SYSTEM, 1, secret, stamp))
    yard.to_vehicle(packed(noise.choice(orders(yard)), 255, 190, secret, stamp))
    yard.to_vehicle(mangled(yard))
    if yard.overheard:
        to_vehicle, data = noise.choice(yard.overheard[-400:])
        (yard.to_vehicle if to_vehicle else yard.to_ground)(data)
    # The signature of one message under another.
    for to_vehicle, data in yard.overheard[-1:]:
        message = noise.choice(orders(yard) if to_vehicle else lies(yard))
        swapped = packed(message, *((255, 190) if to_vehicle else (SYSTEM, 1)), SECRET, 0)[:-13] + data[-13:]
        (yard.to_vehicle if to_vehicle else yard.to_ground)(swapped)


CASES = [(False, strangers, "tcp:radio:5760"), (False, strangers, "udpin:0.0.0.0:14550"),
         (True, impostors, "udpin:0.0.0.0:14550"), (True, impostors, "serial:/dev/radio:57600")]  # fmt: skip


def quiet(yard: AttackedYard) -> None:
    assert yard.channel.faults == 0
    assert yard.frames == yard.counted()
    events = [e.text for e in yard.bus.of(Event) if e.severity != "info"]
    assert all(text.startswith("link: not believed: ") for text in events), events


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(("signed", "attack", "url"), CASES)
def test_an_idle_vehicle_stays_idle(
    seed: int, signed: bool, attack: Callable[[AttackedYard], None], url: str
) -> None:
    async def scene(_: Yard) -> None:
        yard.attack = attack
        await yard.live(40.0)
        quiet(yard)
        assert yard.confirmed == []
        assert not yard.rover.autopilot.armed
        assert yard.rover.autopilot.store.items == []
        assert set(yard.said) == HARMLESS
        assert yard.link.reader.malformed > 100
        assert yard.link.strangers > 100
        last = yard.bus.of(Telemetry)[-1]
        assert (last.link_ok, last.mission_version, last.armed) == (True, None, False)
        assert not (await yard.order(Start())).ok

    yard = AttackedYard(seed, signed=signed, url=url)
    yard.run(scene)


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize(("signed", "attack", "url"), CASES)
def test_a_mission_is_loaded_driven_and_confirmed_all_the_same(
    seed: int, signed: bool, attack: Callable[[AttackedYard], None], url: str
) -> None:
    async def scene(_: Yard) -> None:
        yard.attack = attack
        mission = yard.mission(*ROUND)
        assert (await yard.order(Load(mission=mission))).ok
        assert differences(lay_out(mission).items, yard.rover.autopilot.store.items) == []
        assert (await yard.order(Start())).ok
        await yard.until(lambda: yard.telemetry.finished)
        quiet(yard)
        assert yard.confirmed == [(n, uid, True) for n, uid in enumerate(WORK_DONE, start=1)]
        assert differences(lay_out(mission).items, yard.rover.autopilot.store.items) == []
        if signed:
            assert set(yard.channel.refused) == {"unsigned", "forged", "replayed"}
            assert yard.radio.refused > 100

    yard = AttackedYard(seed, signed=signed, url=url)
    yard.run(scene)


def test_what_is_replayed_after_a_minute_or_to_another_ground_is_stale() -> None:
    async def scene(_: Yard) -> None:
        await fly(yard, *ROUND)
        recorded = [data for to_vehicle, data in yard.overheard if not to_vehicle]
        await yard.live(70.0)
        yard.channel.refused.clear()
        stranger = SigningKey(SECRET)  # the same key, with no memory of what was heard
        yard.channel.where = VehicleLink(yard.channel.where.url, SYSTEM, key=stranger)
        before = len(yard.confirmed)
        for data in recorded:
            yard.to_ground(data)
        assert dict(yard.channel.refused) == {"stale": len(recorded)}
        assert len(yard.confirmed) == before

    yard = AttackedYard(0, signed=True)
    yard.run(scene)


def test_whoever_knows_no_key_finds_none_in_what_is_said_or_kept(caplog: pytest.LogCaptureFixture) -> None:
    async def scene(_: Yard) -> None:
        yard.attack = impostors
        await fly(yard, *ROUND)
        await yard.live(20.0)
        kept = b"".join(data for _, data in yard.overheard)
        assert SECRET not in kept
        words = caplog.text + repr(yard.agent.__dict__) + repr(yard.channel.__dict__)
        words += "".join(message.model_dump_json() for _, message in yard.bus.said)
        assert SECRET.hex() not in words
        assert repr(SECRET)[2:20] not in words
        assert repr(list(SECRET))[1:20] not in words

    yard = AttackedYard(1, signed=True)
    yard.run(scene)


def test_the_attacks_would_do_harm_were_there_no_key() -> None:
    """The tests above would mean nothing if nobody could obey these orders."""
    yard = AttackedYard(0, signed=False)
    noise = random.Random(0)

    async def scene(_: Yard) -> None:
        for _number in range(100):
            yard.to_vehicle(packed(noise.choice(orders(yard)), 255, 190))
            await yard.live(0.1)
        assert set(yard.said) > HARMLESS

    yard.run(scene)
