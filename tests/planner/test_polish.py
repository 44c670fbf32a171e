"""Cheaper routes of the same samples and drops: verified, never worse, and better where a detour is plain."""

from __future__ import annotations

import math

import pytest
from random_missions import part_way, tiny_mission

from malipp_field.bench.instances import Specification, build
from malipp_field.mission import initial_state
from malipp_field.planner import verify
from malipp_field.planner.draft import Draft, draft_of
from malipp_field.planner.extract import Verdict, plan_file, team_plan
from malipp_field.planner.linear import Effort
from malipp_field.planner.problem import build_problem
from malipp_field.planner.search.improver import Improver
from malipp_field.planner.search.polish import polished, route_energy_j

FOREVER = Effort(deadline=math.inf)


@pytest.mark.parametrize("block", range(4))
def test_polished_plans_are_verified_and_do_the_same(block: int) -> None:
    planned = 0
    for seed in range(900 + 10 * block, 910 + 10 * block):
        mission = tiny_mission(seed, robots=4, candidates=6, energy_budget_j=40.0)
        state = part_way(mission, seed) if seed % 2 else initial_state(mission)
        problem = build_problem(mission, state)
        improver = Improver(problem, seed)
        start = improver.construct()
        if start is None:
            continue
        team = improver.improve(start, 5, FOREVER)
        found = polished(problem, team, FOREVER)
        plan = plan_file(mission.name, problem, found, Verdict("fast", "feasible", None, None, 0.0, 0, 1))
        assert not verify(mission, plan, state)
        assert found.rank <= team.rank
        assert (found.precision == team.precision).all()
        planned += 1
    assert planned >= 5


def test_the_energy_of_a_route_is_that_of_the_plan() -> None:
    problem = build_problem(build(Specification(6, 18, seed=1), 40.0))
    improver = Improver(problem, 0)
    start = improver.construct()
    assert start is not None
    team = improver.improve(start, 200, FOREVER)
    draft = draft_of(problem, team)
    assert any(sample.hops for sample in draft.samples)
    total_j = sum(route_energy_j(draft, r, route) for r, route in enumerate(draft.routes))
    assert total_j == pytest.approx(team.energy_j, rel=1e-9)


def test_stops_in_a_bad_order_are_put_right() -> None:
    problem = build_problem(build(Specification(6, 18, seed=1), 40.0), handoffs=False)
    improver = Improver(problem, 0)
    start = improver.construct()
    assert start is not None
    draft = draft_of(problem, improver.improve(start, 200, FOREVER))
    roomy = build_problem(build(Specification(6, 18, seed=1), 1000.0), handoffs=False)
    good = team_plan(roomy, draft.visits())
    assert good is not None
    r = max(range(6), key=lambda r: len(draft.routes[r]))
    first, *inner, _ = draft.routes[r]
    assert len(inner) >= 3
    for stops in ([first, *inner[1:], inner[0]], [first, *inner[::-1]]):
        routes = [*draft.routes]
        routes[r] = [*stops, draft.terminal(r, stops)]
        bad = team_plan(roomy, Draft(roomy, routes, draft.samples).visits())
        assert bad is not None
        assert bad.energy_j > good.energy_j
        assert polished(roomy, bad, FOREVER).energy_j <= good.energy_j * (1.0 + 1e-9)


def test_nothing_is_polished_without_time() -> None:
    problem = build_problem(build(Specification(4, 14, seed=0), 30.0))
    team = Improver(problem, 0).construct()
    assert team is not None
    assert polished(problem, team, Effort(deadline=-math.inf)) is team
