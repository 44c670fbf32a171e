"""Agents that are started again in mid-mission, and vehicles whose mission somebody else changes."""

from __future__ import annotations

import random
from collections.abc import Callable

import pytest
from random_team import PROFILES, GateWatch, random_mission, random_plan, truth_and_ledger
from team_on_a_table import Team

from malipp_field.sim import Rover
from malipp_field.vehicle.layout import lay_out

MANUAL, HOLD, AUTO = 0, 4, 10
SCRIPT, BY_HAND, SERVO, MIXED = PROFILES


def team_of(seed: int, watch: Callable[[Team], None], *profiles: str) -> Team:
    rng = random.Random(seed)
    mission = random_mission(rng, gates=("custody",), sand=False, profiles=profiles or PROFILES)
    return Team(mission, random_plan(rng, mission), watch=watch)


def all_is_well(team: Team) -> None:
    """Every action was done, confirmed once, and is in the ledger as it was."""
    outcome = team.run()
    assert outcome.complete, (outcome.reason, team.events)
    uids = [c.uid for c in team.confirmations]
    assert sorted(uids) == sorted(
        step.uid
        for m in team.plans[0].missions
        for step in m.steps
        if step.action.value not in ("drive", "wait")
    )
    assert all(c.ok for c in team.confirmations)
    truth, ledger = truth_and_ledger(team)
    assert truth == ledger


class Reaper:
    """Kills one agent after the other at random moments of the mission, and starts it again later."""

    def __init__(self, seed: int) -> None:
        self._chance = random.Random(seed)
        self._told_late = seed % 2 == 1  # of an end, when the next agent is at work
        self._due_s: float | None = None
        self._to_tell: tuple[str, float] | None = None
        self._dead: str | None = None
        self.kills, self.held = 0, 0
        self._gates = GateWatch()

    def __call__(self, team: Team) -> None:
        self._gates(team)
        if not team.coordinator._under_way:
            return
        pilots = [rover.autopilot for rover in team.fleet.rovers.values()]
        self.held += sum(pilot.armed and pilot.mode != AUTO for pilot in pilots)
        now_s = team.clock.now_s()
        if self._due_s is None:
            self._due_s = now_s + self._chance.uniform(1.0, 15.0)
        if self._to_tell is not None and now_s >= self._to_tell[1]:
            team.tell_of_end(self._to_tell[0])
            self._to_tell = None
        if now_s < self._due_s:
            return
        if self._dead is None:
            self._dead, self.kills = self._chance.choice(sorted(team.fleet.rovers)), self.kills + 1
            team.kill_agent(self._dead)
            self._due_s = now_s + self._chance.uniform(0.4, 12.0)
            self._to_tell = self._dead, (self._due_s + 2.0 if self._told_late else now_s)
        else:
            team.start_agent(self._dead)
            self._dead, self._due_s = None, now_s + self._chance.uniform(9.0, 25.0)


@pytest.mark.parametrize("seed", range(4))
def test_agents_that_die_again_and_again_stop_nobody_and_nothing_is_done_twice(seed: int) -> None:
    reaper = Reaper(seed)
    team = team_of(seed, reaper)
    all_is_well(team)
    assert reaper.kills >= 3
    assert reaper.held == 0
    assert not any("left to a person" in text for text in team.events)


def another_mission(team: Team, robot: str) -> None:
    """Somebody uploads another mission over a link of their own."""
    pilot = team.fleet.rovers[robot].autopilot
    steps = team.coordinator.tracks[robot].mission.steps[-1:]
    mission = team.coordinator.tracks[robot].mission.model_copy(update={"steps": steps})
    pilot.store.items[1:] = lay_out(mission).items[1:]


def working(team: Team) -> tuple[str, Rover] | None:
    """Return a vehicle that is in the midst of its mission."""
    for robot, track in team.coordinator.tracks.items():
        rover = team.fleet.rovers[robot]
        if team.coordinator._under_way and track.current >= 1 and not track.finished:
            return robot, rover
    return None


def test_a_vehicle_that_was_given_another_mission_gets_ours_back_and_loses_nothing() -> None:
    given: list[str] = []

    def meddle(team: Team) -> None:
        if not given and (found := working(team)) is not None:
            given.append(found[0])
            another_mission(team, found[0])

    team = team_of(2, meddle)
    all_is_well(team)
    assert [text for text in team.events if "did not know its mission" in text] == [
        "its agent did not know its mission any more: it was put back"
    ]


def test_there_is_no_fight_with_somebody_who_changes_it_again_and_again() -> None:
    given: list[str] = []

    def meddle(team: Team) -> None:
        found = (given[0], team.fleet.rovers[given[0]]) if given else working(team)
        if found is None or found[1].autopilot.mode != AUTO:
            return
        given.append(found[0])
        another_mission(team, found[0])

    team = team_of(2, meddle)
    outcome = team.run()
    assert not outcome.complete
    assert given[0] in outcome.reason
    assert sum("it was put back" in text for text in team.events) == 3
    assert sum("put back 3 times at this step" in text for text in team.events) == 1
    assert team.fleet.rovers[given[0]].autopilot.mode == HOLD


def test_who_takes_a_vehicle_over_keeps_it_and_can_give_it_back() -> None:
    taken: dict[str, float] = {}

    def take(team: Team) -> None:
        if not taken and (found := working(team)) is not None:
            taken[found[0]] = team.clock.now_s()
            found[1].autopilot.set_mode(MANUAL)
        for robot, since_s in taken.items():
            after_s, pilot = round(team.clock.now_s() - since_s, 1), team.fleet.rovers[robot].autopilot
            assert after_s > 40.0 or pilot.mode == MANUAL
            assert after_s <= 40.0 or after_s > 45.0 or pilot.mode == HOLD
            if after_s == 5.0:
                another_mission(team, robot)
            if after_s == 40.0:
                pilot.set_mode(HOLD)

    team = team_of(2, take)
    all_is_well(team)
    assert sum("left to a person" in text for text in team.events) == 1


@pytest.mark.parametrize("profile", [SCRIPT, SERVO])
def test_a_vehicle_that_somebody_holds_is_not_set_in_motion_by_an_agent_that_starts_again(
    profile: str,
) -> None:
    began: list[tuple[str, float]] = []

    def hold(team: Team) -> None:
        now_s = team.clock.now_s()
        if not began and (found := working(team)) is not None:
            began.append((found[0], now_s))
            found[1].autopilot.set_mode(HOLD)
        for robot, since_s in began:
            after_s, pilot = round(now_s - since_s, 1), team.fleet.rovers[robot].autopilot
            assert after_s >= 40.0 or pilot.mode == HOLD
            if after_s == 3.0:
                team.kill_agent(robot)
                team.tell_of_end(robot)
            elif after_s == 6.0:
                team.start_agent(robot)
            elif after_s == 40.0:
                pilot.set_mode(AUTO)

    team = team_of(2, hold, profile)
    all_is_well(team)
    assert any("it was held before that" in text.lower() for text in team.events)
