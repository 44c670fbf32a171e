"""An agent and a simulated rover on a virtual clock, with a bad link between them and a bus of our own."""

from __future__ import annotations

import asyncio
import random
from collections.abc import Awaitable, Callable, Coroutine
from typing import Any, Self, TypeVar

from link_cases import STEP_S, SYSTEM, Wire, framed, from_ground
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from malipp_field.bus.messages import (
    Command,
    Confirmation,
    Event,
    Hold,
    Load,
    Message,
    Order,
    Reply,
    Start,
    Telemetry,
)
from malipp_field.clock import SimClock
from malipp_field.link import Agent, VehicleLink
from malipp_field.link.channels import OnEvent, OnMessage
from malipp_field.mission import Mission, parse_mission
from malipp_field.mission.link_url import parse_link_url
from malipp_field.sim import Rover, RoverConfig, World
from malipp_field.vehicle.steps import Action, GeoPoint, Step, VehicleMission

TEXT = """
format: malipp-mission/1
name: yard
site:
  origin: {lat_deg: 34.0219, lon_deg: -118.2870, alt_m: 60.0}
  nodes:
    - {id: base, x_m: 0.0, y_m: 0.0, role: depot}
    - {id: a, x_m: 100.0, y_m: 0.0}
    - {id: b, x_m: 100.0, y_m: 60.0}
  complete: true
field:
  kernel: {family: rbf, length_scale_m: 30.0, variance: 2.0}
  test_points: [{x_m: 50.0, y_m: 20.0}]
team:
  sample_mass_kg: 1.0
  service_time_s: 4.0
  robots:
    - {id: scout, start: base, depots: [base], empty_mass_kg: 15.0, energy_budget_j: 600000.0,
       payload_capacity: 4, samples_per_node: 2, noise_variance: 0.01, energy_per_kg_m: 3.0, speed_m_s: 10.0}
"""
MISSION = parse_mission(TEXT)
FAR = parse_mission(TEXT.replace("x_m: 100.0", "x_m: 600.0").replace("y_m: 60.0", "y_m: 500.0"))
"""The same with legs of a minute."""
ROUND = ("drive a", "collect a 1", "collect a 2", "drive b", "collect b 3", "drive base", "unload base 1",
         "unload base 2", "unload base 3")  # fmt: skip
WORK_DONE = [uid for uid in ROUND if not uid.startswith("drive")]
WHERE = VehicleLink(parse_link_url("udpout:rover:14550"), SYSTEM)
SET_CURRENT = mavlink.MAV_CMD_DO_SET_MISSION_CURRENT
STOP = Hold(reason="test")

MessageT = TypeVar("MessageT", bound=Message)
ResultT = TypeVar("ResultT")


class FakeBus:
    """Keeps what is published, in order, and hands orders to whoever serves them."""

    def __init__(self) -> None:
        self.said: list[tuple[str, Message]] = []
        self.handler: Callable[[Any], Awaitable[Reply]] | None = None

    def publish(self, key: str, message: Message) -> None:
        self.said.append((key, message))

    async def serve(
        self, key: str, kind: type[MessageT], handler: Callable[[MessageT], Awaitable[Reply]]
    ) -> None:
        assert (key, kind) == ("malipp/yard/vehicle/scout/command", Command)
        self.handler = handler

    async def present(self, key: str) -> None:
        assert key == "malipp/yard/alive/scout"

    def of(self, kind: type[MessageT]) -> list[MessageT]:
        return [message for _, message in self.said if isinstance(message, kind)]


class Yard:
    """The rover `scout`, its agent, and all between them.

    Parameters
    ----------
    loss
        Share of messages that a bad link loses each way; 0 is a perfect link.
    """

    def __init__(
        self,
        seed: int = 0,
        loss: float = 0.0,
        config: RoverConfig | None = None,
        start_s: float = 1e9,
        mission: Mission = MISSION,
    ) -> None:
        self.clock = SimClock(start_s)
        self.world = World(mission)
        self.rover = Rover("scout", self.world, SYSTEM, self.clock.now_s(), config)
        self.bus = FakeBus()
        self.agent = Agent("yard", "scout", WHERE, self, self.bus, self.clock)
        self.up, self.down = Wire(seed, loss, loss > 0.0), Wire(seed + 1_000_000, loss, loss > 0.0)
        self.noise = random.Random(seed)
        self.cut = self.deaf = False
        self.heard: list[Any] = []
        self.watch: Callable[[Any], None] = lambda message: None
        self.on_send: Callable[[Any], None] = lambda message: None
        self.on_hear: Callable[[Any], None] = lambda message: None
        self.work: asyncio.Future[None]

    async def open(
        self, where: VehicleLink, on_message: OnMessage, on_event: OnEvent, skip: frozenset[int]
    ) -> Yard:
        """Be the agent's link."""
        assert where == WHERE
        self._on_message, self._skip = on_message, skip
        return self

    def send(self, message: Any) -> None:
        self.on_send(message)
        if not self.cut:
            self.up.put(from_ground(message), self.clock.now_s())

    def close(self) -> None:
        self.cut = True

    async def live(self, duration_s: float = STEP_S) -> None:
        """Let everybody live for a while."""
        end_s = self.clock.now_s() + duration_s
        while self.clock.now_s() < end_s - 1e-6:
            self.clock.advance(STEP_S)
            self._carry(self.clock.now_s())
            for _ in range(8):  # longer than any chain of wake-ups
                await asyncio.sleep(0)

    def _carry(self, now_s: float) -> None:
        for message in self.up.arrived(now_s):
            self.heard.append(message)
            self.watch(message)
            self.rover.receive(message, "ground", now_s)
        self.rover.step(now_s)
        outbox, self.rover.outbox = self.rover.outbox, []
        for _, message in outbox:
            if not (self.cut or self.deaf):
                self.down.put(framed(message), now_s)
        for message in self.down.arrived(now_s):
            if message.get_msgId() not in self._skip:
                self.on_hear(message)
                self._on_message(message)

    async def order(self, order: Order, limit_s: float = 600.0) -> Reply:
        """Give an order and live until it is answered, and telemetry shows it."""
        task = self.begin(order)
        end_s = self.clock.now_s() + limit_s
        while not task.done():
            assert self.clock.now_s() < end_s, "the order is not answered"
            await self.live()
        await self.live(0.5)
        return task.result()

    def begin(self, order: Order) -> asyncio.Future[Reply]:
        assert self.bus.handler is not None
        return asyncio.ensure_future(self.bus.handler(Command(time_s=self.clock.now_s(), order=order)))

    async def until(self, condition: Callable[[], bool], limit_s: float = 300.0) -> None:
        end_s = self.clock.now_s() + limit_s
        while not condition():
            assert self.clock.now_s() < end_s, "it does not happen"
            await self.live()

    def run(self, scene: Callable[[Self], Coroutine[Any, Any, ResultT]]) -> ResultT:
        """Run a scene with the agent at work."""

        async def whole() -> ResultT:
            self.work = asyncio.ensure_future(self.agent.run())
            try:
                await self.live(1.5)
                return await scene(self)
            finally:
                await self.kill_agent()

        return asyncio.run(whole())

    async def kill_agent(self) -> None:
        """Have the agent's process die."""
        self.work.cancel()
        outcome = (await asyncio.gather(self.work, return_exceptions=True))[0]
        assert isinstance(outcome, asyncio.CancelledError), outcome
        self._on_message = lambda message: None
        self.bus.handler = None

    async def restart_agent(self, after_s: float) -> None:
        """Have the agent's process die, and another take its place some time later."""
        await self.kill_agent()
        await self.live(after_s)
        await self.start_agent()

    async def start_agent(self) -> None:
        """Start another agent in the place of the one that died."""
        self.cut = False
        self.agent = Agent("yard", "scout", WHERE, self, self.bus, self.clock)
        self.work = asyncio.ensure_future(self.agent.run())
        await self.live(1.5)

    @property
    def telemetry(self) -> Telemetry:
        return self.bus.of(Telemetry)[-1]

    @property
    def confirmed(self) -> list[tuple[int, str, bool]]:
        return [(c.number, c.uid, c.ok) for c in self.bus.of(Confirmation)]

    @property
    def events(self) -> list[str]:
        return [event.text for event in self.bus.of(Event)]

    def point(self, node: str) -> GeoPoint:
        lat_deg, lon_deg = self.world.globe(self.world.places[node])
        return GeoPoint(lat_deg=lat_deg, lon_deg=lon_deg)

    def mission(self, *work: str, version: int = 1) -> VehicleMission:
        """Return a mission of steps written as ``drive a``, ``collect a 3``; the text is the uid."""
        steps = []
        for stop, text in enumerate(work):
            action, node, *tags = text.split()
            steps.append(
                Step(
                    uid=text, action=Action(action), node=node, stop=stop, place=self.point(node),
                    tags=tuple(int(tag) for tag in tags),
                )
            )  # fmt: skip
        return VehicleMission(robot="scout", version=version, home=self.point("base"), steps=tuple(steps))


def mode_of(yard: Yard) -> int:
    return yard.rover.autopilot.mode


async def fly(yard: Yard, *work: str) -> None:
    assert (await yard.order(Load(mission=yard.mission(*work)))).ok
    assert (await yard.order(Start())).ok
