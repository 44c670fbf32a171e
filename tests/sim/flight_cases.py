"""Exported missions, driven to their end by whatever ground station uploads and starts them.

A client is a ground station with one vehicle. What joins them here does what a person would do: it lets a
vehicle pass its gate when the drops are heard to be done. Clients keep wall time, so the simulated world does
too until all vehicles drive; the drives themselves are run through quickly.
"""

from __future__ import annotations

import asyncio
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
from malipp_field.planner.verify import check
from malipp_field.sim import Fleet, RoverConfig
from malipp_field.sim.mission_run import RunState
from malipp_field.vehicle.compile import compile_plan
from malipp_field.vehicle.export import ExportFormat, export
from malipp_field.vehicle.layout import lay_out
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
        """Return the payload actions that the vehicle was heard to have done."""
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


OpenClient = Callable[[Assignment], AbstractAsyncContextManager[Client]]


@dataclass
class Flight:
    """What came of it."""

    fleet: Fleet
    wanted: dict[str, Done]
    """By robot: the payload actions of its mission."""
    confirmed: dict[str, Done]


def corridor(extra: str = "") -> tuple[Mission, Plan]:
    """Return the mission of the README with a keep-out, and its plan of three drops, verified."""
    text = (ROOT / "missions" / "corridor.yaml").read_text().replace("  edges:\n", KEEP_OUT + "  edges:\n", 1)
    mission, plan = parse_mission(text + extra), read_plan(PLAN)
    check(mission, plan)
    assert plan.handoffs == 3
    return mission, plan


def fly(open_client: OpenClient, kind: ExportFormat, folder: Path, extra: str = "") -> Flight:
    """Export the corridor's mission files, and have a client upload, start and see through each."""
    return asyncio.run(asyncio.wait_for(_flight(open_client, kind, folder, extra), LIMIT_S))


async def _flight(open_client: OpenClient, kind: ExportFormat, folder: Path, extra: str) -> Flight:
    mission, plan = corridor(extra)
    missions = compile_plan(mission, plan).missions
    export(mission, plan, kind, folder)
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
        await _see_through(fleet, missions, clients, clock)
        return Flight(
            fleet,
            wanted={robot: payload_actions(vehicle) for robot, vehicle in missions.items()},
            confirmed={robot: client.confirmed() for robot, client in clients.items()},
        )


def payload_actions(vehicle: VehicleMission) -> Done:
    return {(s.action, tag) for s in vehicle.steps if s.action not in DRIVING for tag in s.tags}


async def _see_through(
    fleet: Fleet, missions: dict[str, VehicleMission], clients: dict[str, Client], clock: SimClock
) -> None:
    """Open gates until every mission is complete and its last confirmation is heard."""
    passed: set[str] = set()
    wanted = {robot: payload_actions(vehicle) for robot, vehicle in missions.items()}
    while True:
        heard = {robot: client.confirmed() for robot, client in clients.items()}
        complete = all(rover.autopilot.run.state is RunState.COMPLETE for rover in fleet.rovers.values())
        if complete and all(wanted[robot] <= heard[robot] for robot in clients):
            return
        dropped = {tag for done in heard.values() for action, tag in done if action is Action.DROP}
        for robot, client in clients.items():
            item = fleet.rovers[robot].autopilot.run.seq
            gate = _step(missions[robot], item)
            if gate is None or gate.action is not Action.WAIT or gate.uid in passed:
                continue
            if dropped.issuperset(gate.tags) and await client.release(gate, item + 1):
                passed.add(gate.uid)
        await clock.sleep(LOOK_S)


def _step(vehicle: VehicleMission, item: int) -> Step | None:
    index = lay_out(vehicle).steps[item]
    return vehicle.steps[index] if index >= 0 else None


@asynccontextmanager
async def beside(work: Coroutine[Any, Any, None]) -> AsyncIterator[None]:
    """Have something run beside, while the context lasts."""
    task = asyncio.create_task(work)
    try:
        yield
    finally:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)


def assert_flown(flight: Flight) -> None:
    """Every action of every mission is done in the world, and was confirmed; every sample is home."""
    for robot, wanted in flight.wanted.items():
        assert flight.confirmed[robot] == wanted
        autopilot = flight.fleet.rovers[robot].autopilot
        assert autopilot.run.state is RunState.COMPLETE
        assert not autopilot.stranded
    picked = {tag for done in flight.wanted.values() for action, tag in done if action is Action.PICK}
    unloaded = {tag for done in flight.wanted.values() for action, tag in done if action is Action.UNLOAD}
    assert len(picked) == 4
    assert flight.fleet.world.delivered() == dict.fromkeys(unloaded, "base")
    assert flight.fleet.world.caches() == {}
