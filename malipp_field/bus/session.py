"""The Zenoh session of one process: typed messages published, heard, asked and answered."""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import re
from collections.abc import Awaitable, Callable
from types import TracebackType
from typing import Any, TypeVar

import zenoh
from pydantic import ValidationError

from malipp_field.bus.mailbox import Mailbox
from malipp_field.bus.messages import Message, Reply, Telemetry
from malipp_field.errors import LinkError

MessageT = TypeVar("MessageT", bound=Message)
log = logging.getLogger(__name__)


class Bus:
    """One peer on the bus. Use as an async context manager.

    Callbacks and handlers run in the event loop that entered the context, never in Zenoh's threads. What one
    peer says, this one hears in the same order, whatever the keys; there is no order among several peers.
    Where the event loop is behind, old telemetry is left out and counted, and nothing else is.

    Parameters
    ----------
    listen
        Zenoh locator to listen on; loopback and any free port by default.
    connect
        Locators of peers to connect to, tried again in the background while they are not there. Multicast
        scouting is off: nothing on the network is found, or finds us, by chance.

    Attributes
    ----------
    rejected : int
        Messages that did not validate and were dropped.
    """

    def __init__(self, listen: str = "tcp/127.0.0.1:0", connect: tuple[str, ...] = ()) -> None:
        self._config = zenoh.Config()
        for key, value in {
            "mode": "peer",
            "scouting/multicast/enabled": False,
            "listen/endpoints": [listen],
            "connect/endpoints": list(connect),
            "connect/exit_on_failure": False,
        }.items():
            try:
                self._config.insert_json5(key, json.dumps(value))
            except zenoh.ZError:  # whose words are about its source code
                given = ", ".join(value) if isinstance(value, list) else value
                raise LinkError(f"'{given}' is no address of a bus, such as tcp/127.0.0.1:7447") from None
        self._session: Any = None
        self._mailbox = Mailbox(self._in_loop)
        self._declared: list[Any] = []  # Zenoh undeclares what nobody holds on to
        self._answers: set[asyncio.Task[None]] = set()
        self._questions: set[asyncio.Future[Reply]] = set()
        self.rejected = 0

    @property
    def dropped(self) -> int:
        """How much telemetry came faster than the event loop could take it, and was left out for newer."""
        return self._mailbox.dropped

    async def __aenter__(self) -> Bus:
        self._loop = asyncio.get_running_loop()
        try:
            self._session = await asyncio.to_thread(zenoh.open, self._config)
        except zenoh.ZError as fault:
            words = re.sub(r" at /\S+\.rs:\d+\.?", "", str(fault))  # where in Zenoh's source code
            raise LinkError(f"the bus cannot be opened: {words}") from None
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, fault: BaseException | None, trace: TracebackType | None
    ) -> None:
        answers = list(self._answers)
        for answer in answers:
            answer.cancel()
        await asyncio.gather(*answers, return_exceptions=True)
        session, self._session = self._session, None
        for question in self._questions:
            _fail(question, LinkError("the bus was closed before the answer came"))
        await asyncio.to_thread(session.close)
        if self.dropped:
            log.warning("%d old telemetry messages were left out: this process was too slow", self.dropped)

    def publish(self, key: str, message: Message) -> None:
        """Say ``message`` to whoever listens to ``key``.

        Telemetry is dropped when the network is congested: the next one is better anyway. All else waits
        its turn (Zenoh closes a transport that stays blocked for 5 s, so these messages are few and small).
        """
        drop = isinstance(message, Telemetry)
        self._session.put(
            key,
            message.model_dump_json().encode(),
            encoding=zenoh.Encoding.APPLICATION_JSON,
            congestion_control=zenoh.CongestionControl.DROP if drop else zenoh.CongestionControl.BLOCK,
        )

    async def subscribe(
        self, key_expr: str, kind: type[MessageT], callback: Callable[[str, MessageT], None]
    ) -> None:
        """Call ``callback(key, message)`` for every valid message of type ``kind`` on ``key_expr``."""

        def arrived(sample: Any) -> None:
            key = str(sample.key_expr)
            subject = (key_expr, key) if kind is Telemetry else None
            self._mailbox.put(subject, deliver, key, bytes(sample.payload))

        def deliver(key: str, payload: bytes) -> None:
            message = self._parse(kind, key, payload)
            if message is not None:
                callback(key, message)

        handler = _in_order(arrived)
        self._declared.append(await asyncio.to_thread(self._session.declare_subscriber, key_expr, handler))

    async def serve(
        self, key: str, kind: type[MessageT], handler: Callable[[MessageT], Awaitable[Reply]]
    ) -> None:
        """Answer every request of type ``kind`` on ``key`` by what ``handler`` returns."""

        def arrived(query: Any) -> None:
            self._mailbox.put(None, begin, query)

        def begin(query: Any) -> None:
            task = self._loop.create_task(answer(query))
            self._answers.add(task)
            task.add_done_callback(self._answers.discard)

        async def answer(query: Any) -> None:
            with query:  # leaving the context tells the asker that this was the last reply
                message = self._parse(kind, key, bytes(query.payload or b""))
                if message is None:
                    query.reply_err(b"the request was not understood")
                    return
                try:
                    reply = await handler(message)
                except Exception as fault:  # the asker must hear of it, and the next request be answered
                    log.exception("%s: the request could not be handled", key)
                    query.reply_err(f"the request failed: {fault}".encode())
                    return
                query.reply(key, reply.model_dump_json().encode())

        self._declared.append(
            await asyncio.to_thread(self._session.declare_queryable, key, _in_order(arrived))
        )

    async def request(self, key: str, message: Message, timeout_s: float) -> Reply:
        """Ask whoever serves ``key`` and return the answer.

        Parameters
        ----------
        timeout_s
            Wall seconds to wait.

        Raises
        ------
        LinkError
            When nobody answers in time, or the answer is not a `Reply`.
        """
        future: asyncio.Future[Reply] = self._loop.create_future()

        def replied(reply: Any) -> None:
            if reply.ok is not None:
                self._mailbox.put(None, settle, bytes(reply.ok.payload))
            else:  # the other side's words, or Zenoh's ("Timeout")
                self._mailbox.put(None, _fail, future, LinkError(f"{key}: {reply.err.payload.to_string()}"))

        def settle(payload: bytes) -> None:
            answer = self._parse(Reply, key, payload)
            if answer is None:
                _fail(future, LinkError(f"{key}: the answer was not understood"))
            elif not future.done():
                future.set_result(answer)

        def ended() -> None:
            self._mailbox.put(None, _fail, future, LinkError(f"{key}: no answer"))

        self._questions.add(future)
        try:
            self._session.get(
                key,
                zenoh.handlers.Callback(replied, ended, indirect=False),
                payload=message.model_dump_json().encode(),
                timeout=timeout_s,
                congestion_control=zenoh.CongestionControl.BLOCK,
            )
            return await future
        finally:
            self._questions.discard(future)

    async def present(self, key: str) -> None:
        """Show that the holder of ``key`` is there, for as long as this session lives."""
        self._declared.append(await asyncio.to_thread(self._session.liveliness().declare_token, key))

    async def watch_presence(self, key_expr: str, callback: Callable[[str, bool], None]) -> None:
        """Call ``callback(key, there)`` for matching holders: those there now, and who comes or goes."""

        def changed(sample: Any) -> None:
            self._mailbox.put(None, callback, str(sample.key_expr), sample.kind == zenoh.SampleKind.PUT)

        self._declared.append(
            await asyncio.to_thread(
                lambda: self._session.liveliness().declare_subscriber(
                    key_expr, _in_order(changed), history=True
                )
            )
        )

    def _parse(self, kind: type[MessageT], key: str, payload: bytes) -> MessageT | None:
        try:
            return kind.model_validate_json(payload)
        except ValidationError as fault:
            self.rejected += 1
            log.warning("%s: not a valid %s, dropped: %s", key, kind.__name__, fault.errors()[0]["msg"])
            return None

    def _in_loop(self, callback: Callable[[], None]) -> None:
        """Hand over from a Zenoh thread; what arrives while the process shuts down is of no use."""
        if self._session is not None:
            with contextlib.suppress(RuntimeError):  # the loop is closed
                self._loop.call_soon_threadsafe(callback)


def _in_order(callback: Callable[[Any], None]) -> Any:
    """Have a callback run in the thread that receives, not in one of its own for each declaration.

    Otherwise what is declared apart is heard in no order: a vehicle's telemetry before the confirmation that
    was sent ahead of it. The callback must be quick: the session receives nothing meanwhile.
    """
    return zenoh.handlers.Callback(callback, indirect=False)


def _fail(question: asyncio.Future[Reply], fault: LinkError) -> None:
    if not question.done():
        question.set_exception(fault)
