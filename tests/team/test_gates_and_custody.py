"""Random plans carried out by simulated teams with every kind of payload hardware."""

from __future__ import annotations

import random

import pytest
from random_team import PROFILES, GateWatch, random_mission, random_plan, truth_and_ledger
from team_on_a_table import START_S, Team

MIDNIGHT_S = START_S - START_S % 86400.0


@pytest.mark.parametrize("seed", range(5))
def test_with_custody_gates_every_sample_comes_home_and_the_ledger_is_the_truth(seed: int) -> None:
    rng = random.Random(seed)
    mission = random_mission(rng, gates=("custody",), sand=seed % 2 == 1)
    watch = GateWatch()
    team = Team(mission, random_plan(rng, mission), watch=watch)
    outcome = team.run()
    assert outcome.complete, (outcome.reason, team.events)
    assert all(c.ok for c in team.confirmations)
    assert {c.uid for c in team.confirmations} == {
        step.uid
        for m in team.plans[0].missions
        for step in m.steps
        if step.action.value not in ("drive", "wait")
    }
    assert (len(watch.seen) > 1, watch.early) == (True, set())
    truth, ledger = truth_and_ledger(team)
    assert truth == ledger


@pytest.mark.parametrize("seed", range(5))
def test_no_pick_begins_before_its_drop_or_its_time_whatever_is_late(seed: int) -> None:
    """Vehicles keep the time by themselves, over midnight too, and the first one's link is cut on the way."""
    rng = random.Random(100 + seed)
    mission = random_mission(rng, gates=("time", "time", "custody"), sand=True)
    watch = GateWatch()
    plan = random_plan(rng, mission)
    first = next(robot.id for robot in plan.robots if any(stop.collect and stop.drop for stop in robot.route))

    def cut(team: Team) -> None:
        begun_s = team.clock.now_s() - team.coordinator._start_s
        team.wires[first].cut = seed % 2 == 0 and 5.0 < begun_s < 90.0
        watch(team)

    start_s = MIDNIGHT_S - rng.uniform(10.0, 60.0)
    team = Team(mission, plan, start_s=start_s, watch=cut)
    team.run()
    assert watch.seen


def test_a_vehicle_too_late_for_its_delay_is_let_pass_when_the_drop_is_confirmed() -> None:
    rng = random.Random(7)
    mission = random_mission(rng, gates=("time",), sand=True, profiles=PROFILES[2:3])
    team = Team(mission, random_plan(rng, mission))
    outcome = team.run()
    gates = [step.not_before_s for m in team.plans[0].missions for step in m.steps if step.not_before_s]
    assert gates
    assert outcome.end_s > max(gates)
    assert outcome.end_s - outcome.start_s < 3600.0, "nobody waited until tomorrow"
    assert outcome.complete, outcome.reason
