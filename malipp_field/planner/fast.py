"""The fast planner: ruin and recreate on every core first, then as much proof as there is time for.

Most of what can be gained comes within seconds (`walks`). What time is left then goes to the exact search,
begun with the best plan found: it gives the bound, sometimes a better plan, and for small teams a proof.
"""

from __future__ import annotations

from malipp_field.planner.choice import is_small
from malipp_field.planner.exact import solve_exact
from malipp_field.planner.extract import TeamPlan
from malipp_field.planner.problem import Problem
from malipp_field.planner.progress import Result, Search
from malipp_field.planner.repair import first_plan
from malipp_field.planner.schedules import MOST_PLACES
from malipp_field.planner.thrift import last_stages
from malipp_field.planner.walks import Walks, cores

_SEARCH_SHARE, _ALL_SHARE = 0.5, 0.95
"""Part of the time for finding plans, where the exact search will hardly settle the question; and the same
where there is too little time for a bound."""
_FIRST_SHARE, _FIRST_S = 0.05, 2.0
"""The same where it will: no more than this share, and no more than so many seconds."""
_LEAST_PROOF_S = 5.0
"""With less time than this the exact search of a large team would not get beyond its beginning."""
_LEAST_FINISH_S = 3.0
"""Energy and makespan need lists that cannot be interrupted: they are not begun with less time than this."""


def solve_fast(problem: Problem, search: Search, start: TeamPlan | None = None) -> Result:
    """Return the best plan that ruin and recreate finds, and a bound as good as the time allows.

    Parameters
    ----------
    start
        A plan to begin with; the result is never worse.
    """
    enough = _SEARCH_SHARE * search.effort.left_s >= _LEAST_PROOF_S
    return _search_then_prove(problem, search, start, search.share(_SEARCH_SHARE if enough else _ALL_SHARE))


def solve_auto(problem: Problem, search: Search, start: TeamPlan | None = None) -> Result:
    """Return the proven best plan of a small team, begun with ruin and recreate; of others `solve_fast`."""
    if not is_small(len(problem.robots), len(problem.candidates)):
        return solve_fast(problem, search, start)
    first = min(_FIRST_SHARE, _FIRST_S / max(search.effort.left_s, _FIRST_S))
    return _search_then_prove(problem, search, start, search.share(first))


def _search_then_prove(
    problem: Problem, search: Search, start: TeamPlan | None, first: Search
) -> Result:
    if start is None:
        found = first_plan(problem, None, search)
        if found.team is None:
            return found
        start = found.team
    best = _walked(problem, first, start)
    small = is_small(len(problem.robots), len(problem.candidates))
    listable = all(len(robot.places) <= MOST_PLACES for robot in problem.robots)
    if listable and (small or search.effort.left_s >= _LEAST_PROOF_S):
        return solve_exact(problem, search, best, walks=0, arcs=small)
    if search.effort.left_s >= _LEAST_FINISH_S:
        best, _ = last_stages(problem, search, best, arcs=False)
    return Result(best, 0.0, proven=False)


def _walked(problem: Problem, search: Search, best: TeamPlan) -> TeamPlan:
    """Return the best plan of all walks, begun with one."""
    walks = Walks(problem, search.seed, search.threads or cores())
    search.tell("first plan", best, None, 0)
    for count, best in enumerate(walks.rounds(best, search.effort), 1):
        search.tell("ruin and recreate", best, None, count)
        if search.work is not None and count >= search.work:
            break
    return best
