"""The literal MIQP solved: against exhaustive search, and how it stops."""

from __future__ import annotations

import time
from dataclasses import replace

import cvxpy as cp
import numpy as np
import pytest
from brute_force import optimum
from literal_cases import GOOD, STAY, A, D, bench
from random_missions import part_way, tiny_mission

from malipp_field.errors import PlanError
from malipp_field.mission import Mission, TeamState
from malipp_field.planner import Progress, verify
from malipp_field.planner.extract import Verdict, plan_file, team_plan
from malipp_field.planner.linear import Effort
from malipp_field.planner.paper.literal import solve_literal
from malipp_field.planner.paper.literal_solver import RECOGNISED, Run, _options, choose_solver
from malipp_field.planner.problem import Problem, Stock, build_problem
from malipp_field.planner.progress import Result, Search


def run(problem: Problem, *, limit_s: float = 60.0) -> Result:
    return solve_literal(problem, Search(Effort(time.monotonic() + limit_s), gap=1e-6))


def compare(mission: Mission, state: TeamState | None = None, *, handoffs: bool = True) -> None:
    truth = optimum(mission, state, handoffs=handoffs)
    problem = build_problem(mission, state, handoffs=handoffs)
    result = run(problem)
    assert result.infeasible == (truth is None)
    assert result.proven
    if truth is None:
        return
    assert result.team is not None
    assert result.team.information == pytest.approx(truth[0], rel=2e-6)
    assert result.team.energy_j == pytest.approx(truth[1], rel=1e-6, abs=1e-6)
    assert result.bound == pytest.approx(truth[0], rel=2e-5)
    assert result.bound <= truth[0] * (1 + 1e-9)
    verdict = Verdict("miqp", "feasible", None, None, 0.0, 0, 1)
    assert not verify(mission, plan_file(mission.name, problem, result.team, verdict), state)


@pytest.mark.parametrize("seed", [1, 2, 4, 6])
def test_two_robots_with_handoffs(seed: int) -> None:
    compare(tiny_mission(seed, candidates=2))


def test_sample_limit_of_two() -> None:
    compare(tiny_mission(2, candidates=2, samples_per_node=2))


def test_two_robots_without_handoffs() -> None:
    compare(tiny_mission(22), handoffs=False)


@pytest.mark.parametrize("seed", [40, 43, 44])
def test_one_robot(seed: int) -> None:
    compare(tiny_mission(seed, robots=1))


@pytest.mark.parametrize("seed", [61, 62, 63, 65])
def test_part_way_through_a_mission(seed: int) -> None:
    mission = tiny_mission(seed, candidates=2)
    compare(mission, part_way(mission, seed), handoffs=seed % 4 != 0)


def test_samples_without_mass() -> None:
    mission = tiny_mission(1, robots=1)
    team = mission.team.model_copy(update={"sample_mass_kg": 0.0})
    compare(mission.model_copy(update={"team": team}))


def test_makespan_is_minimised_last() -> None:
    """Two robots could fetch what lies at a node for the same energy: the faster one is to do it."""
    problem = bench(samples_per_node=0)
    fast, slow = problem.robots[:2]
    slow = replace(slow, closure=replace(slow.closure, time_s=10.0 * slow.closure.time_s))
    stock = Stock(node=A, sender="r2", count=1, available_s=1.0)
    result = run(replace(problem, robots=(slow, fast), stocks=(stock,)))
    assert result.proven
    assert result.team is not None
    assert result.team.routes[0] == STAY
    way = fast.closure.time_s
    assert result.team.makespan_s == pytest.approx(way[D, A] + way[A, D], rel=1e-6)


@pytest.mark.parametrize("candidates", [0, 2])
def test_a_team_that_may_not_sample_stays(candidates: int) -> None:
    problem = build_problem(tiny_mission(1, candidates=2, start="d0", depots=["d0"], samples_per_node=0))
    if not candidates:
        known = problem.information
        nothing = replace(known, k_vv=np.zeros((0, 0)), k_tv=np.zeros((len(known.k_tt), 0)))
        problem = replace(problem, candidates=(), gained=np.zeros(0), information=nothing)
    result = run(problem)
    assert result.proven
    assert result.team is not None
    assert result.team.information == pytest.approx(problem.information.prior)
    assert result.team.energy_j == 0.0


def test_no_way_home_is_infeasible_before_anything_is_solved() -> None:
    result = run(build_problem(tiny_mission(1, candidates=2, start="v0", energy_budget_j=0.01)))
    assert result.infeasible
    assert result.team is None


def test_a_start_is_kept_when_there_is_no_time() -> None:
    problem = bench()
    start = team_plan(problem, GOOD)
    result = solve_literal(problem, Search(Effort(time.monotonic()), gap=1e-4), start)
    assert result.team is start
    assert not result.proven
    assert result.bound == 0.0
    assert run(problem, limit_s=0.0).team is None


def test_cancelled_it_hands_out_what_it_has() -> None:
    problem = bench()
    start = team_plan(problem, (STAY, STAY, STAY))
    heard: list[Progress] = []
    effort = Effort(time.monotonic() + 60.0, cancelled=lambda: bool(heard))
    begun = time.monotonic()
    result = solve_literal(problem, Search(effort, gap=1e-6, on_progress=heard.append), start)
    assert time.monotonic() - begun < 20.0
    assert result.team is not None
    assert start is not None
    assert result.team.rank <= start.rank
    assert not result.proven
    assert result.bound <= result.team.information


def test_progress_never_takes_a_bound_back_below_the_optimum() -> None:
    heard: list[Progress] = []
    problem = build_problem(tiny_mission(1, candidates=2))
    search = Search(Effort(time.monotonic() + 60.0), gap=1e-6, on_progress=heard.append)
    result = solve_literal(problem, search)
    assert result.team is not None
    assert [news.stage for news in heard][-1] == "makespan"
    assert all(news.bound is None or news.bound <= result.team.information * (1 + 1e-9) for news in heard)
    incumbents = [news.incumbent for news in heard if news.incumbent is not None]
    assert min(incumbents) == pytest.approx(result.team.information, rel=2e-6)


def test_no_solver_is_said_in_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cp, "installed_solvers", lambda: ["CLARABEL", "HIGHS", "SCIPY"])
    with pytest.raises(PlanError, match=r"method miqp needs .* pyscipopt") as caught:
        run(bench())
    assert "\n" not in str(caught.value)


def test_the_first_recognised_solver_is_chosen(monkeypatch: pytest.MonkeyPatch) -> None:
    assert choose_solver() == "SCIP"
    monkeypatch.setattr(cp, "installed_solvers", lambda: ["HIGHS", "MOSEK", "GUROBI"])
    assert choose_solver() == "GUROBI"
    run = Run(Effort(np.inf), 1e-3, 2**31 + 5, 2, lambda *_: None)
    assert set(_options(run)) == set(RECOGNISED) - {"SCIP"}
    assert _options(run)["GUROBI"]["Seed"] == 5
