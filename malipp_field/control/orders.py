"""Orders to the agents, one vehicle or the whole fleet at a time."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping

from malipp_field.bus import Bus, Command, Order, Reply, vehicle_key
from malipp_field.clock import Clock
from malipp_field.errors import LinkError

# Wall seconds, longer than an agent takes for any order by its own limits (the longest are an upload on a bad
# radio, and a position estimate after boot): it answers, or it is not there.
_TIMEOUT_S = 300.0


class Orders:
    """Asks agents to do things. One that does not answer may or may not have done it."""

    def __init__(self, mission_name: str, bus: Bus, clock: Clock) -> None:
        self._mission_name, self._bus, self._clock = mission_name, bus, clock

    async def give(self, robot: str, order: Order) -> Reply:
        """Give one order and return the agent's answer; silence is a refusal with that reason."""
        now_s = self._clock.now_s()
        try:
            return await self._bus.request(
                vehicle_key(self._mission_name, robot, "command"),
                Command(time_s=now_s, order=order),
                _TIMEOUT_S,
            )
        except LinkError as fault:
            return Reply(time_s=now_s, ok=False, text=str(fault))

    async def give_all(self, orders: Mapping[str, Order]) -> dict[str, str]:
        """Give orders to several vehicles at once; return the refusals, by robot."""
        replies = await asyncio.gather(*(self.give(robot, order) for robot, order in orders.items()))
        return {robot: reply.text for robot, reply in zip(orders, replies, strict=True) if not reply.ok}
