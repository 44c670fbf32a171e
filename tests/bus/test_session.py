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


def test_what_one_peer_says_is_heard_in_its_order_whatever_the_keys() -> None:
    async def scenario(a: Bus, b: Bus, c: Bus) -> None:
        heard: list[str] = []
        keys = [f"t/{i}" for i in range(4)]
        for key in keys:
            await a.subscribe(key, Event, lambda _, m: heard.append(m.text))

        def call() -> None:
            for key in keys:
                b.publish(key, event(key))

        await eventually(lambda: set(keys) <= set(heard), call)  # the subscriptions have travelled to b
        b.publish("t/0", event("begin"))
        said = [str(number) for number in range(2000)]
        for number in said:
            b.publish(keys[int(number) % 4], event(number))
        await eventually(lambda: len(heard) > len(said) and heard[-1] == said[-1])
        assert heard[heard.index("begin") + 1 :] == said

    run(scenario)


async def answer_of(bus: Bus, key: str, timeout_s: float = WAIT_S) -> Reply | str:
    """Ask until the one who answers is known there; return the answer, or why there is none."""
    while True:
        try:
            return await bus.request(key, Command(time_s=0.0, order=Start()), timeout_s)
        except LinkError as fault:
            if "no answer" not in str(fault):
                return str(fault)
            await asyncio.sleep(0.005)


def test_a_handler_that_fails_says_so_and_answers_the_next() -> None:
    async def scenario(a: Bus, b: Bus, c: Bus) -> None:
        faults = [ValueError("no wheels")]

        async def handler(command: Command) -> Reply:
            if faults:
                raise faults.pop()
            return Reply(time_s=0.0, ok=True)

        await b.serve("t/command", Command, handler)
        assert await answer_of(a, "t/command") == "t/command: the request failed: no wheels"
        assert await answer_of(a, "t/command") == Reply(time_s=0.0, ok=True)

    run(scenario)


def test_silence_is_told_from_misunderstanding() -> None:
    async def scenario(a: Bus, b: Bus, c: Bus) -> None:
        asked = asyncio.Event()

        async def think(command: Command) -> Reply:
            asked.set()
            await asyncio.sleep(WAIT_S)
            raise AssertionError("it was to be cancelled")

        await b.serve("t/command", Command, think)
        question = asyncio.ensure_future(answer_of(a, "t/command", timeout_s=0.3))
        await asyncio.wait_for(asked.wait(), WAIT_S)
        assert "imeout" in str(await question)
        assert a.rejected == 0

    run(scenario)


def test_a_bus_that_closes_leaves_nobody_waiting() -> None:
    async def main() -> None:
        hub = free_locator()
        asked = asyncio.Event()
        ended = asyncio.Event()

        async def think(command: Command) -> Reply:
            asked.set()
            try:
                await asyncio.sleep(WAIT_S)
            finally:
                ended.set()
            raise AssertionError("it was to be cancelled")

        async with Bus(listen=hub) as b:
            await b.serve("t/command", Command, think)
            async with Bus(connect=(hub,)) as a:
                question = asyncio.ensure_future(answer_of(a, "t/command"))
                await asyncio.wait_for(asked.wait(), WAIT_S)
            assert "the bus was closed" in str(await asyncio.wait_for(question, WAIT_S))
        assert ended.is_set()

    asyncio.run(main())


def test_sessions_close_in_the_midst_of_traffic() -> None:
    async def main() -> None:
        hub = free_locator()
        async with Bus(listen=hub) as a:
            heard: list[str] = []
            await a.subscribe("t/*", Event, lambda _, m: heard.append(m.text))
            for _ in range(5):
                async with Bus(connect=(hub,)) as b:
                    await b.subscribe("t/*", Event, lambda _, m: heard.append(m.text))
                    for number in range(200):
                        b.publish("t/a", event(str(number)))
                        a.publish("t/b", event(str(number)))

    asyncio.run(asyncio.wait_for(main(), 3 * WAIT_S))
