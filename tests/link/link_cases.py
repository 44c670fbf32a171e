"""A bad link on a virtual clock, a vehicle of our own making, and small missions."""

from __future__ import annotations

import heapq
import itertools
import random
from collections.abc import Callable
from typing import Any, Protocol

from hypothesis import settings
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from malipp_field.link.exchange import GROUND_COMPONENT, GROUND_SYSTEM, Exchange
from malipp_field.sim.mission_store import MissionStore, Sender
from malipp_field.vehicle.items import MissionItem
from malipp_field.vehicle.layout import lay_out
from malipp_field.vehicle.steps import Action, GeoPoint, Step, VehicleMission

UNHURRIED = settings(deadline=None)
"""For properties: the machine may be busy with other things."""

SYSTEM = 7
STEP_S = 0.05
GROUND = Sender(GROUND_SYSTEM, GROUND_COMPONENT)
HOME = GeoPoint(lat_deg=34.0, lon_deg=-118.0)


def point(number: int) -> GeoPoint:
    return GeoPoint(lat_deg=34.0 + number * 1e-4, lon_deg=-118.0 - number * 1e-4)


def step(action: Action, number: int, tag: int = 0, uid: str | None = None) -> Step:
    return Step(
        uid=uid or f"{action}/{number}/{tag}", action=action, node=f"n{number}", stop=number,
        place=point(number), tags=(tag,) if tag else (),
    )  # fmt: skip


def drives(count: int, version: int = 1, robot: str = "scout", first: int = 1) -> VehicleMission:
    steps = tuple(step(Action.DRIVE, number) for number in range(first, first + count))
    return VehicleMission(robot=robot, version=version, home=HOME, steps=steps)


def mission_items(count: int) -> list[MissionItem]:
    """Home, then drives and collects in turn; ``count`` items with home."""
    steps = [step(Action.COLLECT if n % 2 else Action.DRIVE, n, n % 2 * n) for n in range(count - 1)]
    return lay_out(VehicleMission(robot="scout", version=1, home=HOME, steps=tuple(steps))).items


def framed(message: Any, system: int = SYSTEM, component: int = 1) -> Any:
    """Return a message as it comes out at the other end of a wire."""
    data = message.pack(mavlink.MAVLink(None, srcSystem=system, srcComponent=component))
    return mavlink.MAVLink(None).decode(bytearray(data))


def from_ground(message: Any) -> Any:
    return framed(message, GROUND_SYSTEM, GROUND_COMPONENT)


class MissionVehicle(Protocol):
    """The mission protocol of some vehicle."""

    items: list[MissionItem]

    def receive(self, message: Any, sender: Sender, now_s: float) -> list[Any]: ...

    def poll(self, now_s: float) -> list[Any]: ...


def ardupilot() -> MissionStore:
    return MissionStore(home=lambda: MissionItem(0, 0, 16, 0, 1, 0, 0, 0, 0, 340000000, -1180000000, 0))


class SpecVehicle:
    """The mission protocol as its specification has it, written without a look at the simulator.

    Unlike ArduPilot it asks with MISSION_REQUEST_INT, puts a mission in place only when it is complete, and
    says INVALID_SEQUENCE to whatever it does not expect. `refuse` maps item numbers to results.
    """

    def __init__(self, refuse: dict[int, int] | None = None) -> None:
        self.items: list[MissionItem] = []
        self.refuse = refuse or {}
        self._incoming: list[MissionItem] = []
        self._expected: int | None = None
        self._heard_s = self._asked_s = 0.0

    def receive(self, message: Any, sender: Sender, now_s: float) -> list[Any]:
        kind = message.get_type()
        if kind == "MISSION_COUNT":
            self._expected, self._incoming, self._heard_s = message.count, [], now_s
            return self._next(now_s)
        if kind == "MISSION_ITEM_INT":
            return self._item(message, now_s)
        if kind == "MISSION_REQUEST_LIST":
            return [mavlink.MAVLink_mission_count_message(*ids(), len(self.items))]
        if kind == "MISSION_REQUEST_INT" and message.seq < len(self.items):
            return [mavlink.MAVLink_mission_item_int_message(*ids(), *self.items[message.seq])]
        if kind == "MISSION_CLEAR_ALL":
            self.items = []
            return [ack(mavlink.MAV_MISSION_ACCEPTED)]
        return []

    def poll(self, now_s: float) -> list[Any]:
        if self._expected is None:
            return []
        if now_s - self._heard_s > 8.0:
            self._expected = None
            return [ack(mavlink.MAV_MISSION_OPERATION_CANCELLED)]
        return self._next(now_s) if now_s - self._asked_s > 1.0 else []

    def _item(self, message: Any, now_s: float) -> list[Any]:
        if self._expected is None or message.seq != len(self._incoming):
            return [ack(mavlink.MAV_MISSION_INVALID_SEQUENCE)]
        if message.seq in self.refuse:
            self._expected = None
            return [ack(self.refuse[message.seq])]
        self._heard_s = now_s
        self._incoming.append(MissionItem(*(getattr(message, name) for name in MissionItem._fields)))
        return self._next(now_s)

    def _next(self, now_s: float) -> list[Any]:
        self._asked_s = now_s
        if len(self._incoming) == self._expected:
            self.items, self._expected = self._incoming, None
            return [ack(mavlink.MAV_MISSION_ACCEPTED)]
        return [mavlink.MAVLink_mission_request_int_message(*ids(), len(self._incoming))]


def ids() -> tuple[int, int]:
    return GROUND_SYSTEM, GROUND_COMPONENT


def ack(result: int, to: tuple[int, int] = (GROUND_SYSTEM, GROUND_COMPONENT)) -> Any:
    return mavlink.MAVLink_mission_ack_message(*to, result)


class Wire:
    """Delivers messages late, twice, out of order, or not at all."""

    def __init__(self, seed: int, loss: float, bad: bool = True, late_s: float = 0.01) -> None:
        self._random = random.Random(seed)
        self._loss, self._bad, self._late_s = loss, bad, late_s
        self._flying: list[tuple[float, int, Any]] = []
        self._order = itertools.count()

    def put(self, message: Any, now_s: float) -> None:
        copies = 1 + (self._bad and self._random.random() < 0.1)
        for _ in range(copies):
            if self._random.random() >= self._loss:
                heapq.heappush(self._flying, (now_s + self._delay_s(), next(self._order), message))

    def _delay_s(self) -> float:
        if not self._bad:
            return self._late_s
        late = self._random.random() < 0.03
        return self._random.uniform(0.5, 3.0) if late else self._random.uniform(0.005, 0.15)

    def arrived(self, now_s: float) -> list[Any]:
        messages = []
        while self._flying and self._flying[0][0] <= now_s:
            messages.append(heapq.heappop(self._flying)[2])
        return messages


def converse(
    exchange: Exchange,
    vehicle: MissionVehicle,
    *,
    seed: int = 0,
    loss: float = 0.0,
    bad: bool = True,
    cut_after: int | None = None,
    meanwhile: Callable[[float], None] = lambda now_s: None,
    start_s: float = 100.0,
    limit_s: float = 900.0,
    late_s: float = 0.01,
) -> float:
    """Run an exchange to its end over a bad link; return how long it took in simulated seconds.

    `cut_after`: from that message of the ground on, nothing gets through either way. `late_s`: what a message
    takes where the link is not bad.
    """
    up, down = Wire(seed, loss, bad, late_s), Wire(seed + 1_000_000, loss, bad, late_s)
    sent, now_s = 0, start_s

    def send(messages: list[Any]) -> None:
        nonlocal sent
        for message in messages:
            if cut_after is None or sent < cut_after:
                up.put(from_ground(message), now_s)
            sent += 1

    send(exchange.start(now_s))
    while not exchange.ended:
        now_s += STEP_S
        assert now_s < start_s + limit_s, "it does not end"
        meanwhile(now_s)
        answers = vehicle.poll(now_s)
        for message in up.arrived(now_s):
            answers += vehicle.receive(message, GROUND, now_s)
        for message in answers:
            down.put(framed(message), now_s)
        for message in down.arrived(now_s) if cut_after is None or sent < cut_after else []:
            send(exchange.receive(message, now_s))
        send(exchange.tick(now_s))
    return now_s - start_s
