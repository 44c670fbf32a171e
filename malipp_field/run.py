"""The whole chain in one process: simulated rovers, agents, coordinator and recorder on one bus.

The parts share nothing but the bus and the clock, as they would on several machines.
"""

from __future__ import annotations

import asyncio
import secrets
import socket
import time
from collections.abc import Callable, Sequence
from contextlib import AsyncExitStack
from pathlib import Path
from typing import Any

from malipp_field.bus import Bus
from malipp_field.clock import SimClock
from malipp_field.control import Coordinator, Outcome, Planner
from malipp_field.link import Agent, Links, SigningKey, VehicleLink
from malipp_field.link.signing import KEY_LENGTH
from malipp_field.mission import Mission, TeamState
from malipp_field.mission.link_url import parse_link_url
from malipp_field.person import Person
from malipp_field.plan import Plan
from malipp_field.planner import solve
from malipp_field.record import RECORDER_PRESENCE, Recorder
from malipp_field.sim import Fleet

_LAST_WORDS_S = 2.0  # simulated seconds for the last messages to reach the recorder


def mission_planner(threads: int | None = None) -> Planner:
    """Return the planner that a coordinator uses: the mission's own options, its replanning time limit."""

    def plan_rest(mission: Mission, *, state: TeamState, warm_start: Plan, version: int) -> Plan:
        return solve(
            mission,
            state=state,
            time_limit_s=mission.replanning.time_limit_s,
            warm_start=warm_start,
            version=version,
            threads=threads,
        )

    return plan_rest


async def fly(
    mission: Mission,
    mission_text: str,
    plan: Plan,
    recording: Path,
    *,
    speed: float | None = None,
    planner: Planner | None = None,
    on_tick: Callable[[Coordinator], None] | None = None,
    listen: str | None = None,
) -> Outcome:
    """Fly a plan with simulated rovers and record everything said on the bus.

    Parameters
    ----------
    mission, mission_text
        The mission and the file it was read from.
    plan
        A verified plan of it.
    recording
        The MCAP file to write.
    speed
        Simulated seconds for each wall second; the mission's own where `None`.
    planner
        Plans the rest of the mission when the coordinator asks; `mission_planner` where `None`.
    on_tick
        Called now and then with the coordinator, for a progress display.
    listen
        Where the bus listens (`any_free_port` where `None`).
    """
    clock = SimClock(start_s=time.time(), speed=mission.simulation.speed if speed is None else speed)
    hub = listen or any_free_port()
    robots = [robot.id for robot in mission.team.robots]
    # Keys of their own: the timestamps of a fast clock are not for those of real vehicles.
    keys = {robot: secrets.token_bytes(KEY_LENGTH) for robot in robots if mission.vehicle(robot).signing_key}
    async with AsyncExitStack() as stack:
        enter = stack.enter_async_context
        fleet = await enter(Fleet(mission, clock, keys=keys))
        control_bus = await enter(Bus(listen=hub))
        await enter(Recorder(await enter(Bus(connect=(hub,))), mission.name, recording))
        links = await enter(Links(clock))
        agents = [
            Agent(
                mission.name,
                robot,
                _simulated_link(mission, robot, fleet.links[robot], keys.get(robot)),
                links,
                await enter(Bus(connect=(hub,))),
                clock,
            )
            for robot in robots
        ]
        coordinator = Coordinator(
            mission,
            mission_text,
            plan,
            control_bus,
            clock,
            planner or mission_planner(),
            witnesses=(RECORDER_PRESENCE,),
            on_tick=on_tick,
        )
        person = Person(mission, fleet, await enter(Bus(connect=(hub,))), clock)
        services = [asyncio.create_task(agent.run()) for agent in agents]
        services.append(asyncio.create_task(person.run()))
        services.append(asyncio.create_task(clock.run()))
        return await _until_done(coordinator, services, clock)


async def _until_done(
    coordinator: Coordinator, services: Sequence[asyncio.Task[None]], clock: SimClock
) -> Outcome:
    """Run the coordinator to its end; a service that fails meanwhile ends the run with its fault."""
    flight = asyncio.create_task(coordinator.run())
    everything: list[asyncio.Task[Any]] = [flight, *services]
    try:
        await asyncio.wait(everything, return_when=asyncio.FIRST_COMPLETED)
        for service in services:
            if service.done():
                service.result()
        outcome = await flight
        await clock.sleep(_LAST_WORDS_S)
        return outcome
    finally:
        for task in everything:
            task.cancel()
        await asyncio.gather(*everything, return_exceptions=True)


def _simulated_link(mission: Mission, robot: str, url: str, secret: bytes | None) -> VehicleLink:
    settings, ground = mission.vehicle(robot), mission.ground_station
    own = (ground.system_id, ground.component_id)
    key = None if secret is None else SigningKey(secret)
    assert settings.system_id is not None
    return VehicleLink(parse_link_url(url), settings.system_id, settings.component_id, key, own)


def any_free_port() -> str:
    """Return a Zenoh locator of this machine's own, on a port that is free now."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"
