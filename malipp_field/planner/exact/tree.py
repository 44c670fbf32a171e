"""Branch and price over whole-robot schedules: the exact method.

The master (`master`) is solved with the schedules priced so far; pricing adds schedules,
the gap of J adds cuts, and where the solution is still fractional the tree branches: on the samples of a
sensor class at a candidate, on whether a robot drops, picks or samples somewhere. A bound is proven at any
moment, since what no schedule can lower is known from the pricing even before it has converged (Lagrange).
"""

from __future__ import annotations

import heapq
import itertools
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from malipp_field.field import FloatArray
from malipp_field.planner.exact.branching import INTEGRAL, Level, only, options, sides, split_levels
from malipp_field.planner.exact.columns import Branch, Point
from malipp_field.planner.exact.master import Master
from malipp_field.planner.exact.realise import realise
from malipp_field.planner.exact.schedules import Codes, Pairs, robots_of
from malipp_field.planner.exact.stages import plan_of_precision
from malipp_field.planner.extract import TeamPlan
from malipp_field.planner.problem import Problem
from malipp_field.planner.progress import Result, Search, relative_gap
from malipp_field.planner.search.improver import Improver
from malipp_field.planner.search.walks import cores

_NOTHING = -1e300
"""Less than any schedule is worth."""
_TOLERANCE = 0.1
"""Part of the gap asked for by which a cut of J has to be violated to be added."""
_WITHIN = 0.999
"""The part of the gap asked for that is used: what is proven stays within it whatever is rounded later."""
_EXACT = 1e-9
"""The least gap that can be told from none."""
_REDUCED_COST = 1e-9
"""Schedules that lower the objective by less are not looked for; J is at most 1 here (`in_units`)."""
_LIST_ROOM = 1_500_000
_LISTING_S = 3.0
"""Listing takes seconds and cannot be interrupted: it is not begun when less than this is left."""
_SLOW, _PATIENCE = 0.01, 3
"""Cutting ends after so many rounds in a row that closed less than this share of the gap."""
_RETRY = 0.8
"""A robot with too many schedules to list is asked again when the gap has become so much smaller."""
WALKS = 3
"""Independent walks of ruin and recreate: one alone may stay in a plan that only a long way leads out of."""
_FIRST_IMPROVEMENTS = 100
_IMPROVEMENTS = 4
"""Iterations of ruin and recreate before the search and at every node, for each robot and candidate."""
_STRONG = 6
"""Candidates for branching that are tried before one is chosen."""


@dataclass(order=True)
class _Open:
    bound: float
    number: int
    branch: Branch
    point: Point


class ColumnStage:
    """The first stage, minimise J, by branch and price."""

    def __init__(self, problem: Problem, search: Search, start: TeamPlan | None, walks: int = WALKS) -> None:
        self.problem, self.search = problem, search
        self.best = start
        self.bound = 0.0
        self.rounds = 0
        self._improvers = [Improver(problem, search.seed + k) for k in range(walks)]
        self._robots = robots_of(problem)
        self._cores = ThreadPoolExecutor(search.threads or cores())
        """What prices robots side by side; the compiled labelling lets go of Python's lock."""
        self._numbers = itertools.count()
        self._open: list[_Open] = []
        self._lagrangian = 0.0
        """Bound that belongs to the prices of the last point."""
        self._root_bound = 0.0
        self._root_prices: list[tuple[FloatArray, Pairs, float]] = []
        """Gains of codes and pairs, and the value to exceed, by robot at the root."""
        self._dominated_too = False
        """Whether listed schedules include those that others beat."""
        self._too_many: dict[int, float] = {}
        """Gap at which a robot had too many schedules to list."""
        self._undecided = np.inf
        """Least bound of nodes that could be neither solved nor branched."""

    # what is known

    @property
    def cutoff(self) -> float:
        """The bound from which on nothing better than the gap asked for can follow."""
        if self.best is None:
            return self.problem.information.prior * (1.0 + 1e-9)
        return self.best.information * (1.0 - _WITHIN * self.search.gap) - 1e-12

    @property
    def most(self) -> float:
        """An upper bound on J."""
        return self.problem.information.prior if self.best is None else self.best.information

    @property
    def stopped(self) -> bool:
        """Whether the effort is used up."""
        work = self.search.work
        return self.search.effort.over or (work is not None and self.rounds >= work)

    def _raise_bound(self, bound: float) -> None:
        """Take a bound on everything still open; nodes set aside undecided limit it."""
        self.bound = max(self.bound, min(bound, self._undecided, self.most))

    def _tell(self, stage: str) -> None:
        self.search.tell(stage, self.best, self.bound or None, self.rounds)

    def _offer(self, team: TeamPlan | None) -> None:
        if team is not None and (self.best is None or team.rank < self.best.rank):
            self.best = team
            self._better("branch and price")

    def _better(self, stage: str) -> None:
        """Draw the consequences of a better plan."""
        assert self.best is not None
        self._learn(self.best)
        self._tell(stage)
        if self._root_prices:
            self._fix()

    def _learn(self, team: TeamPlan) -> None:
        """Add a plan's schedules to the master."""
        for r, codes in enumerate(self._schedules(team)):
            if not self._robots[r].pool:
                self.master.add(r, codes)

    def _schedules(self, team: TeamPlan) -> list[Codes]:
        found = []
        for robot, route in zip(self._robots, team.routes, strict=True):
            codes = np.zeros(len(robot.places), dtype=np.int16)
            for visit in route if len(route) == 1 else route[:-1]:
                exchange = sum(visit.pick.values()) + sum(visit.fetch.values()) - sum(visit.drop.values())
                codes[robot.places.index(visit.node)] += visit.collect * (2 * robot.capacity + 1) + exchange
            found.append(codes)
        return found

    # the search

    def run(self) -> Result:
        """Search until the gap is closed or the effort is used up."""
        with self._cores:
            return self._run()

    def _run(self) -> Result:
        everything = [np.zeros((len(robot.places), robot.width)) for robot in self._robots]
        for robot, gain in zip(self._robots, everything, strict=True):
            robot.list_all(gain, _NOTHING)
            if robot.pool is not None and not len(robot.pool.codes):
                return Result(None, np.inf, proven=True, infeasible=True)
        self.master = Master(self.problem, self._robots)
        if self.best is None and self._improvers:
            self.best = self._improvers[0].construct()
        begin = self.best
        for improver in self._improvers:
            if begin is not None:
                team = improver.improve(begin, self._iterations(_FIRST_IMPROVEMENTS), self.search.effort)
                self.best = min(team, self.best or team, key=lambda plan: plan.rank)
                self._tell("ruin and recreate")
        if self.best is not None:
            self._learn(self.best)
        root = Branch([np.zeros((len(robot.places), robot.width), dtype=bool) for robot in self._robots])
        solved, point = self._root(root)
        if point is not None and self.bound < self.cutoff:
            self._push(self.bound, root, point)
            self._dive(root, point)
            self._grow()
        done = solved and not self._open
        if done:
            self._raise_bound(self.cutoff)
        if self.best is None:
            none = done and np.isinf(self._undecided)
            return Result(None, self.bound, proven=none, infeasible=none)
        self.bound = min(self.bound, self.best.information)
        gap = relative_gap(self.best.information, self.bound)
        proven = self.best.information <= 1e-9 or (gap is not None and gap <= max(self.search.gap, _EXACT))
        self._tell("branch and price")
        return Result(self.best, self.bound, proven=proven)

    def _root(self, root: Branch) -> tuple[bool, Point | None]:
        """Solve the root, forget schedules that cannot be part of a better plan, and list what was priced.

        Returns whether it was solved at all, and its point; none where nothing better is left to find.
        """
        point, before = None, -1.0
        while not self.stopped:
            bound, point = self._solve(root, rounds=60)
            self._raise_bound(bound)
            self._tell("root")
            if point is None or self.best is None:
                return True, point
            self._root_bound = self._lagrangian
            self._root_prices = [
                (self.master.gains(point.dual, r), self.master.pair_gains(point.dual, r),
                 self.master.least_value(point.dual, r)) for r in range(len(self._robots))
            ]  # fmt: skip
            self.master.forget_levels(point, self.most - self._root_bound + 1e-9)
            news = self._fix()
            if not news and bound - before < 0.1 * (self.best.information - bound):
                break
            before = bound
        return before >= 0.0 or point is not None, point

    def _fix(self) -> bool:
        """Keep schedules whose reduced cost at the root is within the gap; tell if any were listed anew."""
        news = False
        room = self.most - self._root_bound + 1e-9
        for r, (gain, pairs, worth) in enumerate(self._root_prices):
            robot = self._robots[r]
            if robot.pool is not None:
                robot.price(gain, pairs, worth, exact_load=False)
                robot.keep(worth - room)
            elif room < _RETRY * self._too_many.get(r, np.inf) and self.search.effort.left_s > _LISTING_S:
                news |= robot.list_all(gain, worth - room, _LIST_ROOM, dominated=self._dominated_too)
                self._too_many[r] = room
        return news

    def _grow(self) -> None:
        """Branch until nothing is open."""
        while self._open and not self.stopped:
            node = heapq.heappop(self._open)
            self._raise_bound(node.bound)
            if node.bound >= self.cutoff:
                self._open.clear()
                break
            self.rounds += 1
            if not self._branch(node):
                heapq.heappush(self._open, node)
                break
            self._improve()
            if self.rounds % 10 == 0:
                self._tell("branch and price")
        if self._open:
            self._raise_bound(self._open[0].bound)

    def _branch(self, node: _Open) -> bool:
        """Solve the children of a node; return False where the effort was used up before."""
        children = self._children(node)
        solved = []
        for child in children:
            bound, point = self._solve(child, rounds=12, least=node.bound)
            if self.stopped and bound < self.cutoff:
                return False
            solved.append((max(bound, node.bound), child, point))
        for bound, child, point in solved:
            if point is not None and bound < self.cutoff:
                self._push(bound, child, point)
        return True

    def _push(self, bound: float, branch: Branch, point: Point) -> None:
        chosen = self._integral(point)
        if chosen is None:
            heapq.heappush(self._open, _Open(bound, next(self._numbers), branch, point))
            return
        team = realise(self.problem, self._robots, chosen)
        if team is not None:
            self._offer(team)
            if bound >= self.cutoff:
                return
        self._settle(bound, branch, chosen, team)

    def _settle(self, bound: float, branch: Branch, chosen: list[Codes], team: TeamPlan | None) -> None:
        """Deal with an integral point that has no plan yet, or whose J is not the master's yet."""
        if team is None:
            counts = self._counts(chosen)
            team, impossible = plan_of_precision(self.problem, self.search, self._precision(counts))
            self._offer(team)
            if team is None and not impossible:
                self._undecided = min(self._undecided, bound)
                return
            if impossible:
                self.master.forbid(counts)
                self._list_dominated()
            elif bound >= self.cutoff:
                return
        again, new = self._solve(branch, rounds=60, least=bound)
        if new is None or again >= self.cutoff:
            return
        anew = self._integral(new)
        if team is not None and anew is not None and all(map(np.array_equal, anew, chosen)):
            self._undecided = min(self._undecided, again)  # the cuts are as sharp as rounding lets them be
        else:
            self._push(max(bound, again), branch, new)

    def _list_dominated(self) -> None:
        """List schedules again with those that others beat: what beats them may now be impossible."""
        if self._dominated_too:
            return
        self._dominated_too = True
        for r, robot in enumerate(self._robots):
            gain, least = np.zeros((len(robot.places), robot.width)), _NOTHING
            if self._root_prices:
                gain, _, worth = self._root_prices[r]
                least = worth - (self.most - self._root_bound) - 1e-9
            if robot.pool is not None and not robot.list_all(gain, least, _LIST_ROOM, dominated=True):
                robot.pool = None

    def _counts(self, chosen: list[Codes]) -> dict[tuple[int, int], int]:
        """Return the samples of each class at each candidate."""
        counts: dict[tuple[int, int], int] = {}
        for r, (robot, codes) in enumerate(zip(self._robots, chosen, strict=True)):
            taken = robot.taken_of[codes + robot.capacity]
            for w in np.flatnonzero(taken):
                key = (self.master.class_of[r], self.master.position[robot.places[w]])
                counts[key] = counts.get(key, 0) + int(taken[w])
        return counts

    def _precision(self, counts: dict[tuple[int, int], int]) -> FloatArray:
        precision = self.problem.gained.copy()
        for (k, i), n in counts.items():
            precision[i] += n * self.master.classes[k]
        return precision

    def _dive(self, branch: Branch, point: Point) -> None:
        """Fix the schedule of one robot after the other, the surest first."""
        here, undecided = point, self._undecided
        while not self.stopped:
            parts = self._parts(here)
            choice = max(
                ((part, r, codes) for r, own in parts.items() for part, codes in own if len(own) > 1),
                key=lambda option: option[0], default=None,
            )  # fmt: skip
            if choice is None:
                chosen = self._integral(here)
                if chosen is not None:
                    self._offer(realise(self.problem, self._robots, chosen))
                return
            _, r, codes = choice
            branch = only(branch, r, codes, self._robots[r].capacity)
            bound, new = self._solve(branch, rounds=3)
            self._undecided = undecided  # a dive leaves nothing out: what it cannot decide is still open
            if new is None or bound >= self.cutoff:
                return
            here = new

    def _improve(self) -> None:
        """Go on with one of the walks of ruin and recreate."""
        if self.best is not None and self._improvers:
            before = self.best
            improver = self._improvers[self.rounds % len(self._improvers)]
            self.best = improver.improve(before, self._iterations(_IMPROVEMENTS), self.search.effort)
            if self.best is not before:
                self._better("ruin and recreate")

    def _iterations(self, each: int) -> int:
        return each * len(self._robots) * max(1, len(self.problem.candidates))

    # one node

    def _solve(self, branch: Branch, rounds: int, least: float = 0.0) -> tuple[float, Point | None]:
        """Return the bound of a node and its solution; None where it is pruned or has none.

        Parameters
        ----------
        rounds
            Rounds of cuts.
        least
            A bound known already.
        """
        try:
            return self._converge(branch, rounds, least)
        except ArithmeticError:
            self._undecided = min(self._undecided, least)
            return np.inf, None

    def _converge(self, branch: Branch, rounds: int, bound: float) -> tuple[float, Point | None]:
        master, cuts, slow, grown = self.master, 0, 0, False
        master.impose(branch)
        while True:
            point = master.solve(grown=grown)
            if point is None:
                return np.inf, None
            lower, grown = self._price(branch, point)
            self._lagrangian, gained = lower, lower - bound
            bound = max(bound, lower)
            if bound >= self.cutoff:
                return bound, None
            if self.stopped:
                return bound, point
            if grown:
                continue
            cuts += 1
            slow = slow + 1 if gained < _SLOW * (self.most - bound) else 0
            if cuts > rounds or slow >= _PATIENCE:
                break
            if not master.cut(point, max(1e-9, _TOLERANCE * self.search.gap)):
                break
        master.drop_idle(point)
        if point.missing > INTEGRAL and not self._fractional(point):
            self._undecided = min(self._undecided, bound)
            return np.inf, None
        return bound, point

    def _price(self, branch: Branch, point: Point) -> tuple[float, bool]:
        """Add schedules that lower the master's objective; return a bound on J and whether any were added."""
        added, total = False, 0.0
        team = range(len(self._robots))
        # listed schedules are priced at once: first what they give
        for group in (
            [r for r in team if self._robots[r].pool],
            [r for r in team if not self._robots[r].pool],
        ):
            if added and group:
                return 0.0, True
            priced = self._cores.map(lambda r: self._priced(branch, point, r), group)
            for r, (excess, found) in zip(group, priced, strict=True):
                total += excess
                for codes in found:
                    added |= self.master.add(r, codes)
        return point.value - total, added and total > _REDUCED_COST

    def _priced(self, branch: Branch, point: Point, r: int) -> tuple[float, list[Codes]]:
        """Return by how much a schedule of robot r can lower the objective at most, and some that do."""
        gain = np.where(branch.forbidden[r], -np.inf, self.master.gains(point.dual, r))
        least = self.master.least_value(point.dual, r)
        most, found = self._robots[r].price(
            gain,
            self.master.pair_gains(point.dual, r),
            least + _REDUCED_COST,
            exact_load=r in branch.exact_load,
        )
        return max(0.0, most - least), found

    def _parts(self, point: Point) -> dict[int, list[tuple[float, Codes]]]:
        """Return the schedules in use and their shares, by robot."""
        return {r: self.master.used(point, r, INTEGRAL) for r in range(len(self._robots))}

    def _fractional(self, point: Point) -> bool:
        return any(len(own) > 1 for own in self._parts(point).values())

    def _integral(self, point: Point) -> list[Codes] | None:
        parts = self._parts(point)
        if point.missing > INTEGRAL or any(len(own) != 1 for own in parts.values()):
            return None
        if split_levels(self.master, point):
            return None
        return [parts[r][0][1] for r in range(len(self._robots))]

    # branching

    def _children(self, node: _Open) -> list[Branch]:
        """Return the two sides of the best of some decisions (strong branching)."""
        decisions = options(self.master, node.point, self._parts(node.point))
        if not decisions:
            self._undecided = min(self._undecided, node.bound)
            return []
        if len(decisions) == 1 or isinstance(decisions[0], Level):
            return sides(self._robots, node.branch, decisions[0])
        tried = [sides(self._robots, node.branch, decision) for decision in decisions[:_STRONG]]
        rises = self.master.promise(node.branch, [side for pair in tried for side in pair])
        least = 1e-6 * self.most
        scores = [max(a, least) * max(b, least) for a, b in zip(rises[::2], rises[1::2], strict=True)]
        return tried[int(np.argmax(scores))]
