"""The coordinator: starts the team, keeps custody, opens gates, and replans from the state as it is.

It knows the vehicles only through the bus. Every plan it puts in force has passed the verifier, and every
vehicle concerned has read its part back before any of them moves on.
"""

from __future__ import annotations

import asyncio
import logging
import math
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
from malipp_field.control.dispatch import Dispatch, Severity
from malipp_field.control.ending import conclusion
from malipp_field.control.experience import Experience
from malipp_field.control.gates import may_pass
from malipp_field.control.launch import busy, load_first
from malipp_field.control.ledger import CustodyLedger
from malipp_field.control.lookahead import LookAhead, Outlook, Roads, Whereabouts
from malipp_field.control.orders import Orders
from malipp_field.control.remainder import remainder
from malipp_field.control.revision import Revision, revise
from malipp_field.control.schedule import Deviation, Expected, deviation, expectations
from malipp_field.control.stranded import broken_chain
from malipp_field.control.tracks import Track
from malipp_field.mission import Mission, TeamState, initial_state
from malipp_field.plan import Plan
from malipp_field.vehicle.compile import compile_plan
from malipp_field.vehicle.steps import Action, Step, VehicleMission

_TICK_S = 0.5
_AGREEMENT_S = 8.0  # from a plan to all vehicles verified, on top of the planner's time limit
_PAUSE_S = 60.0  # between replans, so that noise does not cause churn
_RELEASE_AGAIN_S = 5.0  # a gate that is still shut so long after it was to open is tried again
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
        self._dispatch = Dispatch(Orders(mission.name, bus, clock), clock, self._say)
        self._roads = Roads(mission)
        self._experience = Experience()
        self.ledger = CustodyLedger()
        compiled = compile_plan(mission, plan, start_s=clock.now_s())
        self.tracks = {
            robot: Track(mission, plan.robot(robot), vehicle_mission)
            for robot, vehicle_mission in compiled.missions.items()
        }
        self._samples = compiled.samples
        self._expected: dict[str, Expected] = expectations(
            plan, compiled.missions, self._budgets(initial_state(mission)), mission
        )
        self._start_s = clock.now_s()
        self._quiet_until_s = 0.0
        self._present: set[str] = set()
        self._tried_s: dict[str, float] = {}  # from when on each gate may be told to open again
        self._versions = plan.version  # the highest ever proposed: one that was dropped is not given again
        self._under_way = False

    @property
    def mission_time_s(self) -> float:
        """Seconds since the mission began."""
        return self._clock.now_s() - self._start_s

    async def run(self) -> Outcome:
        """Fly the mission; returns when every vehicle is done, or nothing moves any more."""
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
            await self._dispatch.restore(self._in_force(), self._present)
            await self._open_gates()
            trigger = self._trigger()
            if trigger is not None:
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

    # Gates ----------------------------------------------------------------------------------------------

    async def _open_gates(self) -> None:
        """Let all pass whose containers lie ready; a gate that is still shut later is tried again."""
        now_s = self._clock.now_s()
        gates = {
            robot: step for robot, track in self.tracks.items() if (step := self._open_gate(robot, track))
        }
        due = {
            robot: step for robot, step in gates.items() if now_s >= self._tried_s.get(step.uid, -math.inf)
        }
        self._tried_s |= {step.uid: now_s + _RELEASE_AGAIN_S for step in due.values()}
        refusals = await self._dispatch.release({robot: step.uid for robot, step in due.items()})
        for robot, step in due.items():
            if robot in refusals:
                self._say("warning", f"gate at {step.node} does not open: {refusals[robot]}", robot)
            else:
                self.tracks[robot].confirm(step.uid)

    def _open_gate(self, robot: str, track: Track) -> Step | None:
        """Return the gate at which a vehicle stands and which it may pass."""
        step = track.step
        if step is None or step.action is not Action.WAIT or not track.reports(step):
            return None
        clearance_s = self.mission.team.clearance_s
        free = may_pass(robot, step, self.ledger, self.tracks, self._clock.now_s(), clearance_s)
        return step if free else None

    # Replanning -----------------------------------------------------------------------------------------

    def _trigger(self) -> str | None:
        """Return why the plan in force should be looked at again, or `None`."""
        if self._clock.now_s() < self._quiet_until_s:
            return None
        if (broken := broken_chain(self.tracks, self.ledger)) is not None:
            return broken
        for robot in self.tracks:
            found = self._deviation(robot)
            if found is None:
                continue
            budget_j = self.mission.robot(robot).energy_budget_j
            if found.overdraw_j > self.mission.replanning.energy_overdraw * budget_j:
                share = 100.0 * found.overdraw_j / budget_j
                return f"{robot} will have used {share:.0f} % of its budget more than planned at {found.node}"
            if found.late_s > self.mission.replanning.slip_s:
                return f"{robot} will be {found.late_s:.0f} s late at {found.node}"
        return None

    def _deviation(self, robot: str) -> Deviation | None:
        track = self.tracks[robot]
        if track.telemetry is None or track.finished:
            return None
        now, load = self._whereabouts(track), len(self.ledger.on_board(robot))
        return deviation(robot, self.mission_time_s, now, load, self._expected, self._roads)

    def _whereabouts(self, track: Track) -> Whereabouts:
        step = track.step
        known = self._experience.of(track.last_node, step.node) if step is not None else (1.0, 1.0)
        return track.whereabouts(self._roads, len(self.ledger.on_board(track.robot_id)), known)

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
        whereabouts = {robot: self._whereabouts(track) for robot, track in self.tracks.items()}
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
        """Bring a revision to all vehicles it concerns, or to none."""
        refusals = await self._dispatch.load(revision.missions, revision.outlook.diverges_at)
        if refusals:
            self._say("warning", _in_words(f"plan {revision.plan.version} is dropped", refusals))
            await self._dispatch.put_back(revision.missions, self._in_force(), self._present)
            return
        self._adopt(revision, reason)
        names = ", ".join(revision.missions) or "no vehicle"
        self._say("info", f"plan {revision.plan.version} is in force; it changes {names}")
        await self._dispatch.start(revision.missions)

    def _adopt(self, revision: Revision, reason: str) -> None:
        expected = expectations(
            revision.plan, revision.compiled, self._budgets(revision.outlook.state), self.mission
        )
        for robot, track in self.tracks.items():
            if robot in revision.missions:
                committed = len(revision.outlook.committed[robot])
                track.adopt(revision.plan.robot(robot), revision.missions[robot], committed)
                continue
            # The vehicle keeps its mission: the new plan's words are about its old steps.
            free = track.mission.steps[len(track.mission.steps) - len(revision.compiled[robot].steps) :]
            for old, new in zip(free, revision.compiled[robot].steps, strict=True):
                if new.uid in expected:
                    expected[old.uid] = expected.pop(new.uid)
        self._expected = expected
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

    def _budgets(self, state: TeamState) -> dict[str, float]:
        return {robot.id: robot.energy_left_j for robot in state.robots}

    def _say(self, severity: Severity, text: str, robot: str | None = None) -> None:
        event = Event(
            time_s=self._clock.now_s(), source="coordinator", severity=severity, text=text, robot=robot
        )
        self._publish("event", event)

    def _publish(self, what: str, message: Message) -> None:
        self._bus.publish(f"{root(self.mission.name)}/{what}", message)


def _in_words(what: str, refusals: dict[str, str]) -> str:
    return f"{what}: " + "; ".join(f"{robot}: {text}" for robot, text in refusals.items())
