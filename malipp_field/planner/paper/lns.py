"""The paper's heuristic: large-neighbourhood search over pairs of robots (Section "Heuristic", Algorithm 1).

Two robots are routed anew, all others keep their routes; sampling, payload, handoffs, unloading and timing
are free for the whole team. What the paper gives to a MIP solver with a time limit and a warm start is given
to the exact method of the house, with the same limits and the same start: branch and price proves most of
these subproblems, where the arc model found nothing in the time. Everything else is the paper's; what it
leaves open is a constant here or in `malipp_field.planner.paper.pairs`.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

from malipp_field.planner.exact.arcs import InformationStage
from malipp_field.planner.exact.schedules import MOST_PLACES
from malipp_field.planner.exact.stages import least_energy, least_makespan
from malipp_field.planner.exact.tree import ColumnStage
from malipp_field.planner.extract import Route, TeamPlan, Visit, team_plan
from malipp_field.planner.paper.frozen import freeze
from malipp_field.planner.paper.pairs import Pair, ranked
from malipp_field.planner.paper.sequential import solve_sequential
from malipp_field.planner.problem import Problem
from malipp_field.planner.progress import Progress, Result, Search

EPSILON = 1e-6
"""Least fall in J that counts as one, as a share of the prior J: a tenth of the precision to which the paper
compares optima, and far above rounding."""
MOST_SWEEPS = 100
"""A guard only: the search ends with the first sweep that gives nothing, mostly the second to fifth."""
LEAST_PAIR_S = 4.0
"""Allowance of a pair: in this time ruin and recreate has found most of what a pair has to give."""
SWEEP_SHARE = 0.33
"""Of the time left, for one sweep, if that allows the pairs more than the minimum: the first sweeps give
most, and later ones are to have their turn."""
PAIR_NODES = 20
"""Instead of a time, nodes of the tree for each pair where the work is limited."""
SEQUENTIAL_SHARE = 0.4
"""Of the time limit, for Seq-LIPP: less than for Seq-LIPP as a method, as in the paper."""
FIRST_SHARE = 0.1
"""Of the time left, for sampling and custody along the first routes; mostly proven long before."""
UNRESTRICTED_SHARE = 0.2
"""Of the time left, for a first plan of any kind, where no routes to begin with are known."""
REFINEMENT_SHARE = 0.1
"""Of the time limit, kept for energy and makespan."""
_ENERGY_TIE = 1e-6
"""Energies that differ by less than this share count as equal; the sooner plan is taken."""


def solve_lns(problem: Problem, search: Search, start: TeamPlan | None = None) -> Result:
    """Return the plan of the paper's LNS; it proves nothing, and its bound is zero.

    Parameters
    ----------
    search
        Its ``work`` counts pairs. With it every pair gets `PAIR_NODES` instead of seconds, so that the plan
        does not depend on how fast the machine is.
    start
        Takes the place of Seq-LIPP: the result is never worse.
    """
    looking = search.share(1.0 - REFINEMENT_SHARE)
    first = first_incumbent(problem, looking, start)
    if first.team is None:
        return first
    pairwise = PairwiseSearch(problem, looking, first.team)
    best = refined(problem, search, pairwise.run())
    search.tell("refinement", best, None, pairwise.solved)
    return Result(best, 0.0, proven=False)


def first_incumbent(problem: Problem, search: Search, start: TeamPlan | None = None) -> Result:
    """Return a plan that is as informative as its routes allow (paper, Initialization).

    Routes come from ``start``, else from Seq-LIPP, else they are the ways straight to a depot, else those of
    a brief search without restrictions, which may also prove that there is no plan.
    """
    team = start or _sequential(problem, search.share(SEQUENTIAL_SHARE))
    if team is not None:
        search.tell("initial plan", team, None, 0)
        return Result(_along(problem, search, team.routes, team) or team, 0.0, proven=False)
    routes = direct_routes(problem)
    team = _along(problem, search, routes, _as_it_is(problem, routes))
    if team is not None:
        return Result(team, 0.0, proven=False)
    result = _stage(problem, _quiet(search.share(UNRESTRICTED_SHARE)), None)
    if result.team is not None:
        result = replace(result, team=_along(problem, search, result.team.routes, result.team) or result.team)
    return replace(result, bound=0.0, proven=False)


def direct_routes(problem: Problem) -> tuple[Route, ...]:
    """Return the cheapest way from the start to a depot for every robot."""
    routes = []
    for robot in problem.robots:
        costs = robot.closure.energy_per_kg[robot.start]
        depot = min(robot.depots, key=lambda d: float(costs[d]))
        end = Visit(depot, unload=robot.on_board)
        routes.append((end,) if depot == robot.start else (Visit(robot.start), end))
    return tuple(routes)


class PairwiseSearch:
    """Sweeps over pairs of robots until a whole sweep gives nothing (paper, Pairwise improvement).

    Attributes
    ----------
    best
        The incumbent.
    solved
        Pairs tried so far.
    """

    def __init__(self, problem: Problem, search: Search, best: TeamPlan) -> None:
        self.problem, self.search, self.best = problem, search, best
        self.solved = 0
        self._failures: Counter[Pair] = Counter()
        self._settled: dict[Pair, TeamPlan] = {}
        self._tell(best)

    def run(self) -> TeamPlan:
        """Return the best plan found."""
        for _ in range(MOST_SWEEPS):
            if not self._sweep():
                break
        return self.best

    def _sweep(self) -> bool:
        """Try every pair once; return whether one of them improved the plan."""
        pairs = ranked(self.problem, self.best, self._failures)
        allowance_s = max(LEAST_PAIR_S, SWEEP_SHARE * self.search.effort.left_s / len(pairs))
        improved = False
        for pair in pairs:
            if self._over:
                return False
            if self._settled.get(pair) is self.best:  # proven to give nothing, and nothing has changed since
                continue
            better = self._try(pair, allowance_s)
            self._failures[pair] = 0 if better else self._failures[pair] + 1
            improved |= better
        return improved

    @property
    def _over(self) -> bool:
        done = self.search.work is not None and self.solved >= self.search.work
        return done or self.search.effort.over

    def _try(self, pair: Pair, allowance_s: float) -> bool:
        """Solve with only this pair rerouted; return whether the incumbent was replaced."""
        result = pair_plan(self.problem, self._pair_search(allowance_s), self.best, pair)
        self.solved += 1
        found = None if result.team is None else team_plan(self.problem, result.team.routes)
        better = found is not None and self._lower(found.information)
        if found is not None and better:
            self.best = found
            self._tell(found)
        if result.proven:
            self._settled[pair] = self.best
        return better

    def _pair_search(self, allowance_s: float) -> Search:
        if self.search.work is not None:
            return replace(self.search, work=PAIR_NODES, on_progress=self._heard)
        left_s = max(self.search.effort.left_s, 1e-9)
        return replace(self.search.share(min(1.0, allowance_s / left_s)), on_progress=self._heard)

    def _lower(self, information: float) -> bool:
        return information < self.best.information - EPSILON * self.problem.information.prior

    def _heard(self, progress: Progress) -> None:
        """Pass on what a pair has found; its bound is one for its neighbourhood alone."""
        if progress.incumbent is not None and self._lower(progress.incumbent):
            said = replace(progress, stage="pairs", bound=None, gap=None, rounds=self.solved)
            self.search.on_progress(said)

    def _tell(self, team: TeamPlan) -> None:
        self.search.tell("pairs", team, None, self.solved)


def pair_plan(problem: Problem, search: Search, best: TeamPlan, pair: Pair) -> Result:
    """Solve MA-LIPP with only the routes of ``pair`` free, from the incumbent on."""
    neighbourhood = freeze(problem, best.routes, pair)
    return _stage(neighbourhood, search, team_plan(neighbourhood, best.routes))


def refined(problem: Problem, search: Search, best: TeamPlan) -> TeamPlan:
    """Return a plan of the same routes and precision with less energy, or sooner (paper, Final refinement).

    Custody is decided anew: who takes each sample, where it changes hands, where it is unloaded. What turns
    out idle is left out, so the ways of a robot may be cut short.
    """
    fixed = freeze(problem, best.routes)
    plan = team_plan(fixed, best.routes)
    if plan is None or search.effort.over:
        return best
    cheapest, _ = least_energy(fixed, search.share(0.7), plan)
    soonest, _ = least_makespan(fixed, search, cheapest)
    found = team_plan(problem, soonest.routes)
    if found is None or found.energy_j > best.energy_j * (1.0 + _ENERGY_TIE):
        return best
    cheaper = found.energy_j < best.energy_j * (1.0 - _ENERGY_TIE)
    return found if cheaper or found.makespan_s < best.makespan_s else best


def _along(
    problem: Problem, search: Search, routes: tuple[Route, ...], start: TeamPlan | None
) -> TeamPlan | None:
    """Return the most informative plan along given routes, None where none was found."""
    fixed = freeze(problem, routes)
    begin = None if start is None else team_plan(fixed, start.routes)
    found = _stage(fixed, _quiet(search.share(FIRST_SHARE)), begin).team
    return None if found is None else team_plan(problem, found.routes)


def _stage(problem: Problem, search: Search, start: TeamPlan | None) -> Result:
    """Minimise J, over whole schedules where the places of every robot fit (as in `exact`)."""
    whole = all(len(robot.places) <= MOST_PLACES for robot in problem.robots)
    return (ColumnStage if whole else InformationStage)(problem, search, start).run()


def _sequential(problem: Problem, search: Search) -> TeamPlan | None:
    return solve_sequential(problem, _quiet(search))


def _as_it_is(problem: Problem, routes: tuple[Route, ...]) -> TeamPlan | None:
    """Return routes as a plan, None where samples would be left lying or on board."""
    stay = any(stock.count for stock in problem.stocks)
    heavy = any(robot.on_board > robot.capacity for robot in problem.robots)
    return None if stay or heavy else team_plan(problem, routes)


def _quiet(search: Search) -> Search:
    """Return the search without reports: those of a part of it would pass for the whole."""
    return replace(search, work=None, on_progress=lambda _: None)
