"""A few robots of a large team as a problem of their own, all others as they are.

What is cut out is exact but for two things: nodes that look unpromising for the group are left out, and so
are test points that hardly correlate with those that stay. Whoever uses it judges plans by the whole problem.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from malipp_field.field import FloatArray, Information
from malipp_field.planner.closure import Closure
from malipp_field.planner.draft import COLLECTED, ON_BOARD, STOCK, Draft, Sample, handlers
from malipp_field.planner.problem import IntArray, Problem
from malipp_field.planner.search.state import Case, case_of

_MOST_NODES = 45
"""Nodes of a group's problem, unless its plan has more already."""
_POOL = 2
"""How many times as many candidates are looked at closely."""
_SMALL_DETOUR = 0.05
"""Added to the share of a budget that a detour takes, so that what is near does not win by itself."""
_UNRELATED = 1e-8
"""Test points stay out whose variance no sample of the group lowers by more than this share of its prior."""
_SMALLEST = 1e-6
"""Directions in which the group tells less than this share of the most are left out of J."""


@dataclass(frozen=True)
class Slice:
    """Some robots and nodes of a problem, in numbers of their own.

    Attributes
    ----------
    problem : Problem
        Information is given all that robots outside have collected; stocks keep their numbers.
    robots, nodes : array
        Numbers in the whole problem.
    case : Case
        With the group's part in samples that others handle as well as fixed counts.
    samples : tuple of Sample
        What the group handles alone, in the whole problem's numbers.
    """

    problem: Problem
    robots: IntArray
    nodes: IntArray
    case: Case
    samples: tuple[Sample, ...]

    def draft(self, whole: Draft) -> Draft:
        """Return the group's part of a plan."""
        node = {int(v): i for i, v in enumerate(self.nodes)}
        robot = {int(r): i for i, r in enumerate(self.robots)}
        routes = [[node[v] for v in whole.routes[r]] for r in self.robots]
        return Draft(self.problem, routes, [_renumbered(s, node, robot) for s in self.samples])

    def merged(self, whole: Draft, part: Draft) -> Draft:
        """Return a plan with the group's part of it replaced."""
        node = dict(enumerate(self.nodes.tolist()))
        robot = dict(enumerate(self.robots.tolist()))
        routes = list(whole.routes)
        for i, route in enumerate(part.routes):
            routes[robot[i]] = [node[v] for v in route]
        team = set(robot.values())
        kept = [sample for sample in whole.samples if not handlers(sample) <= team]
        return Draft(whole.problem, routes, kept + [_renumbered(s, node, robot) for s in part.samples])


def cut(draft: Draft, team: Sequence[int], noise: np.random.Generator) -> Slice:
    """Return the problem of the robots ``team`` with all others as a plan has them.

    ``noise`` makes two slices of the same group differ in the candidates they look at.
    """
    problem, members = draft.problem, set(team)
    own = tuple(sample for sample in draft.samples if handlers(sample) <= members)
    shared = [s for s in draft.samples if handlers(s) & members and not handlers(s) <= members]
    precision = problem.gained.copy()
    position = {v: i for i, v in enumerate(problem.candidates)}
    for sample in draft.samples:
        if sample.kind == COLLECTED and sample.robot not in members:
            precision[position[sample.node]] += problem.robots[sample.robot].precision
    used = {v for r in team for v in draft.routes[r]}
    used |= {v for r in team for v in (problem.robots[r].start, *problem.robots[r].depots)}
    near = _detours(draft, team)
    near[list(used)] = np.inf
    pool = np.argsort(near, kind="stable")[: _POOL * _MOST_NODES]
    pool = pool[np.isfinite(near[pool])]
    places = np.array(sorted({*used, *pool.tolist()}), dtype=np.int64)
    sampled = [v for v in places.tolist() if v in position]
    positions = np.array([position[v] for v in sampled], dtype=np.int64)
    information = given(problem.information, precision, positions)
    fall = information.weights @ information.k_tv**2
    score = np.full(len(problem.nodes), -np.inf)
    score[sampled] = fall
    score[pool] *= (0.5 + noise.uniform(size=len(pool))) / (_SMALL_DETOUR + near[pool])
    score[list(used)] = np.inf
    kept = np.argsort(-score[places], kind="stable")[: max(_MOST_NODES, len(used))]
    nodes = np.sort(places[kept])
    chosen = [i for i, v in enumerate(sampled) if v in set(nodes.tolist())]
    part = sliced(problem, team, nodes, packed(_related(information, chosen)))
    return Slice(part, np.array(team), nodes, _fixed(case_of(part), shared, team, nodes), own)


def sliced(problem: Problem, team: Sequence[int], nodes: IntArray, information: Information) -> Problem:
    """Return the problem of some robots over some nodes, with nothing gained beyond what J is given.

    ``information`` is about the candidates among ``nodes``, in their order.
    """
    index = {int(v): i for i, v in enumerate(nodes)}
    candidates = set(problem.candidates)
    closures: dict[int, Closure] = {}
    for closure in (problem.robots[r].closure for r in team):
        if id(closure) not in closures:
            some = np.ix_(nodes, nodes)
            closures[id(closure)] = Closure(closure.energy_per_kg[some], closure.time_s[some], {})
    robots = tuple(
        replace(
            robot,
            start=index[robot.start],
            stops=tuple(index[v] for v in robot.stops if v in index),
            depots=tuple(index[v] for v in robot.depots if v in index),
            closure=closures[id(robot.closure)],
            limits=robot.limits[nodes],
        )
        for robot in (problem.robots[r] for r in team)
    )
    return replace(
        problem,
        nodes=tuple(problem.nodes[v] for v in nodes),
        candidates=tuple(i for i, v in enumerate(nodes.tolist()) if v in candidates),
        robots=robots,
        stocks=tuple(replace(stock, node=index.get(stock.node, -1)) for stock in problem.stocks),
        information=information,
        gained=np.zeros(len(information.k_vv)),
        closed=frozenset(index[v] for v in problem.closed if v in index),
    )


def _detours(draft: Draft, team: Iterable[int]) -> FloatArray:
    """Return the least share of its budget that it takes an empty robot of the group to pass by each node."""
    problem = draft.problem
    found = np.full(len(problem.nodes), np.inf)
    for r in team:
        robot = problem.robots[r]
        cost, stops = robot.closure.energy_per_kg, list(robot.stops)
        if not stops or not robot.depots:
            continue
        for u, v in pairwise(draft.routes[r]):
            leg = cost[u, stops] + cost[stops, v] - cost[u, v]
            share = robot.empty_mass_kg * leg / max(robot.budget_j, 1e-9)
            found[stops] = np.minimum(found[stops], share)
    return found


def given(information: Information, precision: FloatArray, s: IntArray) -> Information:
    """Return J as a function of precision at the candidates ``s`` beyond what has been gained.

    Test points whose covariance with all of them is zero are left out.
    """
    u = np.flatnonzero(precision > 0.0)
    root = np.sqrt(precision[u])
    b = np.eye(u.size) + root[:, None] * information.k_vv[np.ix_(u, u)] * root
    known_s = root[:, None] * information.k_vv[np.ix_(u, s)]
    near = np.flatnonzero((np.abs(information.k_tv[:, s]) > 0.0).any(axis=1))
    known_t = root[:, None] * information.k_tv[np.ix_(near, u)].T
    seen = np.linalg.solve(b, np.hstack((known_s, known_t)))
    seen_s, seen_t = seen[:, : s.size], seen[:, s.size :]
    return Information(
        k_vv=information.k_vv[np.ix_(s, s)] - known_s.T @ seen_s,
        k_tv=information.k_tv[np.ix_(near, s)] - known_t.T @ seen_s,
        k_tt=information.k_tt[near] - np.einsum("ut,ut->t", known_t, seen_t),
        weights=information.weights[near],
    )


def _related(information: Information, candidates: list[int]) -> Information:
    """Return J of some candidates, without the test points that they tell nothing about."""
    k_vv = information.k_vv[np.ix_(candidates, candidates)]
    k_tv = information.k_tv[:, candidates]
    told = (k_tv**2).sum(axis=1) > _UNRELATED * np.diag(k_vv).max(initial=0.0) * information.k_tt
    return Information(k_vv, k_tv[told], information.k_tt[told], information.weights[told])


def packed(information: Information) -> Information:
    """Return the same J by fewer test points, as many as there are candidates at most.

    Samples change J through M = C_VT W C_TV alone: each lowers it by d M_vv / (1 + d C_vv), and changes C_TV
    as it changes C_VV (docs/planning.md, section 2). So any factor L L^T = M may stand for the test points.
    """
    root = np.sqrt(information.weights)[:, None] * information.k_tv
    if not root.size:
        return information
    size, vector = np.linalg.eigh(root.T @ root)
    kept = size > _SMALLEST * size[-1]
    count = max(1, int(kept.sum()))
    factor = vector[:, -count:] * np.sqrt(np.maximum(size[-count:], 0.0))
    return Information(
        k_vv=information.k_vv,
        k_tv=np.ascontiguousarray(factor.T),
        k_tt=np.full(count, information.prior / count),
        weights=np.ones(count),
    )


def _fixed(case: Case, shared: list[Sample], team: Sequence[int], nodes: IntArray) -> Case:
    """Count what the group does for samples that robots outside handle as well."""
    robot = {r: i for i, r in enumerate(team)}
    node = {int(v): i for i, v in enumerate(nodes)}
    for sample in shared:
        holder = robot.get(sample.robot)
        if holder is not None and sample.kind == COLLECTED:
            case.fixed_collect[holder, node[sample.node]] += 1
        elif holder is not None and sample.kind == ON_BOARD:
            case.fixed_board[holder] += 1
        elif holder is not None and sample.kind == STOCK:
            case.fixed_take[holder, node[sample.node]] += 1
        for place, receiver in sample.hops:
            if holder is not None:
                case.fixed_give[holder, node[place]] += 1
            holder = robot.get(receiver)
            if holder is not None:
                case.fixed_take[holder, node[place]] += 1
    return case


def _renumbered(sample: Sample, node: dict[int, int], robot: dict[int, int]) -> Sample:
    hops = tuple((node[v], robot[r]) for v, r in sample.hops)
    return sample._replace(node=node[sample.node], robot=robot[sample.robot], hops=hops)
