"""Faults while a mission is loaded: whoever watches sees every item that the rover begins."""

from __future__ import annotations

import asyncio
from typing import Any

from agent_cases import FAR, Yard
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from malipp_field.bus.messages import Load, Start
from malipp_field.link.compare import differences
from malipp_field.vehicle.items import MAV_CMD_NAV_WAYPOINT as WAYPOINT
from malipp_field.vehicle.items import MissionItem
from malipp_field.vehicle.layout import lay_out
from malipp_field.vehicle.steps import VehicleMission

OLD = ("drive a", "collect a 1", "drive b", "drive base", "unload base 1")
NEW = ("drive a", "collect a 1", "collect a 2", "drive base", "unload base 1", "unload base 2")
ALL_DONE = ["collect a 1", "collect a 2", "unload base 1", "unload base 2"]

INITIAL, HELD, UNDER_WAY = "initial", "held", "under way"
OCCASIONS = [INITIAL, HELD, UNDER_WAY]

GUARDED = {"FS_GCS_ENABLE": 1.0, "FS_THR_ENABLE": 0.0}
"""What makes a replacement without a stop safe; the rest of it are ArduPilot's defaults."""


class GuardedYard(Yard):
    """A yard that sees to it that the rover begins no item of a mission that is not whole.

    Parameters
    ----------
    parameters
        Set on the rover.
    """

    def __init__(self, seed: int = 0, loss: float = 0.0, **parameters: float) -> None:
        super().__init__(seed, loss, mission=FAR)
        for name, value in parameters.items():
            self.rover.parameters._values[name] = value
        self.begun: list[MissionItem] = []
        self.modes: list[int] = []
        self.uplinks = 0
        self.cut_at: int | None = None
        self.watch_items()
        self.on_send = self._count

    def watch_items(self) -> None:
        """Watch the items that the rover begins; a restart makes that necessary again."""
        run = self.rover.autopilot.run
        self._honest = run._begin
        run._begin = self._begin

    def _begin(self, item: MissionItem) -> None:
        # A rover begins its leg anew when it sees the mission change ahead, in the middle of an upload too.
        if not (self.begun and item == self.begun[-1] and self.driving() and item.command == WAYPOINT):
            assert self.aboard() is not None, f"item {item.seq} was begun while the mission was a mixture"
        self.begun.append(item)
        self._honest(item)

    def aboard(self) -> tuple[str, ...] | None:
        """Return which mission the rover stores, or None when it is neither the old nor the new one."""
        store = self.rover.autopilot.store
        for work in (OLD, NEW):
            if not store.receiving and differences(lay_out(self.mission(*work)).items, store.items) == []:
                return work
        return None

    def _count(self, message: Any) -> None:
        """Count what is said about missions; from message ``cut_at`` on nothing gets through, either way."""
        if message.get_type().startswith(("MISSION_", "COMMAND_", "PARAM_")):
            if self.uplinks == self.cut_at:
                self.cut = True
            self.uplinks += 1

    def reported(self) -> None:
        """Check that what is reported is what is: a mission that is said to be on board is there, whole."""
        version = self.telemetry.mission_version
        if version is not None:
            assert self.aboard() == (OLD if version == 1 else NEW)

    def driving(self) -> bool:
        autopilot = self.rover.autopilot
        return autopilot.armed and autopilot.mode == mavlink.ROVER_MODE_AUTO

    def old(self) -> VehicleMission:
        return self.mission(*OLD)

    def new(self, version: int = 2) -> VehicleMission:
        return self.mission(*NEW, version=version)


def yard_for(occasion: str, seed: int = 0, loss: float = 0.0) -> GuardedYard:
    return GuardedYard(seed, loss, **(GUARDED if occasion == UNDER_WAY else {"FS_GCS_ENABLE": 1.0}))


async def begin(yard: GuardedYard, occasion: str) -> asyncio.Future[Any]:
    """Bring the rover to the occasion on which it is given its new mission, and begin to give it."""
    if occasion != INITIAL:
        while not (await yard.order(Load(mission=yard.old()))).ok:
            pass
        while not (await yard.order(Start())).ok:
            pass
        await yard.live(9.0)
    yard.uplinks = 0
    return yard.begin(Load(mission=yard.new(), resume=True))


async def settle(yard: GuardedYard, load: asyncio.Future[Any]) -> None:
    """Wait for the order's end, then for the rover to have given up whatever it waited for."""
    await yard.until(load.done, limit_s=400.0)
    await yard.live(12.0)


def check(yard: GuardedYard) -> None:
    """A rover that drives has a whole mission on board, and what its agent says of it is so."""
    yard.reported()
    if yard.driving():
        assert yard.aboard() is not None
    if yard.telemetry.link_ok:
        autopilot = yard.rover.autopilot
        assert (yard.telemetry.mode == "AUTO") is (autopilot.mode == mavlink.ROVER_MODE_AUTO)
        assert yard.telemetry.armed is autopilot.armed


async def make_good(yard: GuardedYard) -> None:
    """The fault is over: the new mission is loaded and driven to its end, each action once."""
    version = 3
    while not (await yard.order(Load(mission=yard.new(version), resume=True))).ok:
        version += 1
        assert version < 9
    while not yard.telemetry.finished:
        if yard.telemetry.mode != "AUTO":
            await yard.order(Start())
        await yard.live(5.0)
        assert yard.clock.now_s() < 1e9 + 2000.0
    assert [uid for _, uid, ok in yard.confirmed if ok] == ALL_DONE
