"""A whole team in one thread on a virtual clock: rovers, agents, coordinator and person, no sockets."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from fnmatch import fnmatchcase
from typing import Any, TypeVar, cast

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from malipp_field.bus import (
    Confirmation,
    Event,
    Ledger,
    Message,
    PlanAdopted,
    Reply,
    Telemetry,
    presence_key,
    vehicle_key,
)
from malipp_field.clock import SimClock
from malipp_field.control import Coordinator, Outcome, Planner
from malipp_field.errors import LinkError
from malipp_field.link import Agent, VehicleLink
from malipp_field.link.channels import OnEvent, OnMessage
from malipp_field.mission import Mission
from malipp_field.mission.link_url import parse_link_url
from malipp_field.person import Person
from malipp_field.plan import Plan
from malipp_field.sim import Fleet, Rover

MessageT = TypeVar("MessageT", bound=Message)
START_S = 1_700_000_000.0
_STEP_S = 0.2
_WAKE_UPS = 12  # longer than any chain of them


class LocalBus:
    """The bus, without a network: everybody hears at once, in order."""

    def __init__(self) -> None:
        self.said: list[tuple[str, Message]] = []
        self._heard: list[tuple[str, type[Message], Callable[[str, Any], None]]] = []
        self._served: dict[str, Callable[[Any], Awaitable[Reply]]] = {}
        self._present: set[str] = set()
        self._watchers: list[Callable[[str, bool], None]] = []

    def publish(self, key: str, message: Message) -> None:
        if not isinstance(message, Telemetry):
            self.said.append((key, message))
        for expression, kind, callback in self._heard:
            if isinstance(message, kind) and fnmatchcase(key, expression):
                callback(key, message)

    async def subscribe(
        self, expression: str, kind: type[MessageT], callback: Callable[[str, MessageT], None]
    ) -> None:
        self._heard.append((expression, kind, callback))

    async def serve(
        self, key: str, kind: type[MessageT], handler: Callable[[MessageT], Awaitable[Reply]]
    ) -> None:
        self._served[key] = handler

    async def request(self, key: str, message: Message, timeout_s: float) -> Reply:
        if key not in self._served:
            raise LinkError(f"{key}: no answer")
        return await self._served[key](message)

    async def present(self, key: str) -> None:
        self._present.add(key)
        for watcher in self._watchers:
            watcher(key, True)

    async def watch_presence(self, expression: str, callback: Callable[[str, bool], None]) -> None:
        self._watchers.append(callback)
        for key in self._present:
            callback(key, True)

    def lose(self, key: str) -> None:
        """Have nobody answer there any more."""
        self._served.pop(key, None)

    def tell_of_end(self, key: str) -> None:
        """Have the presence under that key end."""
        self._present.discard(key)
        for watcher in self._watchers:
            watcher(key, False)

    def of(self, kind: type[MessageT]) -> list[MessageT]:
        return [message for _, message in self.said if isinstance(message, kind)]


class Wires:
    """One agent's link to its rover."""

    def __init__(self, rover: Rover, clock: SimClock) -> None:
        self.rover, self._clock = rover, clock
        self.cut = False
        self._up: list[Any] = []
        self._on_message: OnMessage | None = None
        self._skip: frozenset[int] = frozenset()

    async def open(
        self, where: VehicleLink, on_message: OnMessage, on_event: OnEvent, skip: frozenset[int]
    ) -> Wires:
        assert where.system_id == self.rover.system_id
        self._on_message, self._skip, self.cut = on_message, skip, False
        return self

    def send(self, message: Any) -> None:
        if not self.cut:
            self._up.append(_framed(message, 255, 190))

    def close(self) -> None:
        self.cut, self._on_message = True, None

    def carry(self) -> None:
        up, self._up = self._up, []
        for message in up:
            self.rover.receive(message, "ground", self._clock.now_s())
        self.rover.step(self._clock.now_s())
        outbox, self.rover.outbox = self.rover.outbox, []
        for _, message in outbox:
            if self._on_message is not None and not self.cut and message.get_msgId() not in self._skip:
                self._on_message(_framed(message, self.rover.system_id, 1))


def _framed(message: Any, system: int, component: int) -> Any:
    data = message.pack(mavlink.MAVLink(None, srcSystem=system, srcComponent=component))
    return mavlink.MAVLink(None).decode(bytearray(data))


def no_new_plan(mission: Mission, **_: Any) -> Plan:
    return Plan(
        mission=mission.name,
        method="none",
        status="no_plan",
        solve_time_s=0.0,
        robots=(),
        reason="not asked for",
    )


class Team:
    """Everybody of one mission.

    ``watch`` is called after every step of time.
    """

    def __init__(
        self,
        mission: Mission,
        plan: Plan,
        *,
        planner: Planner = no_new_plan,
        start_s: float = START_S,
        watch: Callable[[Team], None] = lambda team: None,
    ) -> None:
        self.mission, self.plan = mission, plan
        self.clock = SimClock(start_s)
        self.bus = LocalBus()
        bus = cast(Any, self.bus)
        self.fleet = Fleet(mission, self.clock)  # not entered: its rovers live by `carry`
        self.world = self.fleet.world
        self.wires = {robot: Wires(rover, self.clock) for robot, rover in self.fleet.rovers.items()}
        self.agents = {robot: self._agent(robot) for robot in self.fleet.rovers}
        self._lives: dict[str, asyncio.Future[None]] = {}
        self.coordinator = Coordinator(mission, "", plan, bus, self.clock, planner)
        self._watch = watch

    def _agent(self, robot: str) -> Agent:
        where = VehicleLink(parse_link_url("udpout:rover:14550"), self.fleet.rovers[robot].system_id)
        return Agent(self.mission.name, robot, where, self.wires[robot], self.bus, self.clock)

    def kill_agent(self, robot: str) -> None:
        """Have the process of an agent die; `tell_of_end` may come any time later."""
        self._lives.pop(robot).cancel()
        self.wires[robot].close()
        self.bus.lose(vehicle_key(self.mission.name, robot, "command"))

    def tell_of_end(self, robot: str) -> None:
        """Have everybody hear that an agent is gone."""
        self.bus.tell_of_end(presence_key(self.mission.name, robot))

    def start_agent(self, robot: str) -> None:
        """Have another take its place, some steps later."""
        self.agents[robot] = self._agent(robot)
        self._lives[robot] = asyncio.ensure_future(self.agents[robot].run())

    def run(self, limit_s: float = 20_000.0) -> Outcome:
        """Carry the mission out, for at most so long."""
        return asyncio.run(self._run(limit_s))

    async def _run(self, limit_s: float) -> Outcome:
        person = Person(self.mission, self.fleet, cast(Any, self.bus), self.clock)
        self._lives = {robot: asyncio.ensure_future(agent.run()) for robot, agent in self.agents.items()}
        self._lives["person"] = asyncio.ensure_future(person.run())
        await self._live()
        flight = asyncio.ensure_future(self.coordinator.run())
        end_s = self.clock.now_s() + limit_s
        try:
            while not flight.done():
                assert self.clock.now_s() < end_s, "the mission does not end"
                await self._live()
                for life in self._lives.values():
                    assert not life.done(), life.exception()
            return flight.result()
        finally:
            everybody: list[asyncio.Future[Any]] = [flight, *self._lives.values()]
            for task in everybody:
                task.cancel()
            await asyncio.gather(*everybody, return_exceptions=True)

    async def _live(self) -> None:
        self.clock.advance(_STEP_S)
        for wires in self.wires.values():
            wires.carry()
        for _ in range(_WAKE_UPS):
            await asyncio.sleep(0)
        self._watch(self)

    @property
    def confirmations(self) -> list[Confirmation]:
        return self.bus.of(Confirmation)

    @property
    def events(self) -> list[str]:
        return [event.text for event in self.bus.of(Event)]

    @property
    def ledger(self) -> Ledger:
        return self.bus.of(Ledger)[-1]

    @property
    def plans(self) -> list[PlanAdopted]:
        return self.bus.of(PlanAdopted)
