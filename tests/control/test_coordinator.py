"""The coordinator against agents on the real bus whose vehicles do as the test says."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Callable
from contextlib import AsyncExitStack
from dataclasses import dataclass

from control_cases import MISSION, drop_plan, relay_mission
from fake_agent import FakeAgent

from malipp_field.bus import Bus, Event, PlanAdopted, presence_key, root
from malipp_field.clock import SimClock
from malipp_field.control import Coordinator, Outcome, Planner
from malipp_field.mission import Mission, TeamState
from malipp_field.plan import Plan, RobotPlan, Stop
from malipp_field.vehicle.steps import Action, run_at

WALL_LIMIT_S = 60.0


@dataclass
class Flight:
    outcome: Outcome
    coordinator: Coordinator
    agents: dict[str, FakeAgent]
    events: list[Event]
    plans: list[PlanAdopted]

    def said(self, words: str) -> bool:
        return any(words in event.text for event in self.events)


def go_straight_home(mission: Mission, *, state: TeamState, warm_start: Plan, version: int) -> Plan:
    """Plan as a frightened person would: everybody home at once."""
    robots = tuple(
        RobotPlan(
            id=robot.id,
            route=(
                Stop(node=robot.node, depart_s=robot.ready_s, payload=robot.on_board),
                Stop(
                    node="base", path=(robot.node, "base") if robot.node != "base" else ("base", "base"),
                    arrive_s=robot.ready_s + 100.0, depart_s=robot.ready_s + 110.0, leg_energy_j=1.0,
                    unload=robot.on_board, payload=0,
                ),
            ),
        )
        for robot in state.robots
    )  # fmt: skip
    return warm_start.model_copy(update={"version": version, "robots": robots})


def fly(
    prepare: Callable[[dict[str, FakeAgent]], None] = lambda agents: None,
    absent: frozenset[str] = frozenset(),
    planner: Planner = go_straight_home,
) -> Flight:
    async def main() -> Flight:
        mission = relay_mission()
        clock = SimClock(start_s=1000.0, speed=100.0)
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            hub = f"tcp/127.0.0.1:{probe.getsockname()[1]}"
        events: list[Event] = []
        plans: list[PlanAdopted] = []
        async with AsyncExitStack() as stack:
            bus = await stack.enter_async_context(Bus(listen=hub))
            listener = await stack.enter_async_context(Bus(connect=(hub,)))
            await listener.subscribe(f"{root('relay')}/event", Event, lambda _, m: events.append(m))
            await listener.subscribe(f"{root('relay')}/plan", PlanAdopted, lambda _, m: plans.append(m))
            await listener.present(presence_key("relay", "listener"))
            agents = {}
            tasks = [asyncio.ensure_future(clock.run())]
            for robot in ("scout", "carrier"):
                agent_bus = await stack.enter_async_context(Bus(connect=(hub,)))
                agents[robot] = FakeAgent(mission, robot, agent_bus, clock)
                if robot not in absent:
                    tasks.append(asyncio.ensure_future(agents[robot].run()))
            prepare(agents)
            coordinator = Coordinator(
                mission, MISSION, drop_plan(), bus, clock, planner, witnesses=("listener",)
            )
            outcome = await asyncio.wait_for(coordinator.run(), WALL_LIMIT_S)
            await clock.sleep(5.0)
            for task in tasks:
                task.cancel()
            return Flight(outcome, coordinator, agents, events, plans)

    return asyncio.run(main())


def test_a_mission_with_a_dead_drop_comes_home_and_no_pick_precedes_its_drop() -> None:
    flight = fly()
    assert flight.outcome.complete, flight.outcome.reason
    assert flight.outcome.versions == 1
    records = flight.coordinator.ledger.records
    assert {record.state for record in records.values()} == {"delivered"}
    handed_over = next(r for r in records.values() if len(r.history) == 4)
    drop, pick = handed_over.history[1:3]
    assert (drop.action, pick.action) == (Action.DROP, Action.PICK)
    assert pick.time_s >= drop.time_s + relay_mission().team.clearance_s
    assert flight.agents["carrier"].orders.count("release") == 1


def test_a_vehicle_that_does_not_hold_its_mission_keeps_all_of_them_at_the_start() -> None:
    flight = fly(lambda agents: setattr(agents["carrier"], "refuse_version", 1))
    assert not flight.outcome.complete
    assert "carrier: the radio is silent" in flight.outcome.reason
    assert "start" not in flight.agents["scout"].orders + flight.agents["carrier"].orders
    assert not flight.plans


def test_an_agent_that_is_not_there_is_named() -> None:
    flight = fly(absent=frozenset({"carrier"}))
    assert not flight.outcome.complete
    assert flight.outcome.reason == "not there within 60 s: carrier"


def test_a_replan_reaches_all_vehicles_before_any_of_them_goes_on() -> None:
    flight = fly(late_scout)
    assert flight.outcome.complete, flight.outcome.reason
    assert [adopted.plan.version for adopted in flight.plans[:2]] == [1, 2]
    assert "late at far" in flight.plans[1].reason
    for agent in flight.agents.values():
        assert agent.orders[:4] == ["load", "start", "load", "start"]
    runs = {mission.run for adopted in flight.plans for mission in adopted.missions}
    assert len(runs) == 1, "confirmations are told from those of earlier missions by it"
    assert run_at(1000.0) <= runs.pop() <= run_at(flight.outcome.start_s)
    # Everybody went home without a sample; what was promised is withdrawn, nothing is missing.
    assert {r.state for r in flight.coordinator.ledger.records.values()} == {"withdrawn"}


def test_one_refusal_leaves_the_old_plan_in_force_everywhere() -> None:
    def slow(agents: dict[str, FakeAgent]) -> None:
        late_scout(agents)
        agents["carrier"].refuse_version = 2

    flight = fly(slow)
    assert flight.said("plan 2 is dropped: carrier: the radio is silent")
    assert flight.agents["scout"].orders[:5] == ["load", "start", "load", "load", "start"]
    assert flight.agents["scout"].versions[:3] == [1, 2, 1]
    assert flight.agents["carrier"].versions[:2] == [1, 1]
    assert all(2 not in agent.driven for agent in flight.agents.values())
    assert [adopted.plan.version for adopted in flight.plans][:2] == [1, 3], (
        "2 was refused: it is not given again"
    )
    assert flight.outcome.complete, flight.outcome.reason


def test_a_drop_that_is_not_there_is_an_alarm_and_not_a_delivery() -> None:
    def fail(agents: dict[str, FakeAgent]) -> None:
        agents["carrier"].fails = {(Action.PICK, 1), (Action.PICK, 2)}

    flight = fly(fail)
    assert not flight.outcome.complete
    assert flight.outcome.reason == "no progress for 120 s: carrier"
    assert flight.said("failed: missing")
    assert sorted(r.state for r in flight.coordinator.ledger.records.values()) == ["cached", "delivered"]


def late_scout(agents: dict[str, FakeAgent]) -> None:
    agents["scout"].slow_s = 80.0


def go_on(mission: Mission, *, state: TeamState, warm_start: Plan, version: int) -> Plan:
    """Plan what was planned before, with its old times."""

    def from_here(robot: RobotPlan) -> RobotPlan:
        here, *later = robot.route
        if later and later[0].path:
            way = later[0].path
            later[0] = later[0].model_copy(update={"path": way[way.index(here.node) :]})
        return robot.model_copy(update={"route": (here, *later)})

    robots = tuple(from_here(robot) for robot in warm_start.robots)
    return warm_start.model_copy(update={"version": version, "robots": robots})


def states(flight: Flight) -> dict[int, str]:
    return {tag: record.state for tag, record in flight.coordinator.ledger.records.items()}


def test_a_vehicle_whose_answer_was_not_heard_never_drives_the_plan_that_was_dropped() -> None:
    def mute(agents: dict[str, FakeAgent]) -> None:
        late_scout(agents)
        agents["carrier"].mute_version = 2

    flight = fly(mute)
    assert flight.said("plan 2 is dropped")
    assert flight.agents["carrier"].versions[:3] == [1, 2, 1]
    assert all(2 not in agent.driven for agent in flight.agents.values())
    assert flight.outcome.complete, flight.outcome.reason


def test_a_vehicle_left_empty_by_failed_uploads_gets_its_mission_back() -> None:
    def fail(agents: dict[str, FakeAgent]) -> None:
        late_scout(agents)
        agents["carrier"].failed_uploads = [2, 1]  # the new mission, and then the old one

    flight = fly(fail, planner=only_once(go_straight_home))
    assert flight.said("is held: its mission could not be put back: the upload failed")
    assert flight.outcome.complete, flight.outcome.reason
    assert flight.outcome.versions == 1
    assert set(states(flight).values()) == {"delivered"}


def only_once(planner: Planner) -> Planner:
    """Plan anew once; then find that there is nothing better."""
    asked: list[int] = []

    def plan(mission: Mission, *, state: TeamState, warm_start: Plan, version: int) -> Plan:
        asked.append(version)
        if len(asked) == 1:
            return planner(mission, state=state, warm_start=warm_start, version=version)
        return warm_start.model_copy(update={"robots": (), "status": "no_plan", "reason": "asked before"})

    return plan


def test_a_vehicle_that_does_not_start_at_first_starts_later() -> None:
    flight = fly(lambda agents: setattr(agents["carrier"], "refused_starts", 1), planner=only_once(go_on))
    assert flight.said("does not go: no position estimate")
    assert flight.outcome.complete, flight.outcome.reason
    assert set(states(flight).values()) == {"delivered"}


def test_a_planner_that_fails_is_an_alarm_and_the_mission_goes_on() -> None:
    def broken(mission: Mission, *, state: TeamState, warm_start: Plan, version: int) -> Plan:
        raise MemoryError("too many ideas")

    flight = fly(late_scout, planner=broken)
    assert flight.said("planning failed, going on as planned: too many ideas")
    assert flight.outcome.complete, flight.outcome.reason
    assert flight.outcome.versions == 1
    assert set(states(flight).values()) == {"delivered"}


def test_a_plan_that_gives_away_what_is_not_there_is_an_alarm_and_the_mission_goes_on() -> None:
    def generous(mission: Mission, *, state: TeamState, warm_start: Plan, version: int) -> Plan:
        plan = go_straight_home(mission, state=state, warm_start=warm_start, version=version)
        scout, carrier = plan.robots
        home = scout.route[-1].model_copy(update={"unload": 7})
        scout = scout.model_copy(update={"route": (scout.route[0], home)})
        return plan.model_copy(update={"robots": (scout, carrier)})

    flight = fly(late_scout, planner=generous)
    assert flight.said("planning failed, going on as planned")
    assert flight.outcome.complete, flight.outcome.reason
    assert set(states(flight).values()) == {"delivered"}


def test_without_a_plan_that_keeps_the_reserve_one_without_is_asked_for_in_the_time_left() -> None:
    asked: list[tuple[float, float]] = []

    def stingy(mission: Mission, *, state: TeamState, warm_start: Plan, version: int) -> Plan:
        asked.append((mission.planner.energy_reserve, mission.replanning.time_limit_s))
        if mission.planner.energy_reserve > 0.0:
            return warm_start.model_copy(update={"robots": (), "status": "infeasible", "reason": "too far"})
        return go_straight_home(mission, state=state, warm_start=warm_start, version=version)

    flight = fly(late_scout, planner=stingy)
    assert flight.said("the energy reserve cannot be kept: too far")
    assert flight.outcome.complete, flight.outcome.reason
    assert flight.outcome.versions >= 2
    limit_s = relay_mission().replanning.time_limit_s
    assert asked[0] == (relay_mission().replanning.energy_reserve, limit_s)
    assert asked[1][0] == 0.0
    assert asked[1][1] <= limit_s


def test_replans_that_change_nothing_touch_no_vehicle_and_keep_every_tag() -> None:
    flight = fly(late_scout, planner=go_on)
    assert flight.outcome.complete, flight.outcome.reason
    assert flight.outcome.versions >= 3
    for agent in flight.agents.values():
        assert agent.versions == [1]
    assert states(flight) == {1: "delivered", 2: "delivered"}


def test_confirmations_that_come_long_after_the_vehicle_went_on_lose_nothing() -> None:
    def slow_link(agents: dict[str, FakeAgent]) -> None:
        agents["carrier"].slow_s = 80.0
        for agent in agents.values():
            agent.confirm_after_s = 45.0

    flight = fly(slow_link, planner=go_on)
    assert flight.outcome.complete, flight.outcome.reason
    assert flight.outcome.versions >= 2
    assert states(flight) == {1: "delivered", 2: "delivered"}
    assert not flight.said("custody does not add up")
