"""Links on wires of memory and on a virtual clock: sharing, routing, mending, waiting, counting."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from itertools import pairwise
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from wire_cases import HEARTBEAT, START_S, Ground, said_by, signed_by

from malipp_field.errors import InputError, LinkError
from malipp_field.link import KeyRing, SigningKey, vehicle_link
from malipp_field.link.keys import make_key_file
from malipp_field.link.links import LAST_RETRY_S, Backoff
from malipp_field.link.outbox import MAX_WAITING
from malipp_field.link.signing import ticks
from malipp_field.mission import parse_mission
from malipp_field.mission.link_url import parse_link_url

SECRET = bytes(range(32))
NOW = ticks(START_S)


def run(scene: Callable[[Ground], Awaitable[None]], url: str = "tcp:radio:5760") -> None:
    async def whole() -> None:
        ground = Ground(url)
        async with ground.links:
            await scene(ground)
        assert all(wire.closed for wire in ground.opener.wires)

    asyncio.run(whole())


def count(number: int) -> mavlink.MAVLink_message:
    return mavlink.MAVLink_mission_count_message(7, 1, number)


def interval(message_id: int, interval_us: float = 1e6, confirmation: int = 0) -> mavlink.MAVLink_message:
    return mavlink.MAVLink_command_long_message(
        7, 1, 511, confirmation, message_id, interval_us, 0, 0, 0, 0, 0
    )


def test_vehicles_on_one_radio_share_its_wire_and_hear_each_its_own() -> None:
    async def scene(ground: Ground) -> None:
        first, second = await asyncio.gather(ground.channel(1), ground.channel(2))
        (wire,) = ground.opener.wires
        wire.ends.received(said_by(1) + said_by(2) + said_by(9) + said_by(2), None)
        assert ground.heard == [(1, "HEARTBEAT"), (2, "HEARTBEAT"), (2, "HEARTBEAT")]
        first.send(HEARTBEAT)
        second.send(count(3))
        assert [(m.get_type(), m.get_seq(), m.get_srcSystem()) for m in wire.messages] == [
            ("HEARTBEAT", 0, 255), ("MISSION_COUNT", 1, 255),
        ]  # fmt: skip
        first.close()
        wire.ends.received(said_by(1) + said_by(2), None)
        assert ground.heard[3:] == [(2, "HEARTBEAT")]
        assert not wire.closed
        second.close()
        assert wire.closed
        await ground.channel(1)
        ground.opener.last.ends.received(said_by(1), None)
        assert ground.heard[4:] == [(1, "HEARTBEAT")]

    run(scene)


def test_of_orders_that_wait_the_last_one_said_is_the_last_one_sent() -> None:
    """HOLD, AUTO, HOLD ends in HOLD, although the first and the last say the same."""

    async def scene(ground: Ground) -> None:
        channel = await ground.channel(7)
        wire = ground.opener.last
        wire.ready = False
        for mode in (4, 10, 4):
            channel.send(mavlink.MAVLink_command_long_message(7, 1, 176, 0, 1, mode, 0, 0, 0, 0, 0))
        wire.drain()
        assert [message.param2 for message in wire.messages] == [4, 10, 4]

    run(scene)


def test_heartbeats_of_our_system_id_reach_all_who_speak_as_that() -> None:
    """Whoever else feeds a vehicle's failsafe must be known to its agent; nothing else of strangers is."""

    async def scene(ground: Ground) -> None:
        await asyncio.gather(ground.channel(1), ground.channel(2))
        (wire,) = ground.opener.wires
        wire.ends.received(said_by(255) + said_by(255, count(3)) + said_by(254), None)
        assert sorted(ground.heard) == [(1, "HEARTBEAT"), (2, "HEARTBEAT")]

    run(scene)


def test_what_nobody_wants_is_not_decoded_and_a_handler_that_fails_ends_nothing() -> None:
    async def scene(ground: Ground) -> None:
        channel = await ground.channel(7, skip=frozenset({mavlink.MAVLINK_MSG_ID_VFR_HUD}))
        hud = mavlink.MAVLink_vfr_hud_message(1, 1, 0, 0, 0, 0)
        ground.opener.last.ends.received(said_by(7, hud) + said_by(7), None)
        assert (channel.skipped, channel.heard, ground.heard) == (1, 1, [(7, "HEARTBEAT")])

        def fails(message: object) -> None:
            raise RuntimeError("a fault in a handler")

        channel._on_message = fails
        ground.opener.last.ends.received(said_by(7) + said_by(7), None)
        assert channel.faults == 2

    run(scene)


def test_a_link_that_cannot_be_opened_is_one_clear_line_and_can_be_tried_again() -> None:
    async def scene(ground: Ground) -> None:
        ground.opener.failures = 1
        with pytest.raises(LinkError, match=r"^tcp:radio:5760: Connection refused$"):
            await ground.channel(7)
        await ground.channel(7)
        assert len(ground.opener.wires) == 1

    run(scene)


def test_a_link_that_breaks_is_mended_and_all_who_share_it_are_told() -> None:
    async def scene(ground: Ground) -> None:
        channel = await ground.channel(1)
        await ground.channel(2)
        wire = ground.opener.last
        wire.ready = False
        channel.send(count(3))  # waits, and is forgotten
        wire.ends.received(said_by(1)[:7], None)
        ground.opener.failures = 3
        wire.ends.lost("Input/output error")
        wire.ends.lost("again")
        channel.send(HEARTBEAT)
        assert ground.events == [
            f"error {system} link: tcp:radio:5760 is lost (Input/output error); trying again"
            for system in (1, 2)
        ]
        assert channel._link.unsent == 2  # type: ignore[attr-defined]
        await ground.live(8.0)
        assert ground.events[2:] == [
            "info 1 link: tcp:radio:5760 is back",
            "info 2 link: tcp:radio:5760 is back",
        ]
        ground.opener.last.ends.received(said_by(1), None)
        channel.send(HEARTBEAT)
        assert ground.heard == [(1, "HEARTBEAT")]
        assert [m.get_type() for m in ground.opener.last.messages] == ["HEARTBEAT"]

    run(scene)


def test_tries_come_ever_later_until_something_is_heard() -> None:
    async def scene(ground: Ground) -> None:
        await ground.channel(1)
        ground.opener.failures = 12
        ground.opener.last.ends.lost("gone")
        await ground.live(300.0)
        waits_s = [b - a for a, b in pairwise([START_S, *ground.opener.tries_s[1:]])]
        assert len(waits_s) == 13
        assert all(0.2 <= wait_s <= min(0.5 * 2**n, LAST_RETRY_S) + 0.1 for n, wait_s in enumerate(waits_s))
        assert all(wait_s >= LAST_RETRY_S / 2 for wait_s in waits_s[7:])
        # Accepted and thrown out again is no success.
        ground.opener.last.ends.lost("gone")
        before = len(ground.opener.tries_s)
        await ground.live(10.0)
        assert len(ground.opener.tries_s) == before
        await ground.live(25.0)
        ground.opener.last.ends.received(said_by(1), None)
        ground.opener.last.ends.lost("gone")
        await ground.live(1.0)
        assert len(ground.opener.tries_s) == before + 2

    run(scene)


def test_a_wire_that_breaks_while_it_is_opened_is_noticed() -> None:
    async def scene(ground: Ground) -> None:
        await ground.channel(1)
        honest = ground.opener.open

        async def breaks(url: object, ends: object) -> object:
            wire = await honest(url, ends)  # type: ignore[arg-type]
            if len(ground.opener.wires) == 2:
                wire.ends.lost("at once")
            return wire

        ground.links._links[ground.url]._open_wire = breaks  # type: ignore[assignment]
        ground.opener.last.ends.lost("gone")
        await ground.live(5.0)
        assert len(ground.opener.wires) == 3
        assert ground.opener.wires[1].closed
        assert ground.events[-1] == "info 1 link: tcp:radio:5760 is back"

    run(scene)


def test_waits_differ_by_chance_alone() -> None:
    waits = [Backoff(seed).next_s() for seed in range(50)]
    assert len(set(waits)) == 50
    assert 0.25 <= min(waits) < max(waits) <= 0.5
    assert Backoff(3).next_s() == waits[3]


def test_a_slow_wire_drops_old_heartbeats_and_requests_and_nothing_else() -> None:
    async def scene(ground: Ground) -> None:
        channel, other = await ground.channel(7), await ground.channel(8)
        wire = ground.opener.last
        channel.send(count(1))
        wire.ready = False
        for message in (
            HEARTBEAT, count(2), interval(33), HEARTBEAT, interval(33, 5e5), interval(42), count(2), count(4),
            HEARTBEAT,
        ):  # fmt: skip
            channel.send(message)
        other.send(HEARTBEAT)
        link = ground.links._links[ground.url]
        assert len(wire.written) == 1
        assert (len(link.outbox), link.outbox.superseded) == (6, 4)
        wire.drain()
        said = wire.messages
        assert [m.get_type() for m in said] == [
            "MISSION_COUNT", "HEARTBEAT", "MISSION_COUNT", "COMMAND_LONG", "COMMAND_LONG", "MISSION_COUNT",
            "HEARTBEAT",
        ]  # fmt: skip
        assert [m.count for m in said if m.get_type() == "MISSION_COUNT"] == [1, 2, 4]
        assert [(m.param1, m.param2) for m in said if m.get_type() == "COMMAND_LONG"] == [
            (33, 5e5),
            (42, 1e6),
        ]
        assert [m.get_seq() for m in said] == list(range(7))

    run(scene)


def test_a_heartbeat_does_not_wait_for_long() -> None:
    """Who has stopped them relies on it that none is sent any more."""

    async def scene(ground: Ground) -> None:
        channel = await ground.channel(7)
        wire = ground.opener.last
        wire.ready = False
        channel.send(HEARTBEAT)
        channel.send(count(2))
        await ground.live(1.2)
        wire.drain()
        assert [m.get_type() for m in wire.messages] == ["MISSION_COUNT"]
        assert ground.links._links[ground.url].outbox.superseded == 1

    run(scene)


def test_heartbeats_of_ground_stations_with_our_system_id_are_overheard() -> None:
    async def scene(ground: Ground) -> None:
        await ground.channel(1)
        await ground.channel(2)
        rival = said_by(255, component=1) + said_by(254, component=1) + said_by(255, count(3))
        ground.opener.last.ends.received(rival, None)
        assert ground.heard == [(1, "HEARTBEAT"), (2, "HEARTBEAT")]
        assert ground.links._links[ground.url].strangers == 2

    run(scene)


def test_a_wire_that_takes_nothing_any_more_is_opened_anew() -> None:
    async def scene(ground: Ground) -> None:
        channel = await ground.channel(7)
        ground.opener.last.ready = False
        for number in range(MAX_WAITING):
            assert not ground.events
            channel.send(count(number))
        assert ground.events == [
            "error 7 link: tcp:radio:5760 is lost (it takes nothing any more); trying again"
        ]
        await ground.live(1.0)
        channel.send(HEARTBEAT)
        assert [m.get_type() for m in ground.opener.last.messages] == ["HEARTBEAT"]

    run(scene)


def test_a_listening_link_answers_where_a_vehicle_was_last_heard() -> None:
    async def scene(ground: Ground) -> None:
        channel, _ = await ground.channel(1), await ground.channel(2)
        wire = ground.opener.last
        channel.send(HEARTBEAT)
        assert not wire.written
        for address in (("10.0.0.1", 5), ("10.0.0.2", 6)):
            wire.ends.received(said_by(1), address)
            wire.ends.received(said_by(2) + said_by(9), ("10.0.0.9", 9))
            wire.ends.received(said_by(1)[:-1], ("10.0.0.9", 9))
            channel.send(HEARTBEAT)
            assert wire.written[-1][1] == address

    run(scene, "udpin:0.0.0.0:14550")


def test_with_a_key_only_the_vehicle_itself_says_where_it_is() -> None:
    async def scene(ground: Ground) -> None:
        channel = await ground.channel(7, SigningKey(SECRET))
        wire, thief, home = ground.opener.last, ("10.0.0.66", 6), ("10.0.0.7", 7)
        radio = mavlink.MAVLink_radio_status_message(1, 2, 3, 4, 5, 6, 7)
        for data in (said_by(7), signed_by(bytes(32), NOW), said_by(7, radio)):
            wire.ends.received(data, thief)
        channel.send(HEARTBEAT)
        assert not wire.written
        # One that has no clock may be long behind; it catches up when it hears us.
        old = signed_by(SECRET, NOW - 10**9)
        wire.ends.received(old, home)
        channel.send(HEARTBEAT)
        wire.ends.received(signed_by(SECRET, NOW + 1), home)
        await ground.live(9.0)
        for data in (old, signed_by(SECRET, NOW + 1), said_by(7, radio)):
            wire.ends.received(data, thief)
        channel.send(HEARTBEAT)
        assert [to for _, to in wire.written] == [home, home]
        assert ground.heard == [(7, "RADIO_STATUS"), (7, "HEARTBEAT"), (7, "RADIO_STATUS")]
        assert dict(channel.refused) == {"unsigned": 1, "forged": 1, "stale": 1, "replayed": 2}
        assert ground.events[0] == "warning 7 link: not believed: 1 unsigned"
        await ground.live(2.0)
        wire.ends.received(said_by(7), thief)
        assert ground.events[1:] == [
            "warning 7 link: not believed: 1 forged, 2 replayed, 1 stale, 1 unsigned"
        ]

    run(scene, "udpin:0.0.0.0:14550")


def test_each_vehicle_on_a_radio_has_its_own_key() -> None:
    async def scene(ground: Ground) -> None:
        other = bytes(range(32, 64))
        first, second = (
            await ground.channel(1, SigningKey(SECRET)),
            await ground.channel(2, SigningKey(other)),
        )
        third, wire = await ground.channel(3), ground.opener.last
        wire.ends.received(
            signed_by(SECRET, NOW, 1) + signed_by(SECRET, NOW, 2) + signed_by(other, NOW, 3), None
        )
        assert ground.heard == [(1, "HEARTBEAT"), (3, "HEARTBEAT")]
        for channel in (first, second, third):
            channel.send(HEARTBEAT)
        for (data, _), secret in zip(wire.written, (SECRET, other, None), strict=True):
            judge = mavlink.MAVLink(None)
            judge.signing.secret_key = secret
            assert judge.decode(bytearray(data)).get_signed() == (secret is not None)

    run(scene)


def test_what_the_radio_says_of_itself_is_for_all_who_share_it() -> None:
    async def scene(ground: Ground) -> None:
        await ground.channel(1, SigningKey(SECRET))
        await ground.channel(2)
        radio = mavlink.MAVLink_radio_status_message(1, 2, 3, 4, 5, 6, 7)
        ground.opener.last.ends.received(said_by(51, radio, component=68) + said_by(51, component=68), None)
        assert ground.heard == [(1, "RADIO_STATUS"), (2, "RADIO_STATUS")]
        assert ground.links._links[ground.url].strangers == 1

    run(scene)


MISSION = """
format: malipp-mission/1
name: yard
site: {origin: {lat_deg: 34.0, lon_deg: -118.0}, nodes: [{id: base, x_m: 0.0, y_m: 0.0, role: depot}]}
field: {kernel: {family: rbf, length_scale_m: 3.0}, test_points: [{x_m: 5.0, y_m: 2.0}]}
team:
  sample_mass_kg: 1.0
  robots:
    - {id: scout, start: base, depots: [base], empty_mass_kg: 15.0, energy_budget_j: 600000.0,
       payload_capacity: 4, samples_per_node: 2, noise_variance: 0.01, energy_per_kg_m: 3.0, speed_m_s: 1.0}
    - {id: carrier, start: base, depots: [base], empty_mass_kg: 15.0, energy_budget_j: 600000.0,
       payload_capacity: 4, samples_per_node: 2, noise_variance: 0.01, energy_per_kg_m: 3.0, speed_m_s: 1.0}
vehicles:
  carrier: {link: LINK, system_id: 9, component_id: 2, signing_key: keys/carrier.key}
ground_station: {system_id: 250, component_id: 191}
"""


@pytest.mark.parametrize(
    ("scout", "carrier", "alone"),
    [
        ("udpin:0.0.0.0:5", "udpin:0.0.0.0:5", (False, False)),
        ("udpin:0.0.0.0:5", "udpin:0.0.0.0:6", (True, True)),
        ("udpin:0.0.0.0:5, signing_key: a", "udpin:0.0.0.0:5", (True, False)),
        ("udpin:0.0.0.0:5, signing_key: a", "udpin:0.0.0.0:5, signing_key: b", (True, True)),
        ("udpin:0.0.0.0:5, signing_key: a", "udpin:0.0.0.0:5, signing_key: a", (False, False)),
    ],
)
def test_who_hears_what_is_said_to_another(
    tmp_path: Path, scout: str, carrier: str, alone: tuple[bool, bool]
) -> None:
    """A vehicle without a key believes also what is signed for another."""
    for name in ("a", "b"):
        make_key_file(tmp_path / name)
    entries = f"  scout: {{link: {scout}}}\n  carrier: {{link: {carrier}}}\n"
    mission = parse_mission(MISSION[: MISSION.index("  carrier: {link")] + entries)
    with KeyRing() as keys:
        found = [not vehicle_link(mission, robot, tmp_path, keys).shared for robot in ("scout", "carrier")]
    assert tuple(found) == alone


def test_the_mission_file_says_how_vehicles_are_reached(tmp_path: Path) -> None:
    mission = parse_mission(MISSION.replace("LINK", "serial:/dev/ttyUSB0:57600"))
    with KeyRing() as keys:
        with pytest.raises(LinkError, match=r"^vehicles\.scout: no link is given; add link: udpin"):
            vehicle_link(mission, "scout", tmp_path, keys)
        with pytest.raises(InputError, match=r"carrier\.key: No such file"):
            vehicle_link(mission, "carrier", tmp_path, keys)
        make_key_file(tmp_path / "keys" / "carrier.key")
        where = vehicle_link(mission, "carrier", tmp_path, keys)
        assert (where.system_id, where.component_id, where.own) == (9, 2, (250, 191))
        assert where.url == parse_link_url("serial:/dev/ttyUSB0:57600")
        assert where.key is not None
        assert (tmp_path / "keys" / "carrier.key").read_text().strip() not in repr(where)


@pytest.mark.parametrize(
    ("link", "problem"),
    [
        ("udp:127.0.0.1:5", "udpin:HOST:PORT, udpout:HOST:PORT, tcp:HOST:PORT or serial:DEVICE:BAUD"),
        ("''", "'' is not a link: expected udpin"), ("udpout:127.0.0.1", "expected udpin"),
        ("'udpout::5'", "expected udpin"), ("tcp:a..b:5", "'a..b' is no host"),
        ("tcp:h:0", "the port is from 1 to 65535"),
        ("tcp:h:65536", "the port is from 1 to 65535"), ("udpin:h:x", "expected"), ("udpin:h:٣", "expected"),
        ("serial:/dev/ttyUSB0", "expected"), ("serial:/dev/ttyUSB0:0", "the baud rate is from 1 to 4000000"),
    ],
)  # fmt: skip
def test_a_wrong_url_is_refused_where_it_stands(link: str, problem: str) -> None:
    with pytest.raises(InputError) as caught:
        parse_mission(MISSION.replace("LINK", link))
    assert str(caught.value).startswith("mission:14: vehicles.carrier.link: ")
    assert problem in str(caught.value)


@pytest.mark.parametrize(
    "text", ["udpin:0.0.0.0:14550", "tcp:[::1]:5760", "serial:/dev/serial/by-id/usb-a:b:57600"]
)
def test_urls_come_back_as_they_were(text: str) -> None:
    assert str(parse_link_url(text)) == text
    assert "[" not in parse_link_url(text).place
