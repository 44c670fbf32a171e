"""One vehicle in reach of a command: its link, kept alive while the context lasts."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Awaitable, Callable
from types import TracebackType
from typing import Protocol, TypeAlias

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from malipp_field.clock import Clock
from malipp_field.link.driver import TICK_S, Driver
from malipp_field.link.exchange import GROUND_COMPONENT, GROUND_SYSTEM, MavMessage
from malipp_field.link.vehicle import Vehicle

HEARTBEAT_S = 1.0
STREAM_REQUEST_S = 5.0
_STREAMS_US = {
    mavlink.MAVLINK_MSG_ID_MISSION_CURRENT: 5e5,
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 1e6,
    mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT: 1e6,
    mavlink.MAVLINK_MSG_ID_SYSTEM_TIME: 1e6,
}


class Channel(Protocol):
    """What a contact needs of a link."""

    def send(self, message: MavMessage) -> None:
        """Send a message."""
        ...

    def close(self) -> None:
        """Close the link."""
        ...


OpenChannel: TypeAlias = Callable[[Callable[[MavMessage], None]], Awaitable[Channel]]
"""Opens a link; it is given what is to be called with every message that arrives."""


class Contact:
    """A vehicle and its driver, at work while the context lasts.

    Parameters
    ----------
    address
        The vehicle's system and component id.
    open_channel
        Opens its link.
    clock
        All waiting is done on it.
    own
        System and component id as whom we speak.
    only_looks
        Send no heartbeats. A vehicle that has heard some counts on more: left without, its ground station
        failsafe would stop it for nothing but having been looked at.

    Attributes
    ----------
    driver : Driver
        What the vehicle can be made to do.
    """

    def __init__(
        self,
        address: tuple[int, int],
        open_channel: OpenChannel,
        clock: Clock,
        own: tuple[int, int] = (GROUND_SYSTEM, GROUND_COMPONENT),
        *,
        only_looks: bool = False,
    ) -> None:
        self.driver = Driver(Vehicle(*address), self._send, clock, own)
        self._open_channel, self._clock, self._only_looks = open_channel, clock, only_looks
        self._channel: Channel | None = None
        self._work: asyncio.Task[None] | None = None
        self._beat_due_s = self._request_due_s = 0.0
        self._unheard = set(_STREAMS_US)

    async def __aenter__(self) -> Contact:
        self._channel = await self._open_channel(self._heard)
        self._work = asyncio.create_task(self._live())
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, fault: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._work is not None:
            self._work.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await self._work
        if self._channel is not None:
            self._channel.close()
            self._channel = None

    async def _live(self) -> None:
        while True:
            self._tick(self._clock.now_s())
            await self._clock.sleep(TICK_S)

    def _tick(self, now_s: float) -> None:
        beats = not self._only_looks and self.driver.heartbeats.allowed(now_s)
        if beats and now_s >= self._beat_due_s:
            self._beat_due_s = now_s + HEARTBEAT_S
            self._send(
                mavlink.MAVLink_heartbeat_message(
                    mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, mavlink.MAV_STATE_ACTIVE, 3
                )
            )
        # Over UDP a vehicle answers only where it has heard from: whoever sends no heartbeats asks at once.
        asks = self._only_looks or self.driver.vehicle.link_ok(now_s)
        if self._unheard and asks and now_s >= self._request_due_s:
            self._request_due_s = now_s + STREAM_REQUEST_S
            for message_id in self._unheard:
                self._send(
                    mavlink.MAVLink_command_long_message(
                        *self.driver.vehicle.address, mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, 0,
                        message_id, _STREAMS_US[message_id], 0, 0, 0, 0, 0,
                    )
                )  # fmt: skip
        self.driver.tick(now_s)

    def _send(self, message: MavMessage) -> None:
        if self._channel is not None:
            self._channel.send(message)

    def _heard(self, message: MavMessage) -> None:
        now_s = self._clock.now_s()
        self.driver.heartbeats.overhear(message, now_s)
        if self.driver.vehicle.receive(message, now_s):
            self._unheard.discard(message.get_msgId())
            self.driver.receive(message, now_s)
