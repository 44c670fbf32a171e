"""The other processes of `link.py`: rovers with poor links to them, vehicles that speak, and their agents."""

from __future__ import annotations

import argparse
import asyncio
import heapq
import itertools
import json
import random
import socket
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from malipp_field.bus import Bus, Telemetry
from malipp_field.clock import WallClock
from malipp_field.link import Agent, Links, VehicleLink
from malipp_field.link import agent as agents
from malipp_field.link.driver import TICK_S
from malipp_field.mission import Mission, parse_mission
from malipp_field.mission.link_url import parse_link_url
from malipp_field.sim import Fleet, RoverConfig

HOST = "127.0.0.1"
FOUND_WITHIN_S = 60.0
SETTLED_S = 5.0
"""Then streams have been asked for, and rates are steady."""
RECENT_S = 5.0

SITE = """
format: malipp-mission/1
name: link
site:
  nodes: [{{id: base, x_m: 0, y_m: 0, role: depot}}, {{id: a, x_m: 50, y_m: 0}}]
  complete: true
field:
  kernel: {{family: rbf, length_scale_m: 9.0}}
  test_points: [{{x_m: 9, y_m: 0}}]
team: {{sample_mass_kg: 1.0, robots: [{robots}]}}
"""
ROBOT = (
    "{{id: r{n}, start: base, depots: [base], empty_mass_kg: 9, energy_budget_j: 9000, payload_capacity: 2,"
    " samples_per_node: 1, noise_variance: 0.1, energy_per_kg_m: 1, speed_m_s: 1}}"
)

# What an ArduPilot Rover sends of its own accord on a telemetry port, by its SRx_ groups, in Hz.
EXTRA, STATUS, SLOW = 4.0, 2.0, 1.0
DEFAULT_RATES_HZ: dict[str, float] = {
    "heartbeat": SLOW,
    "attitude": EXTRA, "vfr_hud": EXTRA, "ahrs": EXTRA, "ahrs2": EXTRA,
    "sys_status": STATUS, "power_status": STATUS, "meminfo": STATUS, "gps_raw_int": STATUS,
    "nav_controller_output": STATUS, "mission_current": STATUS, "global_position_int": STATUS,
    "local_position_ned": STATUS, "raw_imu": STATUS, "scaled_imu2": STATUS, "scaled_pressure": STATUS,
    "servo_output_raw": STATUS, "rc_channels": STATUS, "system_time": STATUS, "battery_status": STATUS,
    "ekf_status_report": STATUS, "vibration": STATUS,
}  # fmt: skip
ASKED_HZ = {"global_position_int": 5.0, "mission_current": 5.0}
"""What the agent asks for; the rest of what it asks for comes as often anyway."""


def all_at(hz: float) -> dict[str, float]:
    """Return the rates when every stream is set to ``hz``; heartbeats stay at 1 Hz."""
    return dict.fromkeys(DEFAULT_RATES_HZ, hz) | {"heartbeat": SLOW}


@dataclass(frozen=True)
class Load:
    """What an agent hears, and how often it says where its vehicle is."""

    name: str
    rates_hz: dict[str, float]
    telemetry_hz: float


LOADS = {
    load.name: load
    for load in (
        Load("default", DEFAULT_RATES_HZ | ASKED_HZ, 5.0),
        Load(
            "10-hz",
            DEFAULT_RATES_HZ
            | dict.fromkeys(("global_position_int", "mission_current", "attitude", "vfr_hud"), 10.0),
            10.0,
        ),
        Load("all-10-hz", all_at(10.0), 10.0),
    )
}


# Rovers.


async def run_rovers(options: argparse.Namespace) -> None:
    """Run simulated rovers, each also behind a late and a poor link (the role of a child)."""
    count = 2 * options.slow_repeats
    clock = WallClock()
    async with Fleet(_mission(count), clock, config=RoverConfig(ready_after_s=0.0)) as fleet:
        ports = {}
        for n, (robot, (_, port)) in enumerate(fleet.endpoints.items()):
            late, poor = (Relay(port, loss, options.delay, seed=n // 2) for loss in (0.0, options.loss))
            ports[robot] = {"loopback": port, "late": await late.open(), "poor": await poor.open()}
        print(json.dumps(ports), flush=True)
        stall = Stall()
        watch = asyncio.create_task(stall.watch())
        while await asyncio.to_thread(sys.stdin.readline):
            print(json.dumps(stall.longest_s), flush=True)
            stall.longest_s = 0.0
        watch.cancel()


class Stall:
    """The longest that somebody whose turn it was had to wait in the event loop."""

    def __init__(self) -> None:
        self.longest_s = 0.0

    async def watch(self) -> None:
        """Look at it, for ever."""
        while True:
            asked_s = time.perf_counter()
            await asyncio.sleep(TICK_S)
            self.longest_s = max(self.longest_s, time.perf_counter() - asked_s - TICK_S)


def _mission(robots: int) -> Mission:
    return parse_mission(SITE.format(robots=", ".join(ROBOT.format(n=n) for n in range(robots))))


class Relay:
    """A poor link on UDP to one address: what goes either way is late, and some of it is lost.

    The n-th datagram of a way is lost or not whoever sends it.
    """

    def __init__(self, port: int, loss: float, delay_s: float, seed: int) -> None:
        self._port, self._loss, self._delay_s = port, loss, delay_s
        self._chances = [random.Random(2 * seed + way) for way in range(2)]  # noqa: S311
        self._client: Any = None

    async def open(self) -> int:
        """Open both ends; return the port of the near one."""
        loop = asyncio.get_running_loop()
        near, _ = await loop.create_datagram_endpoint(lambda: _End(self._out), local_addr=(HOST, 0))
        far, _ = await loop.create_datagram_endpoint(lambda: _End(self._back), remote_addr=(HOST, self._port))
        self._near, self._far = near, far
        return int(near.get_extra_info("sockname")[1])

    def _out(self, data: bytes, addr: Any) -> None:
        self._client = addr
        self._later(0, lambda: self._far.sendto(data))

    def _back(self, data: bytes, _addr: Any) -> None:
        self._later(1, lambda: self._near.sendto(data, self._client))

    def _later(self, way: int, send: Callable[[], None]) -> None:
        if self._chances[way].random() >= self._loss:
            asyncio.get_running_loop().call_later(self._delay_s, send)


class _End(asyncio.DatagramProtocol):
    def __init__(self, received: Callable[[bytes, Any], None]) -> None:
        self.datagram_received = received  # type: ignore[method-assign]


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind((HOST, 0))
        return int(probe.getsockname()[1])


# Agents, and the vehicles they hear.


class CountingLinks(Links):
    """Links that know how much was heard."""

    def __init__(self, clock: WallClock) -> None:
        super().__init__(clock)
        self._opened: list[Any] = []

    async def open(self, *arguments: Any, **named: Any) -> Any:
        """Open a channel, and keep it to be asked."""
        self._opened.append(await super().open(*arguments, **named))
        return self._opened[-1]

    @property
    def heard(self) -> int:
        """Frames that came for any vehicle, wanted or not."""
        return sum(channel.heard + channel.skipped for channel in self._opened)


async def run_agents(options: argparse.Namespace) -> None:
    """Run agents and print what they take (the role of a child)."""
    clock = WallClock()
    agents.TELEMETRY_S = 1.0 / LOADS[options.load].telemetry_hz
    async with (
        Bus(connect=(options.hub,)) as bus,
        CountingLinks(clock) as links,
        asyncio.TaskGroup() as tasks,
    ):
        where = [
            VehicleLink(parse_link_url(f"udpout:{HOST}:{port}"), n) for n, port in enumerate(options.ports, 1)
        ]
        team = [Agent("link", f"r{at.system_id}", at, links, bus, clock) for at in where]
        services = [tasks.create_task(agent.run()) for agent in team]
        async with asyncio.timeout(FOUND_WITHIN_S):
            while not all(agent.vehicle.link_ok(clock.now_s()) for agent in team):  # noqa: ASYNC110 - no event
                await asyncio.sleep(0.1)
        await asyncio.sleep(SETTLED_S)
        print(json.dumps(await _measured(links, len(team), options.seconds)), flush=True)
        await asyncio.to_thread(sys.stdin.read)  # go on until the team has been asked, too
        for service in services:
            service.cancel()


async def _measured(links: CountingLinks, vehicles: int, seconds: float) -> dict[str, float]:
    stall = Stall()
    watch = asyncio.create_task(stall.watch())
    began_s, processor_s, heard = time.perf_counter(), time.process_time(), links.heard
    await asyncio.sleep(seconds)
    wall_s, processor_s = time.perf_counter() - began_s, time.process_time() - processor_s
    watch.cancel()
    return {
        "wall_s": wall_s,
        "processor_s": processor_s,
        "heard_hz": (links.heard - heard) / wall_s / vehicles,
        "late_s": stall.longest_s,
    }


async def run_team(options: argparse.Namespace) -> None:
    """Speak as many vehicles, and hear what their agents tell the bus (the role of a child)."""
    hub, vehicles = f"tcp/{HOST}:{_free_port()}", options.vehicles[0]
    async with Bus(listen=hub) as bus:
        heard_s: list[float] = []
        await bus.subscribe(
            "malipp/link/vehicle/*/telemetry", Telemetry, lambda *_: heard_s.append(time.time())
        )
        speakers = [_Speaker(system_id) for system_id in range(1, vehicles + 1)]
        speaking = asyncio.create_task(_speak(speakers, LOADS[options.load]))
        print(json.dumps({"hub": hub, "ports": [speaker.port for speaker in speakers]}), flush=True)
        await asyncio.to_thread(sys.stdin.readline)
        recent = [at_s for at_s in heard_s if at_s > heard_s[-1] - RECENT_S]
        print(json.dumps({"told_hz": len(recent) / RECENT_S / vehicles}), flush=True)
        speaking.cancel()


class _Speaker:
    """One vehicle, which sends to whoever has spoken to it, a frame a datagram."""

    def __init__(self, system_id: int) -> None:
        self.packer = mavlink.MAVLink(None, srcSystem=system_id, srcComponent=1)
        self._socket = socket.socket(type=socket.SOCK_DGRAM)
        self._socket.bind((HOST, 0))
        self._socket.setblocking(False)
        self.port: int = self._socket.getsockname()[1]
        self._to: Any = None
        asyncio.get_running_loop().add_reader(self._socket, self._heard)

    def _heard(self) -> None:
        self._to = self._socket.recvfrom(1024)[1]

    def send(self, frame: bytes) -> None:
        """Send a frame, once there is somebody to send it to."""
        if self._to is not None:
            self._socket.sendto(frame, self._to)


async def _speak(speakers: list[_Speaker], load: Load) -> None:
    """Send every stream of every vehicle on its beat, for ever; no two beat together."""
    chance, began_s = random.Random(0), time.perf_counter()  # noqa: S311
    beats = [
        (began_s + chance.random() / hz, n, 1.0 / hz, speaker, sample(name).pack(speaker.packer))
        for n, (speaker, (name, hz)) in enumerate(itertools.product(speakers, load.rates_hz.items()))
    ]
    heapq.heapify(beats)
    while True:
        now_s = time.perf_counter()
        while beats[0][0] <= now_s:
            due_s, n, every_s, speaker, frame = beats[0]
            speaker.send(frame)
            # What a busy machine does not let us send in time is not made up for, and shows as not heard.
            heapq.heapreplace(
                beats,
                (due_s + every_s if due_s + every_s > now_s else now_s + every_s, n, every_s, speaker, frame),
            )
        await asyncio.sleep(0.005)


def sample(name: str) -> Any:
    """Return a message without zeros, which MAVLink 2 would leave out at the end."""
    kind = getattr(mavlink, f"MAVLink_{name}_message")
    lengths = dict(zip(kind.ordered_fieldnames, kind.array_lengths, strict=True))
    return kind(*([1] * lengths[field] if lengths[field] else 1 for field in kind.fieldnames))


ROLES = {"rovers": run_rovers, "team": run_team, "agents": run_agents}
