"""The fast planner: ruin and recreate on every core first, then as much proof as there is time for.

Most of what can be gained comes within seconds (`walks`; `focus` for large teams). What time is left then
goes to the exact search, begun with the best plan found: it gives the bound, sometimes a better plan, energy
and makespan, and for small teams a proof. Of teams too large for that `quick_bound` gives the bound.
"""

from __future__ import annotations

from dataclasses import replace

from malipp_field.planner.bounds.quick import quick_bound
from malipp_field.planner.choice import is_small
from malipp_field.planner.exact.lexicographic import solve_exact
from malipp_field.planner.exact.schedules import MOST_PLACES
from malipp_field.planner.extract import TeamPlan
from malipp_field.planner.problem import Problem
from malipp_field.planner.progress import Result, Search
from malipp_field.planner.repair import first_plan, settled
from malipp_field.planner.search.focus import Focus
from malipp_field.planner.search.polish import polished
from malipp_field.planner.search.walks import Walks, cores

_SEARCH_SHARE, _ALL_SHARE = 0.5, 0.95
"""Part of the time for finding plans, where the exact search will hardly settle the question; and the same
where there is too little time for a bound."""
_FIRST_SHARE, _FIRST_S = 0.3, 2.0
"""The same where it will: no more than this share, and no more than so many seconds."""
_FIRST_ROUNDS = 6
"""And no more than so many rounds, each twice as long as the one before."""
_LEAST_PROOF_S = 5.0
"""With less time than this the exact search of a large team would not get beyond its beginning."""
_BOUND_SHARE, _LEAST_BOUND_S = 0.1, 1.0
"""Part of the time for a first bound, which has none where there is less than so many seconds in all."""
_MOST_TOGETHER = 16
"""Robots that are searched all together; of larger teams groups of neighbours are, in turn."""
_MOST_PAIRS = 40_000
"""And so many pairs of places, of all robots: with 110 000 a few iterations may take a minute."""


def solve_fast(problem: Problem, search: Search, start: TeamPlan | None = None) -> Result:
    """Return the best plan that ruin and recreate finds, and a bound as good as the time allows.

    Parameters
    ----------
    start
        A plan to begin with; the result is never worse.
    """
    searcher = _searcher(problem, search)
    if start is None:
        found = _begun(problem, search, searcher)
        if found.team is None:
            return found
        start = found.team
    search.tell("first plan", start, None, 0)
    small, bound = is_small(len(problem.robots), len(problem.candidates)), 0.0
    if not small and search.effort.left_s >= _LEAST_BOUND_S:
        bound = quick_bound(problem, _part(search, _BOUND_SHARE).effort)
    left_s = search.effort.left_s
    proving = small or (_listable(problem) and (1.0 - _SEARCH_SHARE) * left_s >= _LEAST_PROOF_S)
    share = min(_FIRST_SHARE, _FIRST_S / max(left_s, _FIRST_S)) if small else _SEARCH_SHARE
    most = min(search.work or _FIRST_ROUNDS, _FIRST_ROUNDS) if small else search.work
    best = _searched(searcher, _part(search, share if proving else _ALL_SHARE), start, bound, most)
    if not proving:
        best = polished(problem, best, search.effort)
        return Result(best, min(bound, best.information), proven=False)
    result = solve_exact(problem, search, best, walks=int(small), arcs=small)
    return replace(result, bound=max(result.bound, bound))


def _part(search: Search, share: float) -> Search:
    """Return the search with a share of its time; limited by work, nothing of it may hang on the clock."""
    return search if search.work is not None else search.share(share)


def _listable(problem: Problem) -> bool:
    """Tell whether the exact search could be of use: neither places nor robots are too many."""
    few = all(len(robot.places) <= MOST_PLACES for robot in problem.robots)
    return few and len(problem.robots) <= _MOST_TOGETHER


def _searcher(problem: Problem, search: Search) -> Walks | Focus:
    many = search.threads or cores()
    pairs = sum(len(robot.places) ** 2 for robot in problem.robots)
    if len(problem.robots) <= _MOST_TOGETHER and pairs <= _MOST_PAIRS:
        return Walks(problem, search.seed, many)
    return Focus(problem, search.seed, many)


def _begun(problem: Problem, search: Search, searcher: Walks | Focus) -> Result:
    """Return a plan to begin with, or the proof that there is none."""
    if not isinstance(searcher, Focus):
        return first_plan(problem, None, search)
    team = searcher.construct()
    return settled(problem, search) if team is None else Result(team, 0.0, proven=False)


def _searched(
    searcher: Walks | Focus, search: Search, start: TeamPlan, bound: float, most: int | None
) -> TeamPlan:
    """Return the best plan of all rounds, or of so many, begun with one."""
    best = start
    for count, found in enumerate(searcher.rounds(start, search.effort), 1):
        best = found
        search.tell("ruin and recreate", best, bound or None, count)
        if most is not None and count >= most:
            break
    return best
