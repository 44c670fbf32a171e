"""The coordinator: starts the team, keeps custody, opens gates, and replans from the state as it is.

It knows the vehicles only through the bus. Every plan it puts in force has passed the verifier, and every
vehicle concerned has read its part back before any of them moves on.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from malipp_field.bus import (
    Bus,
    Confirmation,
    Event,
    Message,
    MissionText,
    PlanAdopted,
    Telemetry,
    presence_key,
    root,
    vehicle_key,
)
from malipp_field.clock import Clock
from malipp_field.control.dispatch import Dispatch
from malipp_field.control.ending import conclusion
from malipp_field.control.experience import Experience
from malipp_field.control.gates import GateKeeper
from malipp_field.control.launch import busy, load_first
from malipp_field.control.ledger import CustodyLedger
from malipp_field.control.lookahead import LookAhead, Outlook, Roads
from malipp_field.control.orders import Orders
from malipp_field.control.remainder import remainder
from malipp_field.control.revision import Revision, revise
from malipp_field.control.schedule import Schedule
from malipp_field.control.stranded import broken_chain
from malipp_field.control.strays import Severity
from malipp_field.control.tracks import Track
from malipp_field.mission import Mission, TeamState
from malipp_field.plan import Plan
from malipp_field.vehicle.compile import compile_plan
from malipp_field.vehicle.steps import VehicleMission, run_at

_TICK_S = 0.5
_AGREEMENT_S = 8.0  # from a plan to all vehicles verified, on top of the planner's time limit
_SEEN_WITHIN_S = 5.0  # an agent says five times a second what is on board
_PAUSE_S = 60.0  # between replans, so that noise does not cause churn
_PRESENCE_TIMEOUT_S = 60.0

log = logging.getLogger(__name__)


class Planner(Protocol):
    """Plans the rest of a mission; `malipp_field.planner.solve` with the mission's options is one."""

    def __call__(self, mission: Mission, *, state: TeamState, warm_start: Plan, version: int) -> Plan:
        """Return a verified plan, or one without routes and the reason."""
        ...


@dataclass(frozen=True)
class Outcome:
    """How a mission ended. Times are on the team's clock, in seconds since the Unix epoch."""

    complete: bool
    reason: str
    start_s: float
    end_s: float
    versions: int


class Coordinator:
    """Carries one mission from its first plan to its end.

    Parameters
    ----------
    mission, mission_text
        The mission, and the file it was read from (it goes into the recording).
    plan
        Version 1, verified.
    planner
        Called in a thread of its own to plan the rest of a mission.
    witnesses
        Presence keys, besides the agents', that must be there before the start (``recorder``).
    on_tick
        Called now and then with the coordinator, for a progress display.
    """

    def __init__(
        self,
        mission: Mission,
        mission_text: str,
        plan: Plan,
        bus: Bus,
        clock: Clock,
        planner: Planner,
        witnesses: tuple[str, ...] = (),
        on_tick: Callable[[Coordinator], None] | None = None,
    ) -> None:
        self.mission, self.plan = mission, plan
        self._mission_text = mission_text
        self._bus, self._clock, self._planner = bus, clock, planner
        self._witnesses, self._on_tick = witnesses, on_tick
        self._roads = Roads(mission)
        self._experience = Experience()
        self.ledger = CustodyLedger()
        compiled = compile_plan(mission, plan, start_s=clock.now_s(), run=run_at(clock.now_s()))
        self.tracks = {
            robot: Track(mission, plan.robot(robot), vehicle_mission)
            for robot, vehicle_mission in compiled.missions.items()
        }
        self._dispatch = Dispatch(Orders(mission.name, bus, clock), clock, self._say, self.tracks)
        self._samples = compiled.samples
        self._schedule = Schedule(
            mission, self.tracks, self.ledger, self._experience, plan, compiled.missions
        )
        self._gates = GateKeeper(
            self.tracks, self.ledger, self._dispatch, clock, mission.team.clearance_s, self._say
        )
        self._start_s = clock.now_s()
        self._quiet_until_s = 0.0
        self._present: set[str] = set()
        self._versions = plan.version  # the highest ever proposed: one that was dropped is not given again
        self._under_way = False

    @property
    def mission_time_s(self) -> float:
        """Seconds since the mission began."""
        return self._clock.now_s() - self._start_s

    async def run(self) -> Outcome:
        """Fly the mission; returns when every vehicle is done, or nothing moves any more."""
        try:
            return await self._fly()
        finally:
            await self._gates.close()

    async def _fly(self) -> Outcome:
        await self._listen()
        missing = await self._await_presence()
        if missing:
            return self._ended(False, f"not there within {_PRESENCE_TIMEOUT_S:.0f} s: {', '.join(missing)}")
        self._publish("mission", MissionText(time_s=self._clock.now_s(), text=self._mission_text))
        refusal = await self._launch()
        if refusal:
            return self._ended(False, refusal)
        while (outcome := self._over()) is None:
            await self._clock.sleep(_TICK_S)
            await self._dispatch.restore(self._present)
            trigger = self._trigger()
            if trigger is None:
                self._gates.open_all()
            elif not self._gates.busy:  # no gate opens while a new plan is made
                await self._replan(trigger)
            if self._on_tick is not None:
                self._on_tick(self)
        return outcome

    # Listening ------------------------------------------------------------------------------------------

    async def _listen(self) -> None:
        for robot in self.tracks:
            await self._bus.subscribe(
                vehicle_key(self.mission.name, robot, "telemetry"), Telemetry, self._on_telemetry
            )
            await self._bus.subscribe(
                vehicle_key(self.mission.name, robot, "confirmation"), Confirmation, self._on_confirmation
            )
        await self._bus.watch_presence(presence_key(self.mission.name, "*"), self._on_presence)

    def _on_presence(self, key: str, there: bool) -> None:
        name = key.rsplit("/", 1)[-1]
        (self._present.add if there else self._present.discard)(name)
        if not there and self._under_way:
            self._say("warning", f"{name} has left the bus", name if name in self.tracks else None)

    def _is_from(self, robot: str, key: str) -> bool:
        """Whether an agent speaks for its own vehicle; what it says of another is not acted upon."""
        return robot in self.tracks and key.startswith(vehicle_key(self.mission.name, robot, ""))

    def _on_telemetry(self, key: str, telemetry: Telemetry) -> None:
        robot = telemetry.robot
        if not self._is_from(robot, key):
            return
        self._present.add(robot)  # the end of a former agent may be told after a new one is there
        before = self.tracks[robot].telemetry
        if telemetry.awaits is not None and (before is None or before.awaits is None):
            self._say("info", f"waits for a person: {telemetry.awaits}; then: malipp confirm", robot)
        leg = self.tracks[robot].update(telemetry, self._roads, len(self.ledger.on_board(robot)))
        if leg is not None and self._experience.note(leg, whole=True):
            self._say(
                "warning",
                f"{leg.tail} to {leg.head} took {leg.time_ratio:.1f} x the time, "
                f"{leg.energy_ratio:.1f} x the energy foreseen",
                robot,
            )

    def _on_confirmation(self, key: str, confirmation: Confirmation) -> None:
        if not self._is_from(confirmation.robot, key):
            return
        if not confirmation.ok:
            self._on_failure(confirmation)
            return
        self.tracks[confirmation.robot].confirm(confirmation.uid)
        refusal = self.ledger.confirm(confirmation)
        if refusal is not None and confirmation.tag in self.ledger.unsettled:
            self._say(
                "warning", f"to be cleared up by what is not heard of yet: {refusal}", confirmation.robot
            )
            return
        if refusal is not None:
            self._say("error", f"custody does not add up: {refusal}", confirmation.robot)
            return
        self._publish("ledger", self.ledger.message(self._clock.now_s()))

    def _on_failure(self, confirmation: Confirmation) -> None:
        robot = confirmation.robot
        what = f"{confirmation.action} of container {confirmation.tag} at {confirmation.node}"
        if not confirmation.goes_on:
            self._say(
                "error",
                f"{what} failed: {confirmation.text}. The vehicle holds. Put it right and set it to AUTO: it "
                "tries again. Or do it by hand, or go on without, and say so: malipp confirm",
                robot,
            )
            return
        self._say("warning", f"goes on without the {what}: {confirmation.text or 'not done'}", robot)
        self.tracks[robot].confirm(confirmation.uid)
        self.ledger.miss(confirmation)
        self._publish("ledger", self.ledger.message(self._clock.now_s()))

    async def _await_presence(self) -> list[str]:
        """Wait for all agents and witnesses; return who did not come."""
        needed = {*self.tracks, *self._witnesses}
        deadline_s = self._clock.now_s() + _PRESENCE_TIMEOUT_S
        while self._clock.now_s() < deadline_s:
            if needed <= self._present and all(track.telemetry for track in self.tracks.values()):
                return []
            await self._clock.sleep(_TICK_S)
        silent = {robot for robot, track in self.tracks.items() if track.telemetry is None}
        return sorted((needed - self._present) | silent)

    # Starting -------------------------------------------------------------------------------------------

    async def _launch(self) -> str | None:
        """Load and start every vehicle that has something to do; return why not, on failure."""
        with self._clock.real_time():
            self._start_s, refusals = await load_first(
                self.mission, self.plan, self.tracks, self._dispatch, self._clock
            )
            if refusals:
                return _in_words("not started, a vehicle does not hold its mission", refusals)
            self.ledger.expect(self._samples.values())
            self._announce("first plan")
            moving = busy(self.tracks)
            refusals = await self._dispatch.start(moving)
        self._under_way = True
        self._quiet_until_s = self._clock.now_s() + _PAUSE_S / 2
        return _in_words("no vehicle starts", refusals) if moving and len(refusals) == len(moving) else None

    def _in_force(self) -> dict[str, VehicleMission]:
        return {robot: track.mission for robot, track in self.tracks.items()}

    def _announce(self, reason: str) -> None:
        self._publish(
            "plan",
            PlanAdopted(
                time_s=self._clock.now_s(),
                start_s=self._start_s,
                plan=self.plan,
                missions=tuple(self._in_force().values()),
                samples=tuple(record.sample for record in self.ledger.records.values()),
                reason=reason,
            ),
        )
        self._publish("ledger", self.ledger.message(self._clock.now_s()))

    # Replanning -----------------------------------------------------------------------------------------

    def _trigger(self) -> str | None:
        """Return why the plan in force should be looked at again, or `None`."""
        if self._clock.now_s() < self._quiet_until_s or self._dispatch.restoring(self._present):
            return None
        return broken_chain(self.tracks, self.ledger) or self._schedule.intolerable(self.mission_time_s)

    async def _replan(self, trigger: str) -> None:
        self._say("info", f"replanning: {trigger}")
        with self._clock.real_time():
            try:
                revision = await self._revise()
            except Exception as fault:  # whatever the planner does, the team needs its coordinator
                log.exception("planning failed")
                self._say("error", f"planning failed, going on as planned: {fault}")
                revision = None
            if revision is not None:
                await self._put_in_force(revision, trigger)
        self._quiet_until_s = self._clock.now_s() + _PAUSE_S

    async def _revise(self) -> Revision | None:
        """Plan the rest of the mission; `None` where there is no plan."""
        for robot, track in self.tracks.items():
            leg = track.measured(self._roads, len(self.ledger.on_board(robot)))
            if leg is not None:
                self._experience.note(leg, whole=False)
        horizon_s = self.mission.replanning.time_limit_s + _AGREEMENT_S
        known = Roads(self._experience.applied_to(self.mission))
        whereabouts = {robot: self._schedule.whereabouts(robot) for robot in self.tracks}
        lookahead = LookAhead(self.mission, self._roads, known, horizon_s)
        outlook = lookahead.outlook(self.mission_time_s, whereabouts, self.ledger)
        plan = await self._plan_rest(outlook)
        if not plan.robots:
            self._say("warning", f"no new plan, going on as planned: {plan.reason or plan.status}")
            return None
        return revise(self.mission, plan, outlook, self.ledger, self._in_force(), self._start_s)

    async def _plan_rest(self, outlook: Outlook) -> Plan:
        """Plan with an energy reserve; where that is too much to ask by now, without it, in the time left."""
        options = self.mission.replanning
        began_s = self._clock.now_s()
        self._versions += 1
        plan = await self._solve(outlook, options.energy_reserve, options.time_limit_s)
        if plan.status == "infeasible" and options.energy_reserve > 0.0:
            self._say("warning", f"the energy reserve cannot be kept: {plan.reason}")
            left_s = options.time_limit_s - (self._clock.now_s() - began_s)
            plan = await self._solve(outlook, 0.0, max(1.0, left_s))
        return plan

    async def _solve(self, outlook: Outlook, energy_reserve: float, time_limit_s: float) -> Plan:
        options = {
            "planner": self.mission.planner.model_copy(update={"energy_reserve": energy_reserve}),
            "replanning": self.mission.replanning.model_copy(update={"time_limit_s": time_limit_s}),
        }
        mission = self._experience.applied_to(self.mission.model_copy(update=options))
        warm_start = remainder(self.plan, self.tracks, outlook)
        return await asyncio.to_thread(
            self._planner, mission, state=outlook.state, warm_start=warm_start, version=self._versions
        )

    async def _put_in_force(self, revision: Revision, reason: str) -> None:
        """Bring a revision to all vehicles it concerns, or to none.

        Several stand until all of them hold theirs; one alone need not, where it can be replaced safely.
        """
        alone = len(revision.missions) == 1
        refusals = await self._dispatch.load(revision.missions, revision.outlook.diverges_at, resume=alone)
        if refusals and not (alone and await self._took_effect(revision)):
            self._say("warning", _in_words(f"plan {revision.plan.version} is dropped", refusals))
            await self._dispatch.put_back(revision.missions, self._present)
            return
        self._adopt(revision, reason)
        names = ", ".join(revision.missions) or "no vehicle"
        self._say("info", f"plan {revision.plan.version} is in force; it changes {names}")
        await self._dispatch.start(revision.missions)

    async def _took_effect(self, revision: Revision) -> bool:
        """Tell whether a vehicle has its new mission all the same: it may have gone on already."""
        asked_s = self._clock.now_s()
        (robot,) = revision.missions
        while self._clock.now_s() < asked_s + _SEEN_WITHIN_S:
            telemetry = self.tracks[robot].telemetry
            if telemetry is not None and telemetry.time_s > asked_s:
                return telemetry.mission_version == revision.plan.version
            await self._clock.sleep(_TICK_S)
        return False

    def _adopt(self, revision: Revision, reason: str) -> None:
        kept = {}
        for robot, track in self.tracks.items():
            if robot in revision.missions:
                track.adopt(revision.plan.robot(robot), revision.missions[robot], revision.kept[robot])
            else:  # it keeps its mission: the new plan's words are about its old steps
                steps = track.mission.steps
                kept[robot] = steps[len(steps) - len(revision.compiled[robot].steps) :]
        self._schedule.renew(revision.plan, revision.compiled, revision.outlook.state, kept)
        self.plan = revision.plan
        self.ledger.expect(revision.samples.values())
        self._announce(reason)

    # The end --------------------------------------------------------------------------------------------

    def _over(self) -> Outcome | None:
        found = conclusion(self.mission, self.tracks, self.ledger, self._start_s, self._clock.now_s())
        return None if found is None else self._ended(*found)

    def _ended(self, complete: bool, reason: str) -> Outcome:
        self._under_way = False
        self._say("info" if complete else "error", f"mission over: {reason}")
        return Outcome(complete, reason, self._start_s, self._clock.now_s(), self.plan.version)

    # Saying ---------------------------------------------------------------------------------------------

    def _say(self, severity: Severity, text: str, robot: str | None = None) -> None:
        event = Event(
            time_s=self._clock.now_s(), source="coordinator", severity=severity, text=text, robot=robot
        )
        self._publish("event", event)

    def _publish(self, what: str, message: Message) -> None:
        self._bus.publish(f"{root(self.mission.name)}/{what}", message)


def _in_words(what: str, refusals: dict[str, str]) -> str:
    return f"{what}: " + "; ".join(f"{robot}: {text}" for robot, text in refusals.items())
