"""Branch and price as a whole: the same optimum as over arcs, honest bounds, and a stop at any moment."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest
from circle_cases import circle
from random_missions import part_way, tiny_mission
from team_cases import alike, quickest, scaled, search

from malipp_field.bench.instances import Specification, build
from malipp_field.mission import Mission, TeamState
from malipp_field.planner import solve, verify
from malipp_field.planner.exact.arcs import InformationStage
from malipp_field.planner.exact.stages import plan_of_precision
from malipp_field.planner.exact.tree import ColumnStage
from malipp_field.planner.progress import Progress, Result
from malipp_field.planner.search.improver import Improver

_GAP = 1e-6
_BUDGET_J = 30.0


def by_schedules(mission: Mission, state: TeamState | None = None, **options: Any) -> Result:
    return ColumnStage(scaled(mission, state)[0], search(gap=_GAP, **options), None).run()


def by_arcs(mission: Mission, state: TeamState | None = None) -> Result:
    return InformationStage(scaled(mission, state)[0], search(gap=_GAP), None).run()


def compare(mission: Mission, state: TeamState | None = None) -> None:
    found, expected = by_schedules(mission, state), by_arcs(mission, state)
    assert found.proven
    assert expected.proven
    assert found.infeasible == expected.infeasible
    if expected.team is None:
        assert found.team is None
        return
    assert found.team is not None
    assert found.team.information == pytest.approx(expected.team.information, rel=4 * _GAP)
    assert found.bound <= expected.team.information * (1 + 1e-8)


def three_classes(seed: int) -> Mission:
    record = tiny_mission(seed, robots=3, candidates=2).model_dump(
        mode="json", by_alias=True, exclude_none=True
    )
    for robot, noise_variance in zip(record["team"]["robots"], (0.03, 0.1, 0.5), strict=True):
        robot |= {"noise_variance": noise_variance, "samples_per_node": 1, "energy_budget_j": 20.0}
    return Mission.model_validate(record)


@pytest.mark.parametrize(("seed", "robots"), [(3, 2), (11, 2), (12, 3)])
def test_robots_that_are_all_alike(seed: int, robots: int) -> None:
    compare(alike(seed, robots=robots, candidates=5 - robots))


@pytest.mark.parametrize("seed", [5, 21])
def test_two_samples_at_a_place(seed: int) -> None:
    compare(alike(seed, candidates=2, samples_per_node=2))


@pytest.mark.parametrize("seed", [31, 32])
def test_three_classes_of_sensors(seed: int) -> None:
    compare(three_classes(seed))


@pytest.mark.parametrize("seed", [60, 62, 63, 65])
def test_part_way(seed: int) -> None:
    mission = tiny_mission(seed, candidates=2)
    compare(mission, part_way(mission, seed))


def test_a_residual_mission_that_cannot_be_done_is_recognised() -> None:
    mission = tiny_mission(1, candidates=2, payload_capacity=1)
    state = part_way(mission, 1)
    robots = tuple(robot.model_copy(update={"energy_left_j": 0.01}) for robot in state.robots)
    result = by_schedules(mission, state.model_copy(update={"robots": robots}))
    assert result.infeasible
    assert result.proven
    assert result.team is None


@pytest.mark.parametrize("budget_j", [9.5, 10.5])
def test_a_circle_of_waits_is_no_plan(budget_j: float) -> None:
    mission = circle(budget_j=budget_j)
    compare(mission)
    team = by_schedules(mission).team
    assert team is not None
    assert np.count_nonzero(team.precision) == 1


def test_a_precision_is_planned_for_or_proven_impossible() -> None:
    problem, _ = scaled(circle())
    precise = problem.robots[0].precision
    for wanted in itertools.product((0.0, precise), repeat=2):
        team, impossible = plan_of_precision(problem, search(), np.array(wanted))
        assert impossible == all(wanted)
        assert (team is None) == impossible
        if team is not None:
            assert team.precision == pytest.approx(wanted)
    assert plan_of_precision(problem, search(limit_s=0.0), np.array([precise, 0.0])) == (None, False)


def test_what_a_circle_shuts_out_does_not_take_the_next_best_with_it() -> None:
    compare(circle(extra=True))


def test_a_circle_of_two_samples_each_is_decided() -> None:
    compare(circle(samples=2))


def test_the_proof_does_not_lean_on_ruin_and_recreate(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Improver, "improve", lambda _, team, *__: team)
    compare(circle(extra=True))


def drawn() -> Mission:
    return build(Specification(3, 8, 1), _BUDGET_J)


def test_the_same_seed_and_work_give_the_same_plan() -> None:
    one, other = (solve(drawn(), method="exact", seed=3, work_limit=4, mip_gap=_GAP, time_limit_s=60.0)
                  for _ in range(2))  # fmt: skip
    unlike = {"solve_time_s": 0.0}
    assert one.model_copy(update=unlike) == other.model_copy(update=unlike)


def test_bounds_only_rise_and_never_pass_the_optimum() -> None:
    for mission in (drawn(), alike(12, robots=3, candidates=2), circle()):
        heard: list[Progress] = []
        result = by_schedules(mission, on_progress=heard.append)
        assert result.team is not None
        assert result.proven
        bounds = [p.bound for p in heard if p.bound is not None]
        incumbents = [p.incumbent for p in heard if p.incumbent is not None]
        assert bounds == sorted(bounds)
        assert incumbents == sorted(incumbents, reverse=True)
        assert max(bounds) <= result.team.information * (1 + 1e-9)


def test_a_time_limit_is_kept() -> None:
    solve(drawn(), method="exact", work_limit=1, time_limit_s=60.0)  # compiles
    mission = build(Specification(8, 20, 0), _BUDGET_J)
    plan, took_s = quickest(lambda: solve(mission, method="exact", mip_gap=_GAP, time_limit_s=3.0), 4.5)
    assert took_s < 4.5
    assert plan.robots
    assert not verify(mission, plan)


@pytest.mark.parametrize("asks", [0, 1, 2, 5, 20, 60])
def test_whoever_cancels_gets_the_best_plan_so_far(asks: int) -> None:
    left = itertools.count(asks, -1)
    heard: list[Progress] = []
    result = by_schedules(drawn(), on_progress=heard.append, cancelled=lambda: next(left) <= 0)
    assert result.team is not None
    assert result.bound <= result.team.information
    known = [p.incumbent for p in heard if p.incumbent is not None]
    assert result.team.information == min(known, default=result.team.information)


@pytest.mark.parametrize("scale", [1e-6, 1e6])
@pytest.mark.parametrize("method", ["exact", "arcs"])
def test_the_unit_of_the_field_changes_nothing_but_that_of_j(method: Any, scale: float) -> None:
    mission = tiny_mission(202, candidates=2)
    record = mission.model_dump(mode="json", by_alias=True, exclude_none=True)
    record["field"]["kernel"]["variance"] = scale * mission.field.kernel.variance
    for robot in record["team"]["robots"]:
        robot["noise_variance"] *= scale
    plain, other = (solve(m, method=method, mip_gap=_GAP, time_limit_s=60.0)
                    for m in (mission, Mission.model_validate(record)))  # fmt: skip
    assert plain.status == other.status == "optimal"
    assert plain.objective is not None
    assert other.objective is not None
    assert other.objective.information == pytest.approx(scale * plain.objective.information, rel=1e-6)
    assert other.objective.energy_j == pytest.approx(plain.objective.energy_j, rel=1e-6)
    assert other.objective.makespan_s == pytest.approx(plain.objective.makespan_s, rel=1e-6)
    assert [[s.node for s in r.route] for r in other.robots] == [
        [s.node for s in r.route] for r in plain.robots
    ]
