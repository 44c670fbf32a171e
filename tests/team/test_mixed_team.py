"""A team of three kinds of payload hardware from first step to last, and what goes wrong on the way."""

from __future__ import annotations

import asyncio
import random
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from random_team import random_mission, random_plan, truth_and_ledger
from team_on_a_table import Team

from malipp_field.mission import Mission, TeamState, read_mission
from malipp_field.mission.vehicles import VehicleSettings
from malipp_field.plan import Plan
from malipp_field.planner import solve
from malipp_field.sim.world import Outcome
from malipp_field.vehicle.steps import Action

MIXED = Path(__file__).parents[2] / "missions" / "corridor-mixed.yaml"


@pytest.fixture(scope="module")
def flown() -> Team:
    mission = read_mission(MIXED)
    team = Team(mission, solve(mission, threads=1))
    assert team.run().complete
    return team


def test_every_action_of_the_mixed_team_is_confirmed_by_whom_it_should_be(flown: Team) -> None:
    (plan,) = flown.plans
    wanted = {
        step.uid for m in plan.missions for step in m.steps if step.action not in (Action.DRIVE, Action.WAIT)
    }
    assert [c.uid for c in flown.confirmations if c.ok] == [c.uid for c in flown.confirmations]
    assert sorted(c.uid for c in flown.confirmations) == sorted(wanted)
    witnesses = {(c.robot, c.by) for c in flown.confirmations}
    assert witnesses == {("scout", "script"), ("carrier", "progress"), ("helper", "person")}
    handed = {(c.robot, c.action) for c in flown.confirmations}
    assert {("scout", Action.DROP), ("helper", Action.DROP), ("carrier", Action.PICK)} <= handed


def test_the_ledger_of_the_mixed_team_is_the_truth(flown: Team) -> None:
    truth, ledger = truth_and_ledger(flown)
    assert truth == ledger
    assert {record.state for record in flown.ledger.samples} == {"delivered"}
    for record in flown.ledger.samples:
        real = flown.world.containers.get(record.sample.tag)
        if record.value is not None and real is not None:  # the script and the person put the tag on
            assert (real.node, real.sampler) == (record.sample.node, record.sample.sampler)


def handover(if_missing: str, profile: str = "script") -> tuple[Mission, Plan]:
    """Return a mission in which all vehicles have the same hardware, and a plan with two handoffs."""
    rng = random.Random(3)
    mission = random_mission(rng, gates=("custody",), sand=False, profiles=(profile,))
    vehicles = {
        robot: VehicleSettings.model_validate({**s.model_dump(), "if_missing": if_missing})
        for robot, s in mission.vehicles.items()
    }
    mission = mission.model_copy(update={"vehicles": vehicles})
    return mission, random_plan(rng, mission)


def steal(team: Team) -> None:
    """Take the first container that lies anywhere, once."""
    if team.world.caches() and all(c.holder or c.place for c in team.world.containers.values()):
        team.world.remove(next(iter(team.world.caches())))


def test_a_mission_goes_on_without_a_missing_sample_and_says_which_it_is() -> None:
    mission, plan = handover("go_on")
    team = Team(mission, plan, watch=steal)
    outcome = team.run()
    (missing,) = (record for record in team.ledger.samples if record.state == "lost")
    assert (outcome.complete, outcome.reason) == (
        False,
        "all vehicles are done, but 1 sample is not home: "
        f"{missing.sample.tag} from {missing.sample.node} (missing, last at {missing.holder})",
    )
    assert missing.history[-1].action is Action.DROP
    assert missing.holder == missing.history[-1].node
    assert all(track.finished for track in team.coordinator.tracks.values())
    assert any(text.startswith("goes on without the pick of container") for text in team.events)
    rest = [record for record in team.ledger.samples if record.state != "lost"]
    assert {record.state for record in rest} <= {"delivered"}


def test_a_vehicle_told_to_hold_holds_and_says_what_a_person_can_do() -> None:
    mission, plan = handover("hold")
    team = Team(mission, plan, watch=steal)
    outcome = team.run()
    assert not outcome.complete
    assert "waits for a person: pick container" in outcome.reason
    (alarm,) = (text for text in team.events if " failed: missing" in text)
    assert "malipp confirm" in alarm
    assert "set it to AUTO" in alarm


def no_bag_for_the_first(team: Team) -> None:
    """Let the person find rock where the first sample was to be taken."""
    for rover in team.fleet.rovers.values():
        rover.autopilot.attended = partial(_rock, rover.autopilot.attended)  # type: ignore[method-assign]


def _rock(work: Callable[[Action, int], Outcome], action: Action, tag: int) -> Outcome:
    return Outcome("unknown") if (action, tag) == (Action.COLLECT, 1) else work(action, tag)


def test_a_receiver_waits_in_vain_for_what_could_not_be_taken_where_there_is_no_new_plan() -> None:
    team = Team(*handover("hold", profile="manual"))
    no_bag_for_the_first(team)
    outcome = team.run()
    assert not outcome.complete
    assert any("counts on container 1 at" in text for text in team.events)
    assert not [c for c in team.confirmations if c.tag == 1 and c.action is Action.PICK]


def test_with_a_new_plan_nobody_waits_for_what_could_not_be_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    async def at_once(work: Callable[..., Plan], *inputs: Any, **options: Any) -> Plan:
        return work(*inputs, **options)  # no time passes while planning, so every run is the same

    monkeypatch.setattr(asyncio, "to_thread", at_once)

    def planner(mission: Mission, *, state: TeamState, warm_start: Plan, version: int) -> Plan:
        return solve(mission, state=state, warm_start=warm_start, version=version, threads=1, method="exact")

    team = Team(*handover("hold", profile="manual"), planner=planner)
    no_bag_for_the_first(team)
    outcome = team.run()
    assert outcome.complete, (outcome.reason, team.events)
    assert outcome.reason.endswith("not taken: container 1")
    assert len(team.plans) > 1
    (rock,) = {record.sample.node for record in team.ledger.samples if record.sample.tag == 1}
    new = [stop for robot in team.plans[-1].plan.robots for stop in robot.route]
    assert rock not in {stop.node for stop in new if stop.collect}
    assert all(m.payload == team.mission.vehicle(m.robot).payload for m in team.plans[-1].missions)
    truth, ledger = truth_and_ledger(team)
    assert truth == ledger
