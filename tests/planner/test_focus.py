"""Groups of a large team: results are verified and never worse, samples of others stay, seeds decide all."""

from __future__ import annotations

import math
from itertools import islice
from typing import Any

import numpy as np
import pytest
from random_missions import part_way, tiny_mission

from malipp_field.bench.instances import Specification, build
from malipp_field.mission import Mission, TeamState, initial_state
from malipp_field.planner import verify
from malipp_field.planner.draft import COLLECTED, Draft, draft_of, handlers
from malipp_field.planner.extract import TeamPlan, Verdict, plan_file, team_plan
from malipp_field.planner.linear import Effort
from malipp_field.planner.problem import Problem, build_problem
from malipp_field.planner.search import focus
from malipp_field.planner.search.focus import Focus
from malipp_field.planner.search.focus_slice import cut, given, packed
from malipp_field.planner.search.improver import Improver
from malipp_field.planner.search.kernel import Kernel
from malipp_field.planner.search.state import load

FOREVER = Effort(deadline=math.inf)


def case(seed: int, **changes: Any) -> tuple[Mission, TeamState]:
    """Return a mission of four robots with two depots, for every odd seed part-way."""
    mission = tiny_mission(seed, robots=4, candidates=6, **changes)
    return mission, part_way(mission, seed) if seed % 2 else initial_state(mission)


def verified(mission: Mission, problem: Problem, team: TeamPlan, state: TeamState) -> TeamPlan:
    plan = plan_file(mission.name, problem, team, Verdict("exact", "feasible", None, None, 0.0, 0, 1))
    assert not verify(mission, plan, state)
    return team


def good_plan(problem: Problem, seed: int) -> TeamPlan | None:
    improver = Improver(problem, seed)
    team = improver.construct()
    return None if team is None else improver.improve(team, 200, FOREVER)


@pytest.fixture(autouse=True)
def _groups_of_two(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(focus, "_LEAST_TEAM", 2)
    monkeypatch.setattr(focus, "_MOST_TEAM", 3)
    monkeypatch.setattr(focus, "_FIRST_ITERATIONS", 100)


@pytest.mark.parametrize("seed", range(500, 524))
def test_rounds_are_verified_and_never_worse(seed: int) -> None:
    mission, state = case(seed)
    problem = build_problem(mission, state, handoffs=seed % 7 != 0)
    search = Focus(problem, seed, 2)
    team = search.construct()
    assert team is not None
    for found in islice(search.rounds(verified(mission, problem, team, state), FOREVER), 6):
        assert found.rank <= team.rank
        team = verified(mission, problem, found, state)


@pytest.mark.parametrize("seed", range(540, 552))
def test_what_a_group_does_for_others_stays(seed: int) -> None:
    mission, state = case(seed, energy_budget_j=40.0)
    problem = build_problem(mission, state)
    team = good_plan(problem, seed)
    assert team is not None
    draft = draft_of(problem, team)
    for group in ([0, 1], [2, 3], [0, 3], [1, 2]):
        shared = [s for s in draft.samples if len(handlers(s) & set(group)) and not handlers(s) <= set(group)]
        part = cut(draft, group, np.random.default_rng(seed))
        assert part.case.fixed_collect.sum() == sum(s.kind == COLLECTED and s.robot in group for s in shared)
        merged = part.merged(draft, part.draft(draft))
        assert sorted(merged.samples) == sorted(draft.samples)
        found = focus._searched(part, draft, seed, 300, FOREVER)
        if found is None:
            continue
        trial = part.merged(draft, found)
        assert not set(shared) - set(trial.samples)
        better = team_plan(problem, trial.visits())
        if better is not None:  # None: a circle through robots outside
            verified(mission, problem, better, state)


def test_there_are_samples_that_robots_of_two_groups_handle() -> None:
    mission = build(Specification(4, 14, seed=1), 30.0)
    problem = build_problem(mission)
    team = good_plan(problem, 1)
    assert team is not None
    draft, counted = draft_of(problem, team), 0
    for group in ([0, 1], [2, 3], [0, 2], [1, 3]):
        fixed = cut(draft, group, np.random.default_rng(0)).case
        counted += int(fixed.fixed_give.sum() + fixed.fixed_take.sum())
        found = focus._searched(cut(draft, group, np.random.default_rng(0)), draft, 3, 300, FOREVER)
        if found is not None:
            merged = cut(draft, group, np.random.default_rng(0)).merged(draft, found)
            better = team_plan(problem, merged.visits())
            assert better is None or verified(mission, problem, better, initial_state(mission))
    assert counted > 0


def test_a_group_sees_j_loads_and_energies_of_the_whole_plan() -> None:
    problem = build_problem(build(Specification(6, 18, seed=1), 30.0))
    team = good_plan(problem, 1)
    assert team is not None
    draft = draft_of(problem, team)
    part = cut(draft, [0, 1, 4], np.random.default_rng(0))
    own = part.draft(draft)
    kernel = Kernel(part.case, int(part.case.limits.sum()) + len(own.samples) + 1, 2, 0)
    load(kernel.best, own)
    assert kernel.begin()
    whole = Improver(problem, 0)
    assert whole._begin(team)
    state = whole._kernel.best
    assert kernel.best.energy_j == pytest.approx(state.energy_j[[0, 1, 4]], rel=1e-12)
    stops = kernel.best.depart.shape[1]
    assert (kernel.best.depart == state.depart[[0, 1, 4], :stops]).all()
    far = (
        problem.information.prior
        - given(problem.information, problem.gained, np.arange(len(problem.candidates))).prior
    )
    assert kernel.best.value[0] + far == pytest.approx(team.information, rel=1e-5)


def test_a_seed_decides_the_plan() -> None:
    problem = build_problem(build(Specification(8, 31, seed=0), 30.0))

    def found(seed: int, effort: Effort = FOREVER) -> TeamPlan:
        search = Focus(problem, seed, 2)
        start = search.construct()
        assert start is not None
        return list(islice(search.rounds(start, effort), 4))[-1]

    assert found(1).routes == found(1).routes
    assert found(1).routes != found(2).routes
    assert found(1).information < 0.9 * problem.information.prior


def test_no_round_without_time() -> None:
    problem = build_problem(build(Specification(4, 14, seed=0), 30.0))
    search = Focus(problem, 0, 2)
    start = search.construct()
    assert start is not None
    assert not list(search.rounds(start, Effort(deadline=-math.inf)))


def test_j_given_what_others_gain_is_j() -> None:
    information = build_problem(build(Specification(4, 14, seed=3), 30.0)).information
    rng = np.random.default_rng(0)
    outside = np.where(rng.uniform(size=14) < 0.5, rng.uniform(1.0, 30.0, 14), 0.0)
    some = np.array([1, 4, 5, 9])
    part = given(information, outside, some)
    more = rng.uniform(0.0, 20.0, 4)
    both = outside.copy()
    both[some] += more
    left_out = information.value(outside) - part.prior
    assert part.value(more) + left_out == pytest.approx(information.value(both), rel=1e-9)
    assert information.value(both) == pytest.approx(information.value_and_gradient(both)[0], rel=1e-12)


@pytest.mark.parametrize("test_points", ["random", "candidates"])
def test_fewer_test_points_say_the_same_of_j(test_points: Any) -> None:
    mission = build(Specification(4, 14, seed=3, test_points=test_points), 30.0)
    information = build_problem(mission).information
    some = np.arange(0, 14, 2)
    part = given(information, np.zeros(14), some)
    few = packed(part)
    assert len(few.weights) <= len(some) < len(part.weights)
    assert few.prior == pytest.approx(part.prior, rel=1e-12)
    rng = np.random.default_rng(0)
    for _ in range(5):
        precision = rng.uniform(0.0, 40.0, len(some)) * (rng.uniform(size=len(some)) < 0.6)
        value, gradient = part.value_and_gradient(precision)
        assert few.value(precision) == pytest.approx(value, rel=1e-5)
        assert few.value_and_gradient(precision)[1] == pytest.approx(gradient, rel=1e-3, abs=1e-4)


def test_nothing_to_tell_can_be_told_in_fewer_points() -> None:
    information = build_problem(build(Specification(4, 14, seed=3), 30.0)).information
    none = given(information, np.zeros(14), np.zeros(0, dtype=np.int64))
    assert packed(none).prior == none.prior


@pytest.mark.parametrize("seed", range(3))
def test_robots_that_cannot_reach_each_other_are_planned_together(seed: int) -> None:
    """Two halves of a site that no edge joins: distances between their robots are infinite."""
    text = build(Specification(4, 12, seed=seed), 40.0).model_dump(mode="json", by_alias=True)
    half = {node["id"]: i % 2 for i, node in enumerate(text["site"]["nodes"])}
    text["site"]["nodes"].append({**text["site"]["nodes"][0], "id": "d1", "role": "depot"})
    half |= {"d0": 0, "d1": 1}
    text["site"]["edges"] = [{"from": u, "to": v} for u in half for v in half if u < v and half[u] == half[v]]
    for r, robot in enumerate(text["team"]["robots"]):
        robot["start"] = f"d{r // 2}"
        robot["depots"] = [f"d{r // 2}"]
    mission = Mission.model_validate(text)
    problem = build_problem(mission)
    search = Focus(problem, seed, 1)
    team = search.construct()
    assert team is not None
    for found in islice(search.rounds(team, FOREVER), 6):
        assert found.rank <= team.rank
        team = verified(mission, problem, found, initial_state(mission))
    sampled = {problem.nodes[v.node] for route in team.routes for v in route if v.collect}
    assert {half[node] for node in sampled} == {0, 1}


def test_an_idle_team_goes_home() -> None:
    problem = build_problem(build(Specification(4, 14, seed=0), 30.0))
    team = Focus(problem, 0, 1).construct()
    assert team is not None
    assert team.information == pytest.approx(problem.information.prior)
    assert Draft(problem, [], []).samples == []
