"""Exported missions, driven to their end by whatever ground station uploads and starts them.

A client is a ground station with one vehicle. What joins them here does what a person would do: it lets a
vehicle pass its gate when the drops are heard to be done, and does and judges what is left to a person.
Clients keep wall time, so the simulated world does too until all vehicles drive; the drives themselves are
run through quickly.
"""

from __future__ import annotations

import asyncio
from abc import ABC, abstractmethod
from collections.abc import AsyncIterator, Callable, Coroutine
from contextlib import AbstractAsyncContextManager, AsyncExitStack, asynccontextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from malipp_field.clock import Clock, SimClock
from malipp_field.link.compare import differences
from malipp_field.mission import Mission, parse_mission
from malipp_field.plan import Plan
from malipp_field.plan.files import read_plan
from malipp_field.planner.verifier.rules import check
from malipp_field.sim import Fleet, RoverConfig
from malipp_field.sim.mission_run import RunState
from malipp_field.vehicle.compile import compile_plan
from malipp_field.vehicle.export import ExportFormat, export
from malipp_field.vehicle.layout import confirmed_by, lay_out
from malipp_field.vehicle.payload_protocol import parse_confirmation
from malipp_field.vehicle.steps import Action, Step, VehicleMission

ROOT = Path(__file__).parents[2]
PLAN = Path(__file__).with_name("corridor-plan.json")
START_S = 1_700_000_000.0
SPEED = 100.0
LIMIT_S = 90.0
"""Of wall time, for a machine busy with other things; a flight takes some ten seconds."""
LOOK_S = 1.0
DRIVING = {Action.DRIVE, Action.WAIT}
KEEP_OUT = """  keep_outs:
    - {id: pond, polygon: [{x_m: 70.0, y_m: 30.0}, {x_m: 90.0, y_m: 30.0}, {x_m: 80.0, y_m: 45.0}]}
"""

HARDWARE = """
vehicles:
  scout:
    payload:
      collect: {by: servo, channel: 9, pwm_us: 1900, rest_us: 1100, duration_s: 5.0}
      drop: {by: gripper, move: release, duration_s: 3.0}
  carrier:
    payload:
      collect: {by: relay, relay: 0, duration_s: 4.0, confirm: operator}
      pick: {by: gripper, move: grab, duration_s: 3.0}
      unload: {by: manual}
"""
"""No script on board of either: what is done is confirmed by progress, or by a person."""

KEPT_BY_SCRIPT = """
vehicles:
  carrier: {gate: time}
"""
KEPT_BY_DELAY = f"{HARDWARE}    gate: time\n"
"""The carrier waits for drops by the clock, alone: nobody opens its gates."""

Done = set[tuple[Action, int]]
"""Payload actions, with the tag of the container."""


@dataclass(frozen=True)
class Assignment:
    """What a client is told: its vehicle, and where the exported files lie."""

    mission: Mission
    vehicle: VehicleMission
    endpoint: tuple[str, int]
    system_id: int
    folder: Path
    clock: Clock

    def file(self, suffix: str) -> Path:
        return self.folder / f"{self.mission.name}-{self.vehicle.robot}{suffix}"


class Client(Protocol):
    """A ground station with one vehicle."""

    def confirmed(self) -> Done:
        """Return the payload actions that are known to be done."""
        ...

    async def upload(self) -> None:
        """Upload the exported mission, and read it back."""
        ...

    async def start(self) -> None:
        """Arm, and set off."""
        ...

    async def release(self, gate: Step, item: int) -> bool:
        """Let the vehicle pass a gate, by making ``item`` current; return whether that was possible."""
        ...

    async def judge(self, step: Step, item: int | None) -> bool:
        """Take a person's word that a step is done, and make ``item`` current, where there is a next one.

        Return whether that was possible.
        """
        ...


class Operated(ABC):
    """A ground station that knows nothing of payloads, and a person who reads what it shows."""

    def __init__(self, vehicle: VehicleMission) -> None:
        self._vehicle = vehicle
        self._done: Done = set()

    def confirmed(self) -> Done:
        return set(self._done)

    def shows_text(self, text: str) -> None:
        """Take in a STATUSTEXT: the payload script confirms what it has done."""
        report = parse_confirmation(text)
        if report is not None and report.ok:
            self._done.add((report.action, report.tag))

    def shows_item(self, item: int) -> None:
        """Take in which item is current: hardware that cannot speak has done what the vehicle is past."""
        layout = lay_out(self._vehicle)
        for index, step in enumerate(self._vehicle.steps):
            if layout.last_item(index) < item and confirmed_by(self._vehicle, step) == "progress":
                self._done.add((step.action, step.tags[0]))

    async def judge(self, step: Step, item: int | None) -> bool:
        self._done.add((step.action, step.tags[0]))
        return item is None or await self.release(step, item)

    @abstractmethod
    async def release(self, gate: Step, item: int) -> bool: ...


OpenClient = Callable[[Assignment], AbstractAsyncContextManager[Client]]


@dataclass
class Flight:
    """What came of it."""

    fleet: Fleet
    wanted: dict[str, Done]
    """By robot: the payload actions of its mission."""
    confirmed: dict[str, Done]
    early_s: dict[str, float]
    """By gate that opens by time: how much earlier than that it was passed."""


def corridor(extra: str = "") -> tuple[Mission, Plan]:
    """Return the mission of the README with a keep-out, and its plan of three drops, verified."""
    text = (ROOT / "missions" / "corridor.yaml").read_text().replace("  edges:\n", KEEP_OUT + "  edges:\n", 1)
    mission, plan = parse_mission(text + extra), read_plan(PLAN)
    check(mission, plan)
    assert plan.handoffs == 3
    return mission, plan


def fly(open_client: OpenClient, kind: ExportFormat, folder: Path, extra: str = "") -> Flight:
    """Export the corridor's mission files, and have a client upload, start and see through each.

    Gates by time are set for a start by which the vehicles are surely under way.
    """
    return asyncio.run(asyncio.wait_for(_flight(open_client, kind, folder, extra), LIMIT_S))


async def _flight(open_client: OpenClient, kind: ExportFormat, folder: Path, extra: str) -> Flight:
    mission, plan = corridor(extra)
    start_s = START_S + LIMIT_S
    missions = compile_plan(mission, plan, start_s=start_s).missions
    export(mission, plan, kind, folder, start_s)
    clock = SimClock(START_S, SPEED)
    async with AsyncExitStack() as stack:
        fleet = await stack.enter_async_context(Fleet(mission, clock, config=RoverConfig(ready_after_s=0.0)))
        await stack.enter_async_context(beside(clock.run()))
        clients: dict[str, Client] = {}
        with clock.real_time():
            for system_id, robot in enumerate(fleet.rovers, start=1):
                told = Assignment(mission, missions[robot], fleet.endpoints[robot], system_id, folder, clock)
                clients[robot] = await stack.enter_async_context(open_client(told))
            for robot, client in clients.items():
                await client.upload()
                on_board = fleet.rovers[robot].autopilot.store.items
                assert differences(lay_out(missions[robot]).items, on_board) == []
            for client in clients.values():
                await client.start()
        hands = _Hands(fleet, missions, clients, clock)
        while not hands.all_done():
            await hands.lend()
            await clock.sleep(LOOK_S)
        return Flight(
            fleet,
            wanted={robot: payload_actions(vehicle) for robot, vehicle in missions.items()},
            confirmed={robot: client.confirmed() for robot, client in clients.items()},
            early_s=hands.early_s,
        )


def payload_actions(vehicle: VehicleMission) -> Done:
    return {(s.action, tag) for s in vehicle.steps if s.action not in DRIVING for tag in s.tags}


class _Hands:
    """What people do on the way: they open gates, and do and judge what is theirs to do."""

    def __init__(
        self, fleet: Fleet, missions: dict[str, VehicleMission], clients: dict[str, Client], clock: Clock
    ) -> None:
        self._fleet, self._missions, self._clients, self._clock = fleet, missions, clients, clock
        self._passed: set[str] = set()
        self._shut: dict[str, Step] = {}
        self.early_s: dict[str, float] = {}

    def all_done(self) -> bool:
        """Return whether every vehicle is at the end of its mission, and all of it is confirmed."""
        return all(
            self._at_end(robot) and payload_actions(vehicle) <= self._clients[robot].confirmed()
            for robot, vehicle in self._missions.items()
        )

    def _at_end(self, robot: str) -> bool:
        """A mission that ends with a person's work is never complete: the vehicle goes on holding."""
        complete = self._fleet.rovers[robot].autopilot.run.state is RunState.COMPLETE
        return complete or self._missions[robot].steps[-1].uid in self._passed

    async def lend(self) -> None:
        """Do once what can be done now."""
        for robot, vehicle in self._missions.items():
            layout, item = lay_out(vehicle), self._fleet.rovers[robot].autopilot.run.seq
            self._watch(robot, vehicle.steps[layout.steps[item]])
            index = layout.steps[item]
            step = vehicle.steps[index]
            if index < 0 or item < layout.last_item(index) or step.uid in self._passed:
                continue
            following = item + 1 if item + 1 < len(layout.items) else None
            # What people do takes real time: a client that repeats itself after half a second must not find
            # the vehicle a minute further on, and set it back.
            with self._clock.real_time():
                if await self._pass(robot, step, following):
                    self._passed.add(step.uid)

    def _watch(self, robot: str, step: Step) -> None:
        """Note when a vehicle leaves a gate that opens by time."""
        gate = self._shut.get(robot)
        if gate is not None and gate != step:
            assert gate.not_before_s is not None
            self.early_s[gate.uid] = gate.not_before_s - self._clock.now_s()
            del self._shut[robot]
        if step.not_before_s is not None:
            self._shut[robot] = step

    async def _pass(self, robot: str, step: Step, item: int | None) -> bool:
        client, pilot = self._clients[robot], self._fleet.rovers[robot].autopilot
        if step.action is Action.WAIT:
            assert item is not None, "a gate is followed by what it is for"
            if step.not_before_s is not None:
                return False  # the vehicle opens it alone
            confirmed = set().union(*(each.confirmed() for each in self._clients.values()))
            dropped = {tag for action, tag in confirmed if action is Action.DROP}
            return dropped.issuperset(step.tags) and await client.release(step, item)
        if confirmed_by(self._missions[robot], step) == "person" and pilot.speed_m_s == 0.0:
            assert pilot.attended(step.action, step.tags[0]).result == "ok"
            return await client.judge(step, item)
        return False


@asynccontextmanager
async def beside(work: Coroutine[Any, Any, None]) -> AsyncIterator[None]:
    """Have something run beside, while the context lasts."""
    task = asyncio.create_task(work)
    try:
        yield
    finally:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)


def assert_flown(flight: Flight, gates_by_time: int = 0) -> None:
    """Every action of every mission is done in the world, and was confirmed; every sample is home."""
    assert len(flight.early_s) == gates_by_time
    assert all(early_s <= 0.0 for early_s in flight.early_s.values())
    for robot, wanted in flight.wanted.items():
        assert flight.confirmed[robot] == wanted
        assert not flight.fleet.rovers[robot].autopilot.stranded
    picked = {tag for done in flight.wanted.values() for action, tag in done if action is Action.PICK}
    unloaded = {tag for done in flight.wanted.values() for action, tag in done if action is Action.UNLOAD}
    assert len(picked) == 4
    assert flight.fleet.world.delivered() == dict.fromkeys(unloaded, "base")
    assert flight.fleet.world.caches() == {}
