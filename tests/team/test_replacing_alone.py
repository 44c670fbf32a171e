"""A new plan that concerns one vehicle only: it need not stop for its new mission, where that is safe."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

import pytest
from team_on_a_table import Team

from malipp_field.bus import Reply
from malipp_field.mission import Mission, TeamState, parse_mission
from malipp_field.plan import Plan, RobotPlan, Stop

SITE = """
format: malipp-mission/1
name: lane
site:
  origin: {lat_deg: 52.48, lon_deg: 13.785}
  nodes:
    - {id: base, x_m: 0.0, y_m: 0.0, role: depot}
    - {id: near, x_m: 300.0, y_m: 0.0}
    - {id: far, x_m: 600.0, y_m: 0.0}
  complete: true
field:
  kernel: {family: rbf, length_scale_m: 30.0}
  test_points: [{x_m: 300.0, y_m: 0.0}]
replanning: {slip_s: 5.0, stall_s: 90.0, time_limit_s: 2}
simulation:
  parameters: {FS_GCS_ENABLE: %d, FS_THR_ENABLE: 0}
  terrain: [{x_m: %d, y_m: 0.0, radius_m: 40.0, speed_factor: 0.4}]
team:
  sample_mass_kg: 1.0
  service_time_s: 4.0
  robots:
    - {id: r1, start: base, depots: [base], empty_mass_kg: 10.0, energy_budget_j: 1.0e+7,
       payload_capacity: 9, samples_per_node: 2, noise_variance: 0.1, energy_per_kg_m: 1.0, speed_m_s: 5.0}
vehicles:
  r1: {payload: script}
"""
AUTO, HOLD = 10, 4


def to_far_and_home() -> Plan:
    near = Stop(
        node="near",
        path=("base", "near"),
        arrive_s=64.0,
        depart_s=68.0,
        leg_energy_j=1.0,
        collect=1,
        payload=1,
    )
    far = Stop(
        node="far",
        path=("near", "far"),
        arrive_s=128.0,
        depart_s=132.0,
        leg_energy_j=1.0,
        collect=1,
        payload=2,
    )
    home = Stop(
        node="base",
        path=("far", "base"),
        arrive_s=252.0,
        depart_s=256.0,
        leg_energy_j=1.0,
        unload=2,
        payload=0,
    )
    return Plan(
        mission="lane", method="by hand", status="feasible", solve_time_s=0.0,
        robots=(RobotPlan(id="r1", route=(Stop(node="base", depart_s=4.0, payload=0), near, far, home)),),
    )  # fmt: skip


def home_from_there(mission: Mission, *, state: TeamState, warm_start: Plan, version: int) -> Plan:
    (robot,) = state.robots
    take = int(robot.node != "base" and robot.on_board == 0)
    load = robot.on_board + take
    here = Stop(node=robot.node, depart_s=robot.ready_s + 4.0, collect=take, payload=load)
    home = Stop(
        node="base", path=(robot.node, "base"), arrive_s=robot.ready_s + 64.0, depart_s=robot.ready_s + 68.0,
        leg_energy_j=1.0, unload=load, payload=0,
    )  # fmt: skip
    return warm_start.model_copy(
        update={"version": version, "robots": (RobotPlan(id="r1", route=(here, home)),)}
    )


class Onlooker:
    """Sees in which modes the rover is once it has set out."""

    def __init__(self) -> None:
        self.modes: list[int] = []

    def __call__(self, team: Team) -> None:
        mode = team.fleet.rovers["r1"].autopilot.mode
        if self.modes[-1:] != [mode] and (self.modes or mode == AUTO):
            self.modes.append(mode)


@pytest.fixture
def at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    async def think(work: Callable[..., Plan], *inputs: Any, **options: Any) -> Plan:
        return work(*inputs, **options)  # no time passes while planning, so every run is the same

    monkeypatch.setattr(asyncio, "to_thread", think)


def team_with(failsafe: int, onlooker: Onlooker, sand_at_m: int = 60) -> Team:
    mission = parse_mission(SITE % (failsafe, sand_at_m))
    return Team(mission, to_far_and_home(), planner=home_from_there, watch=onlooker)


@pytest.mark.parametrize(("failsafe", "modes"), [(1, [AUTO]), (0, [AUTO, HOLD, AUTO])])
@pytest.mark.parametrize("sand_at_m", [60, 360])
@pytest.mark.usefixtures("at_once")
def test_a_vehicle_whose_own_failsafe_makes_it_safe_does_not_stop(
    sand_at_m: int, failsafe: int, modes: list[int]
) -> None:
    """On its first leg, and on a later one: that keeps its number in the new mission."""
    onlooker = Onlooker()
    team = team_with(failsafe, onlooker, sand_at_m)
    outcome = team.run()
    assert outcome.complete, (outcome.reason, team.events)
    assert "plan 2 is in force; it changes r1" in team.events
    assert onlooker.modes == modes
    assert {record.state for record in team.ledger.samples} == {"delivered", "withdrawn"}


@pytest.mark.parametrize("heard", [True, False])
@pytest.mark.usefixtures("at_once")
def test_a_new_mission_whose_answer_was_lost_is_in_force_all_the_same(heard: bool) -> None:
    """The vehicle drives it already; where it is not there, the old one is given back."""
    team = team_with(1, Onlooker())
    agent, lost = team.agents["r1"], list[Any]()

    async def mute(command: Any) -> Reply:
        wanted = getattr(command.order, "mission", None)
        if wanted is None or wanted.version == 1 or lost:
            return await type(agent)._answer(agent, command)
        lost.append(command)
        answer = await type(agent)._answer(agent, command) if heard else None
        return Reply(time_s=team.clock.now_s(), ok=False, text=f"no answer ({answer})")

    agent._answer = mute  # type: ignore[method-assign]
    outcome = team.run()
    assert lost
    assert outcome.complete, (outcome.reason, team.events)
    dropped = [text for text in team.events if "is dropped" in text]
    assert (outcome.versions == 2 and not dropped) if heard else dropped
