"""From a mission to a verified plan, by any of the methods.

Each method is imported when it is asked for: cvxpy alone takes a second, numba half of one.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Collection
from dataclasses import dataclass, replace

from malipp_field.mission import Mission, TeamState
from malipp_field.mission.schema import Method
from malipp_field.plan import Plan
from malipp_field.plan.schema import Status
from malipp_field.planner.bounds.quick import is_relaxable, quick_bound
from malipp_field.planner.choice import method_for
from malipp_field.planner.extract import TeamPlan, Verdict, plan_file, team_plan
from malipp_field.planner.feasibility import obstacle
from malipp_field.planner.linear import Effort
from malipp_field.planner.problem import Problem, build_problem, in_units, prune
from malipp_field.planner.progress import Progress, Result, Search, relative_gap
from malipp_field.planner.verifier.rules import verify

Engine = Callable[[Problem, Search, TeamPlan | None], Result]
_RELAXATION_S = 10.0
"""Most seconds for the bound of a plan whose method has none."""
_BOUND_SHARE = 0.05
"""Of the time limit, kept back for that bound where the team is too large for the cone relaxation."""
_BOUNDLESS = frozenset({"seq", "lns"})
"""Methods that prove nothing themselves."""
_SEQUENTIAL_SHARE = 0.1
"""Of the time limit, for the Seq-LIPP plan that the others begin with."""
_SEQUENTIAL_SHARE_OF_MANY, _MANY = 0.4, 16
"""Of a team of more robots than this, whose Seq-LIPP plan takes longer and is worth more: groups of a few
robots at a time are slow to reach it from nothing."""
_SEQUENTIAL_FROM_S = 20.0
"""With less time it is left out: ruin and recreate soon beats it."""
_NO_FIRST_PLAN = "the limit came before a first plan"


@dataclass(frozen=True)
class Request:
    """What is asked for, with the mission's own wishes filled in."""

    mission: Mission
    state: TeamState | None
    method: Method
    engine: Engine
    handoffs: bool
    search: Search
    version: int
    warm_start: Plan | None
    closed: frozenset[str]


def solve(
    mission: Mission,
    *,
    state: TeamState | None = None,
    method: Method | None = None,
    handoffs: bool | None = None,
    time_limit_s: float | None = None,
    mip_gap: float | None = None,
    seed: int | None = None,
    threads: int | None = None,
    work_limit: int | None = None,
    closed: Collection[str] = (),
    warm_start: Plan | None = None,
    version: int = 1,
    on_progress: Callable[[Progress], None] | None = None,
    cancelled: Callable[[], bool] | None = None,
) -> Plan:
    """Plan a mission from a state on; what is None is taken from the mission's planner section.

    Parameters
    ----------
    state
        Where the team stands; the beginning of the mission where it is None.
    method
        "exact" proves its plan; "no-handoffs" is the same without drops; "fast" finds good plans in seconds,
        on every core, and bounds them in what time is left; "auto" is one of these (`method_for`). "seq" is
        Seq-LIPP, "lns" the paper's search over pairs of robots; "miqp" is the paper's model to the letter,
        "arcs" the outer approximation over the arc model: slower proofs of the same optimum.
    threads
        Cores for all methods that can use more than one; all there are where it is None.
    work_limit
        Most rounds of the exact engine and of ruin and recreate, or pairs of "lns"; a search that ends by it
        gives the same plan on every machine with as many cores.
    closed
        Ids of nodes at which nobody may hand over.
    warm_start
        Routes and operations to begin with (times and energies are worked out anew): the result is never
        worse, if they keep the rules from this state on; else it begins with what still stands of them.
    version
        Number of the plan among those of the mission.
    on_progress, cancelled
        Called with every advance; and now and then, to be told to stop with the best plan so far.

    Returns
    -------
    Plan
        Verified where it has routes. Without: ``infeasible`` with the reason, or ``no_plan``.

    Raises
    ------
    RuntimeError
        When a plan of ours breaks a rule: an error of the planner, not of its user.
    """
    options = mission.planner
    chosen = method or options.method
    engine = _engine(chosen)  # before the clock starts: importing it is not planning
    started = time.monotonic()
    wanted = options.handoffs if handoffs is None else handoffs
    search = Search(
        effort=Effort(
            deadline=started + (options.time_limit_s if time_limit_s is None else time_limit_s),
            cancelled=cancelled or (lambda: False),
        ),
        gap=options.mip_gap if mip_gap is None else mip_gap,
        seed=options.seed if seed is None else seed,
        threads=threads,
        work=work_limit,
        started=started,
        on_progress=on_progress or (lambda _: None),
    )
    request = Request(
        mission=mission,
        state=state,
        method=chosen,
        engine=engine,
        handoffs=wanted and chosen not in {"no-handoffs", "seq"},
        search=search,
        version=version,
        warm_start=warm_start,
        closed=frozenset(closed),
    )
    return _checked(request, _solve(request))


def _solve(request: Request) -> Plan:
    one_by_one = request.method == "seq"
    whole = build_problem(
        request.mission, request.state, handoffs=request.handoffs or one_by_one, closed=request.closed
    )
    problem = prune(replace(whole, handoffs=False)) if one_by_one else whole
    index = {node: i for i, node in enumerate(problem.nodes)}
    depots = {r.id: tuple(index[d] for d in r.depots) for r in request.mission.team.robots}
    reason = obstacle(problem, depots)
    if reason:
        return _no_routes(request, "infeasible", reason)
    if one_by_one:
        return _sequential(request, problem, whole)
    if request.warm_start is None:
        return _exact(request, problem, None)
    return _replan(request, problem, request.warm_start)


def _replan(request: Request, problem: Problem, advice: Plan) -> Plan:
    """Plan from a plan as good as the warm start on, or from what can be made of it."""
    from malipp_field.planner.repair import first_plan

    first = first_plan(problem, advice, request.search)
    if first.infeasible:
        return _impossible(request)
    if first.team is None and request.search.effort.over:
        return _no_routes(request, "no_plan", _NO_FIRST_PLAN)
    return _exact(request, problem, first.team)


def _sequential(request: Request, problem: Problem, whole: Problem) -> Plan:
    """Plan without handoffs; the bound is over ``whole``, with them: nobody asked for a plan without."""
    team = _one_by_one(problem, _before_bound(request, whole))
    if team is None:
        return _no_routes(
            request, "no_plan", "robots planned one by one found no plan that brings all samples home"
        )
    bound = min(_relaxed(request, whole), team.information)
    gap = relative_gap(team.information, bound)
    return plan_file(request.mission.name, problem, team, _verdict(request, "feasible", bound, gap))


def _before_bound(request: Request, problem: Problem) -> Search:
    """Return the search with what `_relaxed` takes left out, where that has to be short."""
    if request.method not in _BOUNDLESS or is_relaxable(problem):
        return request.search
    return request.search.share(1.0 - _BOUND_SHARE)


def _relaxed(request: Request, problem: Problem) -> float:
    """Return a bound for a method that proves nothing itself.

    That of the cone relaxation, or for large teams, of which that takes minutes and gigabytes, the quick one.
    """
    if not is_relaxable(problem):
        return quick_bound(problem, request.search.effort)
    from malipp_field.planner.bounds.relaxation import relaxation_bound

    left_s = min(_RELAXATION_S, request.search.effort.left_s)
    return relaxation_bound(request.mission, request.state, left_s)


def _exact(request: Request, problem: Problem, start: TeamPlan | None) -> Plan:
    search = _before_bound(request, problem)
    enough = search.effort.left_s >= _SEQUENTIAL_FROM_S and search.work is None
    if start is None and request.method in {"auto", "fast"} and enough:
        share = _SEQUENTIAL_SHARE if len(problem.robots) <= _MANY else _SEQUENTIAL_SHARE_OF_MANY
        start = _one_by_one(problem, search.share(share))
    result = _run(request.engine, problem, search, start)
    if result.infeasible:
        return _impossible(request)
    if result.team is None:
        return _no_routes(request, "no_plan", _NO_FIRST_PLAN)
    bound = _relaxed(request, problem) if request.method in _BOUNDLESS else result.bound
    gap = relative_gap(result.team.information, bound)
    status: Status = "optimal" if result.proven else "feasible"
    bound = min(bound, result.team.information)
    return plan_file(request.mission.name, problem, result.team, _verdict(request, status, bound, gap))


def _impossible(request: Request) -> Plan:
    from malipp_field.planner.shortage import shortage

    reason = shortage(
        request.mission, request.state, request.search, handoffs=request.handoffs, closed=request.closed
    )
    return _no_routes(request, "infeasible", reason)


def _one_by_one(problem: Problem, search: Search) -> TeamPlan | None:
    from malipp_field.planner.paper.sequential import solve_sequential

    def engine(problem: Problem, search: Search, _: TeamPlan | None) -> Result:
        return Result(solve_sequential(problem, search), 0.0, proven=False)

    return _run(engine, problem, search, None).team


def _run(engine: Engine, problem: Problem, search: Search, start: TeamPlan | None) -> Result:
    """Run an engine in its own units (`in_units`) and return what it found in those of the mission."""
    scaled, unit = in_units(problem)
    told = replace(search, on_progress=lambda progress: search.on_progress(progress.times(unit)))
    result = engine(scaled, told, None if start is None else team_plan(scaled, start.routes))
    team = None if result.team is None else team_plan(problem, result.team.routes)
    return replace(result, team=team, bound=unit * result.bound)


def _engine(method: Method) -> Engine:
    if method == "miqp":
        from malipp_field.planner.paper.literal import solve_literal

        return solve_literal
    from malipp_field.planner.exact.lexicographic import solve_arcs, solve_exact
    from malipp_field.planner.fast import solve_fast
    from malipp_field.planner.paper.lns import solve_lns

    engines: dict[str, Engine] = {
        "arcs": solve_arcs, "auto": solve_fast, "fast": solve_fast, "lns": solve_lns
    }  # fmt: skip
    return engines.get(method, solve_exact)


def _verdict(request: Request, status: Status, bound: float | None, gap: float | None) -> Verdict:
    return Verdict(
        method=_method_used(request),
        status=status,
        bound=bound,
        gap=gap,
        solve_time_s=time.monotonic() - request.search.started,
        seed=request.search.seed,
        version=request.version,
    )


def _method_used(request: Request) -> str:
    if request.method in {"seq", "miqp", "arcs", "lns", "fast"}:
        return request.method
    if request.method == "auto" and method_for(request.mission)[0] == "fast":
        return "fast"
    return "exact" if request.handoffs else "no-handoffs"


def _no_routes(request: Request, status: Status, reason: str) -> Plan:
    verdict = _verdict(request, status, None, None)
    return Plan(
        mission=request.mission.name,
        version=verdict.version,
        method=verdict.method,
        status=status,
        reason=reason,
        solve_time_s=verdict.solve_time_s,
        seed=verdict.seed,
    )


def _checked(request: Request, plan: Plan) -> Plan:
    faults = verify(request.mission, plan, request.state) if plan.robots else []
    if faults:
        raise RuntimeError("the planner made a plan that breaks a rule: " + "; ".join(map(str, faults)))
    if _drops(plan) & request.closed:
        raise RuntimeError("the planner made a plan with a drop at a closed node")
    return plan


def _drops(plan: Plan) -> set[str]:
    """Return the nodes at which a plan hands over."""
    return {stop.node for robot in plan.robots for stop in robot.route if stop.drop}
