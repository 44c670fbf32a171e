"""A team of three rovers on a virtual clock, each by a link of its own, and a transaction over them."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine, Sequence
from contextlib import AsyncExitStack
from typing import Any, TypeVar

from link_cases import STEP_S, Wire, framed, from_ground
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from malipp_field.clock import SimClock
from malipp_field.link.compare import differences
from malipp_field.link.contact import Contact
from malipp_field.link.exchange import MavMessage
from malipp_field.link.mission_protocol import MissionType
from malipp_field.link.transaction import Member, Transaction
from malipp_field.mission import parse_mission
from malipp_field.sim import Rover, World
from malipp_field.vehicle.items import MissionItem, item_at

TEAM = parse_mission(
    """
format: malipp-mission/1
name: team
site:
  origin: {lat_deg: 34.0219, lon_deg: -118.2870, alt_m: 60.0}
  nodes:
    - {id: base, x_m: 0.0, y_m: 0.0, role: depot}
    - {id: a, x_m: 500.0, y_m: 0.0}
  edges: [{from: base, to: a}]
  keep_outs: [{id: sump, polygon: [{x_m: 20.0, y_m: 5.0}, {x_m: 30.0, y_m: 5.0}, {x_m: 25.0, y_m: 12.0}]}]
field:
  kernel: {family: rbf, length_scale_m: 30.0}
  test_points: [{x_m: 50.0, y_m: 20.0}]
team:
  sample_mass_kg: 1.0
  robots:
"""
    + "".join(
        f"    - {{id: {name}, start: base, depots: [base], empty_mass_kg: 15.0, energy_budget_j: 600000.0,"
        " payload_capacity: 4, samples_per_node: 2, noise_variance: 0.01, energy_per_kg_m: 3.0,"
        " speed_m_s: 1.0}\n"
        for name in ("scout", "carrier", "spare")
    )
)
ROBOTS = ("scout", "carrier", "spare")
MISSION, FENCE, RALLY = MissionType
OLD_LENGTH, NEW_LENGTH = 7, 5

ResultT = TypeVar("ResultT")


def way(count: int, shift: int) -> list[MissionItem]:
    """A mission of waypoints, home first."""
    items = [item_at(n, 16, 34.0219 + 1e-4 * (n + shift), -118.2870) for n in range(count)]
    return [items[0]._replace(frame=0), *items[1:]]


OLD, NEW = way(OLD_LENGTH, 0), way(NEW_LENGTH, 50)


class Radio:
    """One rover, the wires to it, and the contact at our end."""

    def __init__(
        self, robot: str, system: int, clock: SimClock, world: World, seed: int, loss: float
    ) -> None:
        self.clock, self.system = clock, system
        self.rover = Rover(robot, world, system, clock.now_s())
        self.up, self.down = Wire(seed, loss, loss > 0.0), Wire(seed + 1_000_000, loss, loss > 0.0)
        self.cut = False
        self.uplinks = 0
        self.cut_at: int | None = None
        self.on_cross: Callable[[MavMessage], None] = lambda message: None
        self.contact = Contact((system, 1), self._open, clock)
        self.rover.autopilot.store.items = list(OLD)

    async def _open(self, on_message: Callable[[MavMessage], None]) -> Radio:
        self._on_message = on_message
        return self

    def send(self, message: MavMessage) -> None:
        if message.get_type().startswith(("MISSION_", "COMMAND_")):
            self.cut = self.cut or self.uplinks == self.cut_at
            self.uplinks += 1
        self.on_cross(message)
        if not self.cut:
            self.up.put(from_ground(message), self.clock.now_s())

    def close(self) -> None:
        self.cut = True

    def carry(self, now_s: float) -> None:
        for message in self.up.arrived(now_s):
            self.rover.receive(message, "ground", now_s)
        self.rover.step(now_s)
        outbox, self.rover.outbox = self.rover.outbox, []
        for peer, message in outbox:
            if not self.cut and peer in (None, "ground"):
                self.down.put(framed(message, self.system), now_s)
        for message in self.down.arrived(now_s):
            self.on_cross(message)
            self._on_message(message)

    def aboard(self) -> str:
        store = self.rover.autopilot.store
        if store.receiving:
            return "half"
        return next(
            (name for name, each in (("old", OLD), ("new", NEW)) if not differences(each, store.items)), "?"
        )


class Field:
    """Rovers, each by a link of its own."""

    def __init__(self, seed: int = 0, loss: float = 0.0, robots: Sequence[str] = ROBOTS) -> None:
        self.clock = SimClock(1e9)
        world = World(TEAM)
        self.radios = {
            robot: Radio(robot, system, self.clock, world, seed + system, loss)
            for system, robot in enumerate(robots, start=1)
        }
        self.said: list[tuple[str, str]] = []

    def run(self, scene: Callable[[Field], Coroutine[Any, Any, ResultT]]) -> ResultT:
        async def whole() -> ResultT:
            async with AsyncExitStack() as stack:
                for radio in self.radios.values():
                    await stack.enter_async_context(radio.contact)
                await self.live(8.0)
                return await scene(self)

        return asyncio.run(whole())

    async def live(self, duration_s: float = STEP_S) -> None:
        end_s = self.clock.now_s() + duration_s
        while self.clock.now_s() < end_s - 1e-6:
            self.clock.advance(STEP_S)
            for radio in self.radios.values():
                radio.carry(self.clock.now_s())
            for _ in range(8):
                await asyncio.sleep(0)

    def members(self, wanted: dict[MissionType, list[MissionItem]] | None = None) -> list[Member]:
        return [
            Member(robot, radio.contact.driver, wanted or {MISSION: NEW})
            for robot, radio in self.radios.items()
        ]

    def transaction(
        self, *, hold: bool = False, wanted: dict[MissionType, list[MissionItem]] | None = None
    ) -> Transaction:
        return Transaction(
            self.members(wanted), hold=hold, on_progress=lambda *words: self.said.append(words)
        )

    async def finish(self, task: asyncio.Task[Any], limit_s: float = 600.0) -> None:
        end_s = self.clock.now_s() + limit_s
        while not task.done():
            assert self.clock.now_s() < end_s, "it does not end"
            await self.live()

    async def carry_out(self, transaction: Transaction) -> bool:
        task = asyncio.create_task(transaction.run())
        await self.finish(task)
        return task.result()

    @property
    def aboard(self) -> list[str]:
        return [radio.aboard() for radio in self.radios.values()]

    def check(self, transaction: Transaction) -> None:
        """What is said of each vehicle is so, and none drives."""
        for member in transaction.members:
            radio = self.radios[member.robot]
            if member.state != "unknown":
                assert radio.aboard() == {"had": "old", "wanted": "new"}[member.state], member.words
            autopilot = radio.rover.autopilot
            assert not (autopilot.armed and autopilot.mode == mavlink.ROVER_MODE_AUTO)
