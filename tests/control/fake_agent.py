"""An agent whose vehicle does as it is told, at a pace the test sets; it speaks on the real bus."""

from __future__ import annotations

import asyncio
import math

from malipp_field.bus import (
    Bus,
    Command,
    Confirmation,
    Load,
    Release,
    Reply,
    Start,
    Telemetry,
    presence_key,
    vehicle_key,
)
from malipp_field.clock import Clock
from malipp_field.mission import Mission, to_globe, to_local
from malipp_field.vehicle.steps import Action, Step, VehicleMission

TICK_S = 0.5
ACTION_S = 3.0


class FakeAgent:
    def __init__(self, mission: Mission, robot: str, bus: Bus, clock: Clock) -> None:
        self.mission, self.robot, self.bus, self.clock = mission, robot, bus, clock
        self.loaded: VehicleMission | None = None
        self.done: set[str] = set()
        self.driving = False
        self.passed: set[str] = set()
        self.number = 0
        self.slow_s = 0.0  # so long it drives at less than a third of its speed
        self.refuse_version: int | None = None
        self.mute_version: int | None = None  # loads it, but nobody hears the answer
        self.failed_uploads: list[int] = []  # versions of loads to come that leave the vehicle empty
        self.refused_starts = 0
        self.confirm_after_s = 0.0
        self.driven: set[int] = set()  # versions of missions that have moved the vehicle
        self.fails: set[tuple[Action, int]] = set()
        self.orders: list[str] = []
        self.waiting: list[Confirmation] = []
        self.versions: list[int] = []
        start = next(n for n in mission.site.nodes if n.id == mission.robot(robot).start)
        self.x_m, self.y_m = float(start.x_m or 0.0), float(start.y_m or 0.0)
        self.busy_s = 0.0

    async def run(self) -> None:
        await self.bus.serve(vehicle_key(self.mission.name, self.robot, "command"), Command, self.obey)
        await self.bus.present(presence_key(self.mission.name, self.robot))
        while True:
            self.live()
            self.confirm()
            self.bus.publish(vehicle_key(self.mission.name, self.robot, "telemetry"), self.telemetry())
            await self.clock.sleep(TICK_S)

    async def obey(self, command: Command) -> Reply:
        order = command.order
        self.orders.append(order.do)
        now_s = self.clock.now_s()
        if isinstance(order, Load):
            if order.mission.version == self.refuse_version:
                return Reply(time_s=now_s, ok=False, text="the radio is silent")
            self.loaded, self.driving = order.mission, False
            if self.failed_uploads[:1] == [order.mission.version]:
                self.failed_uploads.pop(0)
                self.loaded = None
                return Reply(time_s=now_s, ok=False, text="the upload failed")
            self.versions.append(order.mission.version)
            if order.mission.version == self.mute_version:
                self.mute_version = None
                raise RuntimeError("nobody hears this")
        elif isinstance(order, Start):
            if self.refused_starts:
                self.refused_starts -= 1
                return Reply(time_s=now_s, ok=False, text="no position estimate")
            if self.loaded is None:
                return Reply(time_s=now_s, ok=False, text="there is no verified mission on board")
            if order.version != self.loaded.version:
                return Reply(time_s=now_s, ok=False, text="another version is on board")
            self.driving = True
        elif isinstance(order, Release):
            self.passed.add(order.uid)
        await asyncio.sleep(0)
        return Reply(time_s=now_s, ok=True)

    @property
    def step(self) -> Step | None:
        steps = self.loaded.steps if self.loaded is not None else ()
        return next((step for step in steps if step.uid not in self.done), None)

    def live(self) -> None:
        step = self.step
        if step is None or not self.driving or self.loaded is None:
            return
        self.driven.add(self.loaded.version)
        if step.action is Action.DRIVE:
            self.drive(step)
        elif step.action is Action.WAIT:
            self.done |= self.passed & {step.uid}
        else:
            self.busy_s += TICK_S
            if self.busy_s >= ACTION_S:
                self.busy_s = 0.0
                self.handle(step)

    def confirm(self) -> None:
        """Say what is done, after the time it takes to get through."""
        key = vehicle_key(self.mission.name, self.robot, "confirmation")
        while self.waiting and self.clock.now_s() >= self.waiting[0].time_s + self.confirm_after_s:
            self.bus.publish(key, self.waiting.pop(0))

    def drive(self, step: Step) -> None:
        origin = self.mission.site.origin
        assert origin is not None
        x_m, y_m = to_local(step.place.lat_deg, step.place.lon_deg, origin)
        left_m = math.dist((self.x_m, self.y_m), (x_m, y_m))
        self.slow_s -= TICK_S
        pace = 0.3 if self.slow_s > 0.0 else 1.0
        stride_m = self.mission.robot(self.robot).speed_m_s * pace * TICK_S
        if left_m <= stride_m:
            self.x_m, self.y_m = x_m, y_m
            self.done.add(step.uid)
        else:
            self.x_m += (x_m - self.x_m) * stride_m / left_m
            self.y_m += (y_m - self.y_m) * stride_m / left_m

    def handle(self, step: Step) -> None:
        (tag,) = step.tags
        ok = (step.action, tag) not in self.fails
        self.number += 1
        self.waiting.append(
            Confirmation(
                time_s=self.clock.now_s(), robot=self.robot, number=self.number, uid=step.uid,
                action=step.action, node=step.node, tag=tag, ok=ok, text="" if ok else "missing",
            )
        )  # fmt: skip
        if ok:
            self.done.add(step.uid)
        else:
            self.driving = False

    def telemetry(self) -> Telemetry:
        origin = self.mission.site.origin
        assert origin is not None
        lat_deg, lon_deg = to_globe(self.x_m, self.y_m, origin)
        step = self.step
        return Telemetry(
            time_s=self.clock.now_s(), robot=self.robot, lat_deg=lat_deg, lon_deg=lon_deg, heading_deg=0.0,
            speed_m_s=0.0, mode="AUTO" if self.driving else "HOLD", armed=True, ready_to_arm=True,
            energy_used_j=0.0, mission_version=self.loaded.version if self.loaded else None,
            step_uid=step.uid if step else None, finished=self.loaded is not None and step is None,
            link_ok=True,
        )  # fmt: skip
