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
from malipp_field.control import Coordinator, Outcome
from malipp_field.mission import Mission, TeamState
from malipp_field.plan import Plan, RobotPlan, Stop
from malipp_field.vehicle.steps import Action

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
                mission, MISSION, drop_plan(), bus, clock, go_straight_home, witnesses=("listener",)
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
    def slow(agents: dict[str, FakeAgent]) -> None:
        agents["scout"].pace = 0.3

    flight = fly(slow)
    assert flight.outcome.complete, flight.outcome.reason
    assert [adopted.plan.version for adopted in flight.plans[:2]] == [1, 2]
    assert "late at far" in flight.plans[1].reason
    for agent in flight.agents.values():
        assert agent.orders[:4] == ["load", "start", "load", "start"]
    # Everybody went home without a sample; what was promised is withdrawn, nothing is missing.
    assert {r.state for r in flight.coordinator.ledger.records.values()} == {"withdrawn"}


def test_one_refusal_leaves_the_old_plan_in_force_everywhere() -> None:
    def slow(agents: dict[str, FakeAgent]) -> None:
        agents["scout"].pace = 0.3
        agents["carrier"].refuse_version = 2

    flight = fly(slow)
    assert flight.said("plan 2 is dropped: carrier: the radio is silent")
    assert flight.agents["scout"].orders[:5] == ["load", "start", "load", "load", "start"]
    assert flight.agents["scout"].versions[:3] == [1, 2, 1]
    assert flight.agents["carrier"].versions == [1]
    assert flight.outcome.complete, flight.outcome.reason


def test_a_drop_that_is_not_there_is_an_alarm_and_not_a_delivery() -> None:
    def fail(agents: dict[str, FakeAgent]) -> None:
        agents["carrier"].fails = {(Action.PICK, 1), (Action.PICK, 2)}

    flight = fly(fail)
    assert not flight.outcome.complete
    assert flight.outcome.reason == "no progress for 120 s: carrier"
    assert flight.said("failed: missing")
    assert sorted(r.state for r in flight.coordinator.ledger.records.values()) == ["cached", "delivered"]
