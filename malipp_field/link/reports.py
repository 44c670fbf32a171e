"""What an agent says of its vehicle on the bus: telemetry, confirmations of payload actions, and events."""

from __future__ import annotations

from typing import Literal, Protocol

from malipp_field.bus.messages import (
    Awaited,
    Confirm,
    Confirmation,
    Event,
    Message,
    Telemetry,
    root,
    vehicle_key,
)
from malipp_field.clock import Clock
from malipp_field.link.progress import Progress
from malipp_field.link.vehicle import Vehicle
from malipp_field.vehicle.payload_protocol import PayloadReport
from malipp_field.vehicle.steps import Action, Step, Witness


class Publishes(Protocol):
    """What this needs of the bus."""

    def publish(self, key: str, message: Message) -> None:
        """Say ``message`` to whoever listens to ``key``."""
        ...


class Reports:
    """Puts into messages what one vehicle does, and publishes them.

    Parameters
    ----------
    mission_name, robot
        First parts of all keys.
    bus, clock
        Where it is said, and when.
    """

    def __init__(self, mission_name: str, robot: str, bus: Publishes, clock: Clock) -> None:
        self._mission_name, self._robot = mission_name, robot
        self._bus, self._clock = bus, clock
        self._confirmations = 0
        self._awaits: Awaited | None = None

    def event(self, severity: Literal["info", "warning", "error"], text: str) -> None:
        """Tell whoever watches the mission something."""
        event = Event(
            time_s=self._clock.now_s(),
            source=f"agent {self._robot}",
            severity=severity,
            text=text,
            robot=self._robot,
        )
        self._bus.publish(f"{root(self._mission_name)}/event", event)

    def script_said(self, step: Step | None, report: PayloadReport, *, goes_on: bool) -> None:
        """Publish what the payload script confirms; no step where no mission has such a one."""
        self._confirmation(
            step, report.action, report.tag, by="script", ok=report.ok, value=report.value,
            text="" if report.ok else report.result, goes_on=goes_on,
        )  # fmt: skip

    def passed(self, step: Step) -> None:
        """Publish that a step is done by the vehicle's having gone past it."""
        self._confirmation(step, step.action, step.tags[0], by="progress")

    def person_said(self, step: Step, word: Confirm) -> None:
        """Publish a person's word on a step; the vehicle goes on, done or not."""
        self._confirmation(
            step, step.action, step.tags[0], by="person", ok=word.ok, value=word.value, text=word.text,
            goes_on=not word.ok,
        )  # fmt: skip

    def _confirmation(
        self, step: Step | None, action: Action, tag: int, *, by: Witness, ok: bool = True,
        value: float | None = None, text: str = "", goes_on: bool = False,
    ) -> None:  # fmt: skip
        confirmation = Confirmation(
            time_s=self._clock.now_s(), robot=self._robot, number=self._confirmations + 1,
            uid=step.uid if step else "", action=action, node=step.node if step else "", tag=tag,
            ok=ok, value=value, text=text, by=by, goes_on=goes_on,
        )  # fmt: skip
        self._publish("confirmation", confirmation)
        self._confirmations += 1

    def telemetry(self, vehicle: Vehicle, progress: Progress, *, link_ok: bool) -> None:
        """Publish the state of a vehicle whose position is known."""
        now_s = self._clock.now_s()
        telemetry = Telemetry(
            time_s=now_s,
            robot=self._robot,
            lat_deg=vehicle.lat_deg or 0.0,
            lon_deg=vehicle.lon_deg or 0.0,
            heading_deg=vehicle.heading_deg,
            speed_m_s=vehicle.speed_m_s,
            mode=vehicle.mode,
            armed=vehicle.armed,
            ready_to_arm=vehicle.ready_to_arm,
            energy_used_j=vehicle.energy_used_j,
            mission_version=None if progress.mission is None else progress.mission.version,
            step_uid=None if progress.current is None else progress.current.uid,
            finished=progress.finished,
            link_ok=link_ok,
            awaits=self._awaited(progress, now_s),
        )
        self._publish("telemetry", telemetry)

    def _awaited(self, progress: Progress, now_s: float) -> Awaited | None:
        """Return what waits for a person, and since when."""
        step, since_s = progress.awaited(), now_s
        if step is None:
            self._awaits = None
            return None
        if self._awaits is not None and self._awaits.uid == step.uid:
            since_s = self._awaits.since_s
        self._awaits = Awaited(
            uid=step.uid, action=step.action, node=step.node, tag=step.tags[0], since_s=since_s,
            problem=progress.failed.get(step.uid, ""),
        )  # fmt: skip
        return self._awaits

    def _publish(self, what: str, message: Message) -> None:
        self._bus.publish(vehicle_key(self._mission_name, self._robot, what), message)
