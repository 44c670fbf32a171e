"""What an agent can have an autopilot do, each act verified by what the vehicle reports afterwards."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TypeAlias

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from malipp_field.clock import Clock
from malipp_field.errors import LinkError
from malipp_field.link.commands import CommandExchange
from malipp_field.link.compare import differences
from malipp_field.link.exchange import (
    DEFAULT_TIMEOUT_S,
    GROUND_COMPONENT,
    GROUND_SYSTEM,
    Exchange,
    MavMessage,
)
from malipp_field.link.heartbeats import Heartbeats
from malipp_field.link.mission_protocol import MissionClear, MissionDownload, MissionType, MissionUpload
from malipp_field.link.parameters import ParameterRead
from malipp_field.link.vehicle import HEARTBEAT_LOST_S, MODE_NUMBERS, Vehicle
from malipp_field.vehicle.items import MissionItem

TICK_S = 0.05
EFFECT_LIMIT_S = 10.0
"""How long the effect of an accepted command may take to show, on a link that loses most reports."""
READY_LIMIT_S = 120.0
"""How long to wait for a position estimate; about 40 s after boot is usual."""
VERIFY_ROUNDS = 2
"""Times a mission is uploaded when what is read back differs."""

OnProgress: TypeAlias = Callable[[str, int, int], None]
"""Told what is being done (``upload``, ``read back``), how many items are done, and how many there are."""


def _unseen(_what: str, _done: int, _total: int) -> None:
    pass


def _tell(on_progress: OnProgress, what: str, transfer: MissionUpload | MissionDownload) -> None:
    on_progress(what, *transfer.progress)


@dataclass(frozen=True)
class _UnderWay:
    """Whom an exchange keeps waiting: `over` is set when it has ended."""

    over: asyncio.Event
    on_tick: Callable[[], None]


class Driver:
    """Runs exchanges with one vehicle, and the acts that are made of them.

    Every act raises `LinkError` when the vehicle does not do it.

    Parameters
    ----------
    vehicle
        What the autopilot reports; somebody else feeds it.
    send
        Sends a message to it.
    clock
        All waiting is done on it.
    own
        System and component id as whom we speak.
    beats_alone
        Whether nobody else of ours sends heartbeats on this link.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        send: Callable[[MavMessage], None],
        clock: Clock,
        own: tuple[int, int] = (GROUND_SYSTEM, GROUND_COMPONENT),
        *,
        beats_alone: bool = True,
    ) -> None:
        self.vehicle = vehicle
        self.own = own
        self.heartbeats = Heartbeats(vehicle, own[0], alone=beats_alone)
        self.clock = clock
        self._send = send
        self._exchanges: dict[Exchange, _UnderWay] = {}

    def receive(self, message: MavMessage, now_s: float) -> None:
        """Hand a message of the link to the exchanges under way."""
        for exchange in list(self._exchanges):
            self._go_on(exchange, exchange.receive(message, now_s))

    def tick(self, now_s: float) -> None:
        """Let time pass for the exchanges under way."""
        for exchange, under_way in list(self._exchanges.items()):
            self._go_on(exchange, exchange.tick(now_s))
            under_way.on_tick()

    def _go_on(self, exchange: Exchange, messages: Sequence[MavMessage]) -> None:
        """Send what an exchange has to say, and wake whoever waits for its end."""
        self._send_all(messages)
        if exchange.ended:
            self._exchanges[exchange].over.set()

    def _send_all(self, messages: Sequence[MavMessage]) -> None:
        for message in messages:
            self._send(message)

    async def until(self, condition: Callable[[], bool], limit_s: float) -> bool:
        """Wait until a condition holds; return whether it did within the limit."""
        deadline_s = self.clock.now_s() + limit_s
        while not condition():
            if self.clock.now_s() >= deadline_s:
                return False
            await self.clock.sleep(TICK_S)
        return True

    async def run(self, exchange: Exchange, on_tick: Callable[[], None] = lambda: None) -> None:
        """Run an exchange to its end; cancelled, it sends nothing more."""
        under_way = self._exchanges[exchange] = _UnderWay(asyncio.Event(), on_tick)
        try:
            self._go_on(exchange, exchange.start(self.clock.now_s()))
            await under_way.over.wait()  # every exchange has limits of its own
            on_tick()
        finally:
            del self._exchanges[exchange]
        if exchange.failure is not None:
            raise LinkError(exchange.failure)

    async def hear(self) -> None:
        """Wait for heartbeats."""
        if not await self.until(lambda: self.vehicle.link_ok(self.clock.now_s()), HEARTBEAT_LOST_S):
            raise LinkError(f"vehicle {self.vehicle.address[0]} is not heard")

    async def hear_index(self) -> None:
        """Wait for two more MISSION_CURRENT: the first may have been under way before."""
        before = self.vehicle.mission_reports
        if not await self.until(lambda: self.vehicle.mission_reports >= before + 2, EFFECT_LIMIT_S):
            raise LinkError(f"vehicle {self.vehicle.address[0]} does not report its mission item")

    async def enter(self, mode: str) -> None:
        """Change the mode, and see it in a heartbeat."""
        custom = float(mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED)
        await self._command(mavlink.MAV_CMD_DO_SET_MODE, custom, float(MODE_NUMBERS[mode]))
        before = self.vehicle.heartbeats
        await self._see(lambda v: v.heartbeats > before and v.mode == mode, f"enter {mode}")

    async def hear_mode(self, mode: str) -> None:
        """Hear in a new heartbeat that the vehicle is in that mode."""
        before = self.vehicle.heartbeats
        if not await self.until(lambda: self.vehicle.heartbeats > before, EFFECT_LIMIT_S):
            raise LinkError(f"vehicle {self.vehicle.address[0]} is not heard")
        if self.vehicle.mode != mode:
            raise LinkError(f"vehicle {self.vehicle.address[0]} is in {self.vehicle.mode}, not in {mode}")

    async def arm(self) -> None:
        """Arm; see it in a heartbeat."""
        await self._command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)
        await self._see(lambda v: v.armed, "arm")

    async def disarm(self) -> None:
        """Disarm; see it in a heartbeat."""
        await self._command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0.0)
        await self._see(lambda v: not v.armed, "disarm")

    async def stand_at(self, seq: int, shown: int | None = None) -> None:
        """Make item ``seq`` current while the vehicle stands, so that it never moves on a stale index.

        The vehicle then reports ``shown``, where that is another (`Layout.shown_at`).

        In HOLD that is only allowed once AUTO has been entered; else AUTO is entered first,
        disarmed.
        """
        if not self.vehicle.armed:
            await self._wait_until_ready()
        if not self.vehicle.auto_entered:
            if self.vehicle.armed:
                await self.enter("HOLD")
                await self.disarm()
            await self.enter("AUTO")
        elif self.vehicle.mode != "HOLD":
            await self.enter("HOLD")
        await self.point_at(seq, shown)

    async def point_at(self, seq: int, last: int | None = None) -> None:
        """Make item ``seq`` current, whatever the vehicle is doing; in AUTO it turns to it at once.

        DO commands are never current: where ``seq`` is one, what follows it up to ``last`` will do.
        """
        await self._command(mavlink.MAV_CMD_DO_SET_MISSION_CURRENT, float(seq))
        before, ahead = self.vehicle.mission_reports, range(seq, (last or seq) + 1)
        await self._see(
            lambda v: v.mission_reports > before and v.current_seq in ahead, f"make item {seq} current"
        )

    async def launch(self) -> None:
        """Set the vehicle in motion at its current item: in AUTO, and armed."""
        if self.vehicle.mode != "AUTO":
            await self.enter("AUTO")
        if not self.vehicle.armed:
            await self.arm()

    async def leave(self, seq: int) -> None:
        """Have the vehicle go on from item ``seq``, at which it waits, to the next.

        The command is sent again only after fresh reports that it still waits there: a repeat that arrives
        when the vehicle has gone on would set it back.
        """
        system, component = self.vehicle.address
        deadline_s = self.clock.now_s() + 2 * EFFECT_LIMIT_S
        while not self._is_past(seq):
            if self.clock.now_s() >= deadline_s:
                raise LinkError(f"vehicle {system} does not leave item {seq}")
            self._send(
                mavlink.MAVLink_command_long_message(
                    system, component, mavlink.MAV_CMD_DO_SET_MISSION_CURRENT, 0, seq + 1, 0, 0, 0, 0, 0, 0
                )
            )
            if not await self.until(lambda: self._is_past(seq), DEFAULT_TIMEOUT_S):
                await self.hear_index()

    def _is_past(self, seq: int) -> bool:
        return self.vehicle.current_seq is not None and self.vehicle.current_seq > seq

    async def install(self, items: Sequence[MissionItem]) -> None:
        """Put a mission on the vehicle, read it back, and compare; the vehicle must not be driving.

        An upload is not atomic. When it fails, what is left on board is removed as far as the link allows.
        """
        try:
            await self.put(items)
        except LinkError:
            await self._clear_quietly()
            raise

    async def put(
        self,
        items: Sequence[MissionItem],
        mission_type: MissionType = MissionType.MISSION,
        on_progress: OnProgress = _unseen,
    ) -> None:
        """Put a mission, a fence or rally points on the vehicle, read them back, and compare.

        When it fails, or is cancelled, what is on board is not known, and may be a mixture.
        """
        mission = mission_type is MissionType.MISSION
        for _ in range(VERIFY_ROUNDS):
            if len(items) > mission:
                upload = MissionUpload(items, *self.vehicle.address, *self.own, mission_type)
                await self.run(upload, partial(_tell, on_progress, "upload", upload))
            else:  # nothing to do; ArduPilot makes two items of home alone
                await self.run(MissionClear(*self.vehicle.address, *self.own, mission_type))
            there = await self.download(mission_type, on_progress)
            found = differences(items, there, home=mission)
            if not found:
                return
        raise LinkError(f"what was read back is not the {mission_type.word} sent: {'; '.join(found)}")

    async def download(
        self, mission_type: MissionType = MissionType.MISSION, on_progress: OnProgress = _unseen
    ) -> list[MissionItem]:
        """Read what is on the vehicle."""
        download = MissionDownload(*self.vehicle.address, *self.own, mission_type)
        await self.run(download, partial(_tell, on_progress, "read back", download))
        return download.items

    async def parameters(self, *names: Sequence[str]) -> list[float]:
        """Read parameters at once, each by all its names."""
        reads = [ParameterRead(each, *self.vehicle.address, *self.own) for each in names]
        try:
            async with asyncio.TaskGroup() as group:
                for read in reads:
                    group.create_task(self.run(read))
        except* LinkError as faults:
            raise LinkError(str(faults.exceptions[0])) from None
        return [read.value for read in reads]

    async def _clear_quietly(self) -> None:
        if not self.vehicle.link_ok(self.clock.now_s()):
            return
        try:
            await self.run(MissionClear(*self.vehicle.address, *self.own))
        except LinkError:
            return  # the failure that led here is the one to report

    async def _wait_until_ready(self) -> None:
        if not await self.until(lambda: self.vehicle.ready_to_arm, READY_LIMIT_S):
            raise LinkError(f"vehicle {self.vehicle.address[0]} is not ready to arm: no position estimate")

    async def _command(self, command: int, *params: float) -> None:
        await self.run(CommandExchange(command, params, *self.vehicle.address, *self.own))

    async def _see(self, effect: Callable[[Vehicle], bool], what: str) -> None:
        if not await self.until(lambda: effect(self.vehicle), EFFECT_LIMIT_S):
            raise LinkError(f"vehicle {self.vehicle.address[0]} accepted to {what}, but did not")
