"""The Zenoh session: typed messages among peers on loopback."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Awaitable, Callable

import pytest

from malipp_field.bus import Bus, Command, Event, Hold, Reply, Start
from malipp_field.errors import LinkError

WAIT_S = 10.0


def free_locator() -> str:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"


def event(text: str) -> Event:
    return Event(time_s=1.0, source="test", severity="info", text=text)


async def eventually(condition: Callable[[], bool], again: Callable[[], None] | None = None) -> None:
    async def poll() -> None:
        while not condition():
            if again is not None:
                again()
            await asyncio.sleep(0.005)

    await asyncio.wait_for(poll(), WAIT_S)


def run(scenario: Callable[[Bus, Bus, Bus], Awaitable[None]]) -> None:
    async def main() -> None:
        hub = free_locator()
        async with Bus(listen=hub) as a, Bus(connect=(hub,)) as b, Bus(connect=(hub,)) as c:
            await scenario(a, b, c)

    asyncio.run(main())


def test_a_message_reaches_every_peer_also_those_met_through_another() -> None:
    async def scenario(a: Bus, b: Bus, c: Bus) -> None:
        heard: dict[str, set[str]] = {"a": set(), "c": set()}
        await a.subscribe("t/**", Event, lambda key, m: heard["a"].add(f"{key} {m.text}"))
        await c.subscribe("t/**", Event, lambda key, m: heard["c"].add(f"{key} {m.text}"))
        # Declarations travel: say it again until both have heard it.
        await eventually(lambda: all(heard.values()), lambda: b.publish("t/event", event("hello")))
        assert heard == {"a": {"t/event hello"}, "c": {"t/event hello"}}

    run(scenario)


def test_what_does_not_validate_is_counted_and_dropped() -> None:
    async def scenario(a: Bus, b: Bus, c: Bus) -> None:
        heard: list[Event] = []
        await a.subscribe("t/event", Event, lambda _, m: heard.append(m))
        wrong = Command(time_s=0.0, order=Start())
        await eventually(lambda: a.rejected > 0, lambda: b.publish("t/event", wrong))
        assert not heard

    run(scenario)


def test_a_request_gets_its_answer_and_the_handler_runs_in_the_loop() -> None:
    async def scenario(a: Bus, b: Bus, c: Bus) -> None:
        loop = asyncio.get_running_loop()

        async def handler(command: Command) -> Reply:
            assert asyncio.get_running_loop() is loop
            assert isinstance(command.order, Hold)
            return Reply(time_s=command.time_s + 1.0, ok=True, text=command.order.reason)

        await b.serve("t/command", Command, handler)

        async def ask() -> Reply:
            while True:
                try:
                    return await c.request(
                        "t/command", Command(time_s=4.0, order=Hold(reason="a dog")), timeout_s=WAIT_S
                    )
                except LinkError:  # the queryable is not known there yet
                    await asyncio.sleep(0.005)

        assert await asyncio.wait_for(ask(), WAIT_S) == Reply(time_s=5.0, ok=True, text="a dog")

    run(scenario)


def test_nobody_to_answer_is_a_link_error() -> None:
    async def scenario(a: Bus, b: Bus, c: Bus) -> None:
        with pytest.raises(LinkError, match="t/nobody: no answer"):
            await a.request("t/nobody", Command(time_s=0.0, order=Start()), timeout_s=0.2)

    run(scenario)


def test_presence_is_seen_by_those_who_come_later_and_ends_with_the_session() -> None:
    async def main() -> None:
        hub = free_locator()
        changes: list[tuple[str, bool]] = []
        async with Bus(listen=hub) as a:
            async with Bus(connect=(hub,)) as b:
                await b.present("t/alive/b")
                await a.watch_presence("t/alive/*", lambda key, there: changes.append((key, there)))
                await eventually(lambda: ("t/alive/b", True) in changes)
            await eventually(lambda: ("t/alive/b", False) in changes)

    asyncio.run(main())
