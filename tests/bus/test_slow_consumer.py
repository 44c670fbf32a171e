"""A listener that is held up: it loses old telemetry, nothing else, and knows how much."""

from __future__ import annotations

import asyncio
import socket
import threading
from collections.abc import Callable
from typing import Any

import zenoh

from malipp_field.bus import Bus, Event, Message, Telemetry
from malipp_field.bus.mailbox import TELEMETRY_BACKLOG, Mailbox

WAIT_S = 20.0


class HeldLoop:
    """An event loop that gets to nothing until it is let."""

    def __init__(self) -> None:
        self.due: list[Callable[[], None]] = []
        self.heard: list[Any] = []
        self.mailbox = Mailbox(self.due.append)

    def put(self, subject: str | None, what: Any) -> None:
        self.mailbox.put(subject, self.heard.append, what)

    def turn(self) -> None:
        due, self.due[:] = list(self.due), []
        for callback in due:
            callback()


def test_in_order_and_woken_once() -> None:
    loop = HeldLoop()
    for number in range(30):
        loop.put("a" if number % 2 else None, number)
    assert len(loop.due) == 1
    loop.turn()
    assert loop.heard == list(range(30))
    assert (loop.due, loop.mailbox.dropped, len(loop.mailbox)) == ([], 0, 0)
    loop.put("a", 30)
    loop.turn()
    assert loop.heard[-1] == 30


def test_a_flood_leaves_the_newest_telemetry_of_each_key_and_all_the_rest() -> None:
    loop = HeldLoop()
    said: list[tuple[str | None, int]] = []
    for number in range(3000):
        subject = ("a", "b", "a", "a", None)[number % 5]
        said.append((subject, number))
        loop.put(subject, (subject, number))
    assert len(loop.mailbox) == 600 + 2 * TELEMETRY_BACKLOG
    while loop.due:
        loop.turn()
    expected = [
        entry
        for subject in ("a", "b", None)
        for entry in [each for each in said if each[0] == subject][-TELEMETRY_BACKLOG if subject else 0 :]
    ]
    assert loop.heard == sorted(expected, key=lambda entry: entry[1])
    assert loop.mailbox.dropped == 3000 - len(loop.heard)


def test_what_was_delivered_meanwhile_does_not_count_as_waiting() -> None:
    loop = HeldLoop()
    for number in range(10 * TELEMETRY_BACKLOG):
        loop.put("a", number)
        if number % TELEMETRY_BACKLOG == 0:
            loop.turn()
            loop.turn()
    assert loop.mailbox.dropped == 0


def test_much_at_once_lets_the_loop_do_other_things_in_between() -> None:
    loop = HeldLoop()
    for number in range(250):
        loop.put(None, number)
    loop.turn()
    assert 0 < len(loop.heard) < 250
    loop.turn()
    loop.turn()
    assert len(loop.heard) == 250


def test_a_listener_that_fails_stops_no_other(caplog: Any) -> None:
    loop = HeldLoop()
    loop.mailbox.put(None, {}.__delitem__, "not there")
    loop.put(None, 1)
    loop.turn()
    assert loop.heard == [1]
    assert "could not be handled" in caplog.text


async def eventually(condition: Callable[[], bool], again: Callable[[], None] = lambda: None) -> None:
    while not condition():
        again()
        await asyncio.sleep(0.005)


def telemetry(number: int) -> Telemetry:
    return Telemetry(
        time_s=float(number), robot="scout", lat_deg=0.0, lon_deg=0.0, heading_deg=0.0, speed_m_s=0.0,
        mode="", armed=False, ready_to_arm=False, energy_used_j=0.0, mission_version=None, step_uid=None,
        finished=False, link_ok=True,
    )  # fmt: skip


def event(text: str) -> Event:
    return Event(time_s=0.0, source="test", severity="info", text=text)


def test_a_session_whose_loop_is_held_up_through_a_flood() -> None:
    async def main() -> None:
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            hub = f"tcp/127.0.0.1:{probe.getsockname()[1]}"
        async with Bus(listen=hub) as slow, Bus(connect=(hub,)) as loud:
            heard: list[Message] = []
            for key, kind in (("t/telemetry", Telemetry), ("t/event", Event)):
                await slow.subscribe(key, kind, lambda _, message: heard.append(message))
            # Declarations travel.
            await eventually(lambda: bool(heard), lambda: loud.publish("t/event", event("begin")))
            await eventually(
                lambda: any(isinstance(message, Telemetry) for message in heard),
                lambda: loud.publish("t/telemetry", telemetry(-1)),
            )
            loud.publish("t/event", event("ready"))  # after it nothing is on its way
            await eventually(lambda: isinstance(heard[-1], Event) and heard[-1].text == "ready")

            # From here the loop does nothing but this, until all of it has arrived in the other session.
            arrived, count = threading.Event(), 0

            def counts(sample: Any) -> None:
                nonlocal count
                if str(sample.key_expr) == "t/telemetry":
                    count += 1
                elif b"end" in bytes(sample.payload):
                    arrived.set()

            listener = slow._session.declare_subscriber(
                "t/*", zenoh.handlers.Callback(counts, indirect=False)
            )
            for number in range(400):
                loud.publish("t/telemetry", telemetry(number))
                if number % 4 == 0:
                    loud.publish("t/event", event(str(number)))
            loud.publish("t/event", event("end"))
            assert arrived.wait(WAIT_S)
            assert slow.dropped == count - TELEMETRY_BACKLOG > 0

            before = len(heard)
            await eventually(lambda: isinstance(heard[-1], Event) and heard[-1].text == "end")
            listener.undeclare()
            texts = [m.text for m in heard[before:] if isinstance(m, Event)]
            assert texts == [*map(str, range(0, 400, 4)), "end"]
            times_s = [m.time_s for m in heard[before:] if isinstance(m, Telemetry)]
            assert len(times_s) == TELEMETRY_BACKLOG
            assert times_s == sorted(times_s)
            assert (slow.rejected, loud.dropped) == (0, 0)

    asyncio.run(asyncio.wait_for(main(), 3 * WAIT_S))
