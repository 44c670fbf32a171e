"""The agent of one vehicle: orders come in by the bus, what the vehicle does goes out by it."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Awaitable, Callable
from functools import partial
from typing import Protocol, TypeVar

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from malipp_field.bus.messages import (
    Command,
    Confirm,
    Hold,
    Load,
    Message,
    Order,
    Reply,
    presence_key,
    vehicle_key,
)
from malipp_field.clock import Clock
from malipp_field.errors import LinkError
from malipp_field.link.channels import OnEvent, OnMessage, VehicleLink
from malipp_field.link.confirmations import ConfirmationInbox
from malipp_field.link.driver import TICK_S, Driver
from malipp_field.link.exchange import MavMessage
from malipp_field.link.mission_watch import MissionWatch
from malipp_field.link.orders import Orders
from malipp_field.link.outputs import refused_channel
from malipp_field.link.progress import Progress
from malipp_field.link.reports import Publishes, Reports
from malipp_field.link.vehicle import STREAM_MESSAGES, Vehicle
from malipp_field.vehicle.payload_protocol import PayloadReport, ack_name, parse_confirmation
from malipp_field.vehicle.steps import Step

HEARTBEAT_S = 1.0
TELEMETRY_S = 0.2
STREAM_REQUEST_S = 5.0

STREAMS_HZ = {
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 5.0,
    mavlink.MAVLINK_MSG_ID_MISSION_CURRENT: 5.0,
    mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT: 1.0,
    mavlink.MAVLINK_MSG_ID_BATTERY_STATUS: 1.0,
    mavlink.MAVLINK_MSG_ID_SYSTEM_TIME: 0.5,
}
"""Messages an ArduPilot does not send, or seldom, unless it is asked for them."""

MessageT = TypeVar("MessageT", bound=Message)
log = logging.getLogger(__name__)


class AgentBus(Publishes, Protocol):
    """What an agent needs of the bus."""

    async def serve(
        self, key: str, kind: type[MessageT], handler: Callable[[MessageT], Awaitable[Reply]]
    ) -> None:
        """Answer requests on ``key``."""
        ...

    async def present(self, key: str) -> None:
        """Show presence under ``key``."""
        ...


class Connection(Protocol):
    """What an agent needs of the channel to its vehicle."""

    def send(self, message: MavMessage) -> None:
        """Send a message."""
        ...

    def close(self) -> None:
        """Close the channel."""
        ...


class OpenLinks(Protocol):
    """What an agent needs of `Links`."""

    async def open(
        self, where: VehicleLink, on_message: OnMessage, on_event: OnEvent, skip: frozenset[int]
    ) -> Connection:
        """Open the channel of a vehicle; see `Links.open`."""
        ...


class Agent:
    """One vehicle's link to the team.

    Parameters
    ----------
    mission_name
        First part of all keys.
    robot
        Whose agent this is.
    where
        How the vehicle is reached.
    links
        Opens the channel to it; vehicles on one radio share their `Links`.
    bus
        Where it talks to the team.
    clock
        All waiting and all times are of this clock.
    """

    def __init__(
        self,
        mission_name: str,
        robot: str,
        where: VehicleLink,
        links: OpenLinks,
        bus: AgentBus,
        clock: Clock,
    ) -> None:
        self._mission_name, self._robot, self._where = mission_name, robot, where
        self._links, self._bus, self._clock = links, bus, clock
        self._connection: Connection | None = None
        self.vehicle = Vehicle(where.system_id, where.component_id)
        self.progress = Progress()
        self._driver = Driver(self.vehicle, self._send, clock, where.own, beats_alone=not where.shared)
        self._inbox = ConfirmationInbox()
        self._watch = MissionWatch(where.own)
        self._reports = Reports(mission_name, robot, bus, clock)
        self._orders = Orders(
            robot, self._driver, self.progress, self._person_says, partial(self._reports.event, "warning")
        )
        self._emergency: asyncio.Task[None] | None = None
        self._began_s = clock.now_s()
        self._link_ok = False
        self._due_s = {"heartbeat": 0.0, "telemetry": 0.0, "streams": 0.0}
        self._streams_unheard: set[int] = set()
        self._turn = asyncio.Lock()
        self._holds = 0
        self._order: asyncio.Task[str] | None = None
        self._loading = False

    async def run(self) -> None:
        """Serve until cancelled.

        Raises
        ------
        LinkError
            When the link cannot be opened; one that breaks later is opened again.
        """
        unheeded = STREAM_MESSAGES - self.vehicle.heeded
        self._connection = await self._links.open(self._where, self._heard, self._reports.event, unheeded)
        try:
            await self._bus.serve(
                vehicle_key(self._mission_name, self._robot, "command"), Command, self._answer
            )
            await self._bus.present(presence_key(self._mission_name, self._robot))
            while True:
                self._tick(self._clock.now_s())
                await self._clock.sleep(TICK_S)
        finally:
            for task in (self._order, self._emergency):
                if task is not None:
                    task.cancel()
            self._connection.close()

    # The loop: what is due, and what arrives.

    def _send(self, message: MavMessage) -> None:
        if self._connection is not None:
            self._connection.send(message)

    def _tick(self, now_s: float) -> None:
        if self._driver.heartbeats.allowed(now_s) and self._due("heartbeat", HEARTBEAT_S, now_s):
            self._send(
                mavlink.MAVLink_heartbeat_message(
                    mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, mavlink.MAV_STATE_ACTIVE, 3
                )
            )
        self._watch_link(now_s)
        if self._link_ok and self._streams_unheard and self._due("streams", STREAM_REQUEST_S, now_s):
            self._request_streams()
        self._driver.tick(now_s)
        if self.vehicle.lat_deg is not None and self._due("telemetry", TELEMETRY_S, now_s):
            self._reports.telemetry(self.vehicle, self.progress, link_ok=self._link_ok)

    def _due(self, what: str, interval_s: float, now_s: float) -> bool:
        due_s = self._due_s[what]
        if now_s < due_s:
            return False
        # On its beat, so that ticks that come late do not slow the rate; after a gap it begins anew.
        self._due_s[what] = (due_s if now_s - due_s < interval_s else now_s) + interval_s
        return True

    def _watch_link(self, now_s: float) -> None:
        link_ok = self.vehicle.link_ok(now_s)
        if link_ok == self._link_ok:
            return
        self._link_ok = link_ok
        if link_ok:
            self._streams_unheard, self._due_s["streams"] = set(STREAMS_HZ), now_s
            self._reports.event("info", "link: the vehicle is heard")
        else:
            self._reports.event("error", "link: the vehicle is not heard any more")

    def _request_streams(self) -> None:
        for message_id in self._streams_unheard:
            interval_us = 1e6 / STREAMS_HZ[message_id]
            self._send(
                mavlink.MAVLink_command_long_message(
                    *self.vehicle.address, mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, 0,
                    message_id, interval_us, 0, 0, 0, 0, 0,
                )
            )  # fmt: skip

    def _heard(self, message: MavMessage) -> None:
        now_s = self._clock.now_s()
        self._driver.heartbeats.overhear(message, now_s)
        if not self.vehicle.receive(message, now_s):
            return
        kind = message.get_msgId()
        self._streams_unheard.discard(kind)
        suspicion = self._watch.suspicion(message, self.progress.mission, now_s)
        if suspicion is not None:
            self._distrust(suspicion)
        if kind == mavlink.MAVLINK_MSG_ID_MISSION_CURRENT and not self._watch.doubts:
            for step in self.progress.report(message.seq, self.vehicle.mission_complete):
                self._passed(step)
        elif kind == mavlink.MAVLINK_MSG_ID_STATUSTEXT:
            self._text(message.severity, message.text)
        self._driver.receive(message, now_s)

    def _distrust(self, why: str) -> None:
        """Take the mission on board for unknown; a vehicle under way must not come to what is not ours."""
        self.progress.forget()
        self._reports.event(
            "error", f"somebody else changes the mission on board: {why}; it is not started any more"
        )
        self._emergency = asyncio.create_task(self._hold_unless_loaded())

    async def _hold_unless_loaded(self) -> None:
        """Hold a vehicle without a verified mission; a load under way does it and may put it right."""
        if self._loading:
            async with self._turn:
                pass
        driving = self.vehicle.armed and self.vehicle.mode == "AUTO"
        if self.progress.mission is None and (driving or self._order is not None):
            hold = Hold(reason="its mission is not the verified one")
            await self._answer(Command(time_s=self._clock.now_s(), order=hold))

    def _text(self, severity: int, text: str) -> None:
        report = parse_confirmation(text)
        channel = refused_channel(text)
        if report is not None:
            self._confirmed(report)
        elif channel is not None:  # said as if it were nothing, and the vehicle goes on
            self.progress.refuse(channel)
            self._reports.event("error", text)
        elif severity <= mavlink.MAV_SEVERITY_ERROR:
            self._reports.event("error", text)
        elif severity <= mavlink.MAV_SEVERITY_WARNING:
            self._reports.event("warning", text)

    def _confirmed(self, report: PayloadReport) -> None:
        """Publish confirmations in order, then acknowledge; what was not published will be repeated."""
        if not self.progress.known:
            return  # no step to tie it to yet
        self._inbox.put(report, self._clock.now_s())
        while (following := self._inbox.next()) is not None:
            self._script_says(following)
            self._inbox.accept()
        boot_ms = int((self._clock.now_s() - self._began_s) * 1000.0) % 2**32
        name = ack_name(self.vehicle.address[0]).encode()
        self._send(mavlink.MAVLink_named_value_int_message(boot_ms, name, self._inbox.heard))

    def _script_says(self, report: PayloadReport) -> None:
        if self.progress.precedes(report):
            what = f"{report.action} of container {report.tag}, {report.result}"
            self._reports.event("warning", f"a confirmation of an earlier mission: {what}")
            return
        step = self.progress.step_of(report)
        if step is not None and step.uid in self.progress.done:
            return  # begun anew after a hold: the script says once more what it has done already
        if step is None:
            self._reports.event(
                "error", f"no mission has a step '{report.action} {report.tag}', which was confirmed"
            )
        goes_on = step is not None and report.result == "missing" and step.if_missing == "go_on"
        self._reports.script_said(step, report, goes_on=goes_on)
        if step is not None and (report.ok or goes_on):
            self.progress.settle(step)
        elif step is not None:
            self.progress.failed[step.uid] = report.result

    def _passed(self, step: Step) -> None:
        self._reports.passed(step)
        self.progress.settle(step)

    def _person_says(self, step: Step, word: Confirm) -> None:
        self._reports.person_said(step, word)
        self.progress.settle(step)

    # Orders: one at a time, but a hold goes before all others.

    async def _answer(self, command: Command) -> Reply:
        order = command.order
        if isinstance(order, Hold):
            self._holds += 1
            if self._order is not None:
                self._order.cancel()
        holds = self._holds
        async with self._turn:
            if holds != self._holds and not isinstance(order, Hold):
                return self._reply(ok=False, text="not done: the vehicle was ordered to hold")
            return await self._carry_out(order)

    async def _carry_out(self, order: Order) -> Reply:
        task = asyncio.create_task(self._orders.carry_out(order))
        self._order = None if isinstance(order, Hold) else task
        self._loading = isinstance(order, Load)
        try:
            text = await task
        except LinkError as fault:
            self._reports.event("warning", f"{order.do} was not done: {fault}")
            return self._reply(ok=False, text=str(fault))
        except asyncio.CancelledError:
            task.cancel()
            if self._broken_off(task):
                return self._reply(ok=False, text="broken off by a hold, or by the end of the agent")
            raise
        finally:
            self._order, self._loading = None, False
        if isinstance(order, Hold):
            self._reports.event("info", f"holding: {order.reason}")
        return self._reply(ok=True, text=text)

    def _reply(self, *, ok: bool, text: str) -> Reply:
        return Reply(time_s=self._clock.now_s(), ok=ok, text=text)

    @staticmethod
    def _broken_off(task: asyncio.Task[str]) -> bool:
        """Whether the order was cancelled, and not whoever waits for its answer."""
        asker = asyncio.current_task()
        return task.cancelled() and (asker is None or not asker.cancelling())
