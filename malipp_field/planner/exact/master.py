"""The linear master: which schedule each robot follows, and what J is then at least.

    min  sum_G theta_G
    s.t. sum_c lambda_rc = 1                                             for every robot r
         sum_{r in class k} sum_c a_cv lambda_rc = n_kv                  samples by class and candidate
         sum_l counts_k(l) z_vl = n_kv,  sum_l z_vl <= 1                 (eq:precision_select)
         sum_r sum_c h_cv lambda_rc >= stock_v                           what is dropped is picked
         sum_{r' != r} min(t, picks_r'v) >= t [drops_rv >= t]            the same, drop by drop
         [samples at u and drops at v], summed over robots, at most
            robots that pick at v + samples at u beyond the first        drops tied to samples
        theta_G >= tangents and envelopes of J                          (`cuts`, `envelope`)

Its columns lambda are priced by `schedules`; every row is a sum over places of something that depends on the
code there (`rows`), so pricing needs no more than a table of gains, one for each code at each place. The rows
of products (E[n_u n_v] in the envelopes; samples at u with drops at v) are the exception: only schedules that
are listed count in them.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import highspy
import numpy as np
from numpy.typing import NDArray

from malipp_field.field import FloatArray
from malipp_field.planner.exact.columns import Branch, Point, Stack
from malipp_field.planner.exact.cuts import split_information
from malipp_field.planner.exact.envelope import Envelope, Pair, levels_of
from malipp_field.planner.exact.rows import Own, Rows
from malipp_field.planner.exact.schedules import Codes, Pairs, Robot
from malipp_field.planner.linear import INFINITY
from malipp_field.planner.problem import Problem

_PENALTY = 100.0
"""Cost of what no schedule does yet, in priors: only to have a solution from the start."""
_IDLE_ROUNDS = 8
"""Cuts that were not active at the end of so many nodes are dropped, some at a time."""
_IDLE_AT_ONCE = 40
_FORGOTTEN = 0.05
"""Envelopes are made anew when so large a share of all levels can be forgotten."""
_ANCHORED = 0.01
"""Least violation of a row that ties a drop to a sample, in robots."""
_TRIAL_STEPS = 60
"""Steps of the dual simplex by which a branch is judged."""
_NO_LIMIT = 2**31 - 1
_DUAL, _PRIMAL = 1, 4
_ANSWERS = (highspy.HighsModelStatus.kOptimal, highspy.HighsModelStatus.kInfeasible)


Product = tuple[str, int, int, int]
"""Of what: ("taken", class, u, v), samples at two positions in V, or ("dropped", 0, u, node): whether a robot
that samples at u drops at the node."""


@dataclass
class LiveCut:
    """A row that may be dropped again."""

    row: int
    idle: int = 0


class Master:
    """The linear program and what is known of its rows and columns."""

    def __init__(self, problem: Problem, robots: list[Robot]) -> None:
        self.problem, self.robots = problem, robots
        self.classes = sorted({robot.precision for robot in robots})
        self.class_of = [self.classes.index(robot.precision) for robot in robots]
        self.position = {v: i for i, v in enumerate(problem.candidates)}
        self.stacks = [Stack(len(robot.places)) for robot in robots]
        self.rows = [Rows(robot) for robot in robots]
        """What schedules count in, by robot."""
        self.n: dict[tuple[int, int], int] = {}
        self.z: list[list[tuple[tuple[int, ...], int]]] = [[] for _ in problem.candidates]
        self._solver = highspy.Highs()
        for option, value in (
            ("output_flag", False), ("threads", 1), ("presolve", "off"),
            ("primal_feasibility_tolerance", 1e-9), ("dual_feasibility_tolerance", 1e-9),
        ):  # fmt: skip
            self._solver.setOptionValue(option, value)
        self._row_count = self._column_count = 0
        self._cuts: list[LiveCut] = []
        self._product: dict[Product, int] = {}
        """Column of every expectation of a product."""
        self._counted: list[set[Product]] = [set() for _ in robots]
        """Products in whose rows a robot's schedules count."""
        self._fetched: dict[int, int] = {}
        """Column of how many robots pick at a node."""
        self._anchored: set[Product] = set()
        most = self._most()
        self._convexity = [self._row([], 1.0, 1.0) for _ in robots]
        self._absent = [self._stand_in(row) for row in self._convexity]
        self._select(most)
        self._exchange()
        self._information(most)

    # building

    def _row(self, terms: Sequence[tuple[int, float]], lower: float, upper: float) -> int:
        index = np.array([column for column, _ in terms], dtype=np.int32)
        value = np.array([coefficient for _, coefficient in terms], dtype=float)
        self._solver.addRow(lower, upper, len(index), index, value)
        self._row_count += 1
        return self._row_count - 1

    def _over(
        self, what: Mapping[int, Own], terms: Sequence[tuple[int, float]], lower: float, upper: float
    ) -> int:
        """Add a row over what schedules do, by robot; schedules that are known already count in it."""
        terms = list(terms)
        for r, own in what.items():
            values, column = own.values(self.robots[r], self.stacks[r].codes), self.stacks[r].column
            terms += zip(column[values != 0.0].tolist(), values[values != 0.0].tolist(), strict=True)
            self.rows[r].add(self._row_count, own)
        return self._row(terms, lower, upper)

    def _column(self, cost: float, lower: float, upper: float, terms: Sequence[tuple[int, float]]) -> int:
        index = np.array([row for row, _ in terms], dtype=np.int32)
        value = np.array([coefficient for _, coefficient in terms], dtype=float)
        self._solver.addCol(cost, lower, upper, len(index), index, value)
        self._column_count += 1
        return self._column_count - 1

    def _stand_in(self, row: int) -> int:
        """Return a column that meets a row as long as there are no schedules that do."""
        return self._column(_PENALTY * self.problem.information.prior, 0.0, INFINITY, [(row, 1.0)])

    def _most(self) -> NDArray[np.int64]:
        """Return the most samples of each class at each candidate, shape (V, classes)."""
        most = np.zeros((len(self.problem.candidates), len(self.classes)), dtype=np.int64)
        for robot, k in zip(self.robots, self.class_of, strict=True):
            for w, v in enumerate(robot.places):
                if v in self.position:
                    most[self.position[v], k] += robot.actor.limits[w]
        return most

    def _select(self, most: NDArray[np.int64]) -> None:
        for i, node in enumerate(self.problem.candidates):
            for counts in itertools.product(*(range(m + 1) for m in most[i])):
                if any(counts):
                    self.z[i].append((counts, self._column(0.0, 0.0, 1.0, [])))
            if self.z[i]:
                self._row([(column, 1.0) for _, column in self.z[i]], -INFINITY, 1.0)
            for k, m in enumerate(most[i]):
                if m:
                    self._count(k, i, node, int(m))

    def _count(self, k: int, i: int, node: int, most: int) -> None:
        n = self._column(0.0, 0.0, float(most), [])
        self.n[k, i] = n
        levels = [(column, float(counts[k])) for counts, column in self.z[i] if counts[k]]
        self._row([*levels, (n, -1.0)], 0.0, 0.0)
        taken = {
            r: Own({robot.places.index(node): robot.taken_of.astype(float)})
            for r, robot in enumerate(self.robots) if self.class_of[r] == k and node in robot.places
        }  # fmt: skip
        self._absent.append(self._stand_in(self._over(taken, [(n, -1.0)], 0.0, 0.0)))

    def _exchange(self) -> None:
        nodes = sorted({v for robot in self.robots for v in robot.places})
        for v in nodes:
            here = [(r, robot.places.index(v)) for r, robot in enumerate(self.robots) if v in robot.places]
            stock = sum(s.count for s in self.problem.stocks if s.node == v)
            drops = [int(self.robots[r].actor.most_drop[w]) for r, w in here]
            if not any(drops) and not stock:
                continue
            self._exchange_row(here, float(stock), None, 0)
            for (r, _), most in zip(here, drops, strict=True):
                for t in range(1, most + 1):
                    self._exchange_row(here, 0.0, r, t)
            for t in range(1, max(drops) + 1):
                self._dropped_where_taken(v, here, t)
            self._pickers(v, here)

    def _exchange_row(self, here: list[tuple[int, int]], least: float, sender: int | None, t: int) -> None:
        """Add a row of exchanges at a node: all of them, or what one sender's drop of t or more asks for."""
        tables = {}
        for r, w in here:
            h = self.robots[r].exchange_of
            if sender is None:
                table = h.astype(float)
            elif r == sender:
                table = -t * (h <= -t).astype(float)
            else:
                table = np.clip(h, 0, t).astype(float)
            tables[r] = Own({w: table})
        row = self._over(tables, [], least, INFINITY)
        if least:
            self._absent.append(self._stand_in(row))

    def _dropped_where_taken(self, v: int, here: list[tuple[int, int]], t: int) -> None:
        """Add: robots that sample at v and drop t or more there need somebody to pick t at the same time.

        If there are N >= 1 of them, N samples or more are taken at v: N <= 1 + (n_v - 1). And t are picked.
        """
        tables = {}
        for r, w in here:
            robot = self.robots[r]
            h = robot.exchange_of
            tables[r] = Own({w: np.clip(h, 0, t) - t * ((h <= -t) & (robot.taken_of > 0)).astype(float)})
        self._over(tables, self._beyond_one(self.position.get(v), t), 0.0, INFINITY)

    def _beyond_one(self, i: int | None, t: int = 1) -> list[tuple[int, float]]:
        """Return t times the samples at a candidate beyond the first."""
        if i is None:
            return []
        return [(z, t * (sum(counts) - 1.0)) for counts, z in self.z[i] if sum(counts) > 1]

    def _pickers(self, v: int, here: list[tuple[int, int]]) -> None:
        """Add the column of how many robots pick at node v."""
        self._fetched[v] = self._column(0.0, 0.0, INFINITY, [])
        tables = {r: Own({w: (self.robots[r].exchange_of > 0).astype(float)}) for r, w in here}
        self._over(tables, [(self._fetched[v], -1.0)], 0.0, INFINITY)

    def _information(self, most: NDArray[np.int64]) -> None:
        problem = self.problem
        free = most.sum(axis=1) > 0
        self.groups = split_information(problem.information, free, max(self.classes))
        self._precisions = [
            np.array([problem.gained[i] + sum(n * p for n, p in zip(counts, self.classes, strict=True))
                      for counts, _ in self.z[i]]) for i in range(len(problem.candidates))
        ]  # fmt: skip
        self._theta = [self._column(1.0, 0.0, INFINITY, []) for _ in self.groups]
        self._gone: set[tuple[int, int]] = set()
        """Selectors (position in V, selector) that no better plan sets."""
        self._envelopes = self._enveloped()

    def _enveloped(self) -> list[Envelope]:
        """Return the envelope of J for each group of test points, over the levels that are left."""
        information, gained = self.problem.information, self.problem.gained
        levels = [
            levels_of(
                {s: counts for s, (counts, _) in enumerate(own) if (i, s) not in self._gone},
                self.classes,
                float(gained[i]),
            )
            for i, own in enumerate(self.z)
        ]
        return [Envelope(replace(group.information, k_vv=information.k_vv), levels) for group in self.groups]

    def forget_levels(self, point: Point, room: float) -> None:
        """Fix selectors at zero whose reduced cost exceeds the gap, and let the envelopes profit from it.

        With fewer levels at each candidate an envelope covers more candidates, and those outside of it are
        taken at a lower precision.
        """
        found = {
            (i, s) for i, own in enumerate(self.z) for s, (_, z) in enumerate(own)
            if (i, s) not in self._gone and point.reduced[z] > room
        }  # fmt: skip
        if len(found) > _FORGOTTEN * sum(len(own) for own in self.z):
            self._gone |= found
            self._envelopes = self._enveloped()

    # columns

    def add(self, r: int, codes: Codes) -> bool:
        """Add a schedule; return False where it is known already."""
        stack = self.stacks[r]
        if codes in stack:
            return False
        terms = [(self._convexity[r], 1.0), *self.rows[r].terms(codes)]
        stack.add(codes, self._column(0.0, 0.0, INFINITY, terms))
        return True

    def impose(self, branch: Branch) -> None:
        """Set the bounds of a node of the tree."""
        index: list[int] = []
        lower: list[float] = []
        upper: list[float] = []
        for r, (robot, stack) in enumerate(zip(self.robots, self.stacks, strict=True)):
            cells = branch.forbidden[r][np.arange(len(robot.places)), stack.codes + robot.capacity]
            shut: NDArray[np.bool_] = np.any(cells, axis=1)
            changed = np.flatnonzero(shut != stack.closed)
            stack.closed[changed] = shut[changed]
            index += stack.column[changed].tolist()
            lower += [0.0] * len(changed)
            upper += np.where(shut[changed], 0.0, INFINITY).tolist()
        for key, n in self.n.items():
            low, high = branch.counts.get(key, (0.0, INFINITY))
            index.append(n)
            lower.append(low)
            upper.append(high)
        for i, own_levels in enumerate(self.z):
            for s, (_, z) in enumerate(own_levels):
                low, high = branch.levels.get((i, s), (0.0, 0.0 if (i, s) in self._gone else 1.0))
                index.append(z)
                lower.append(low)
                upper.append(high)
        self._solver.changeColsBounds(
            len(index), np.array(index, dtype=np.int32), np.array(lower), np.array(upper)
        )

    # solving

    def solve(self, *, grown: bool = False) -> Point | None:
        """Solve as it stands; None where it has no solution.

        Parameters
        ----------
        grown
            Whether nothing but columns has come since: the primal simplex goes on from there.

        Raises
        ------
        ArithmeticError
            Where HiGHS gives up.
        """
        self._solver.setOptionValue("simplex_strategy", _PRIMAL if grown else _DUAL)
        self._solver.run()
        if self._solver.getModelStatus() not in _ANSWERS:
            self._solver.clearSolver()
            self._solver.run()
        status = self._solver.getModelStatus()
        if status == highspy.HighsModelStatus.kInfeasible:
            return None
        if status != highspy.HighsModelStatus.kOptimal:
            raise ArithmeticError(f"the master could not be solved: {status.name}")
        solution = self._solver.getSolution()
        x = np.array(solution.col_value)
        return Point(
            value=float(self._solver.getInfo().objective_function_value),
            x=x,
            dual=np.array(solution.row_dual),
            reduced=np.array(solution.col_dual),
            missing=float(sum(x[column] for column in self._absent)),
        )

    def promise(self, branch: Branch, children: Sequence[Branch]) -> list[float]:
        """Return what each child of a node adds to the objective in a few steps of the simplex, at least."""
        self.impose(branch)
        point = self.solve()
        if point is None:
            return [0.0] * len(children)
        basis, rises = self._solver.getBasis(), []
        self._solver.setOptionValue("simplex_iteration_limit", _TRIAL_STEPS)
        for child in children:
            self._solver.setBasis(basis)
            self.impose(child)
            self._solver.run()
            infeasible = self._solver.getModelStatus() == highspy.HighsModelStatus.kInfeasible
            value = self._solver.getInfo().objective_function_value
            rises.append(point.value if infeasible else max(0.0, float(value) - point.value))
        self._solver.setOptionValue("simplex_iteration_limit", _NO_LIMIT)
        self._solver.setBasis(basis)
        return rises

    def gains(self, dual: FloatArray, r: int) -> FloatArray:
        """Return what each code at each place of robot r is worth, shape (P, C)."""
        return self.rows[r].gains(dual)

    def pair_gains(self, dual: FloatArray, r: int) -> Pairs:
        """Return pairs of places, and what each two codes there are worth besides: nothing is above zero."""
        return self.rows[r].pair_gains(dual)

    def least_value(self, dual: FloatArray, r: int) -> float:
        """Return the value above which a schedule of robot r lowers the objective."""
        return -float(dual[self._convexity[r]])

    # cuts

    def cut(self, point: Point, tolerance: float) -> int:
        """Add the cuts of J that the point violates by more than a share of J; return their number."""
        share = [point.x[[column for _, column in own]] if own else np.zeros(0) for own in self.z]
        together = self._together(point)
        found = 0
        for g, theta in enumerate(self._theta):
            least = point.x[theta] + tolerance * max(point.value, 1e-9) / len(self._theta)
            found += self._tangent(g, share, least) + self._envelope(g, share, together, least)
        return found + self._anchor(point)

    def _tangent(self, g: int, share: list[FloatArray], least: float) -> int:
        group = self.groups[g]
        base = group.scaled(self.problem.gained)
        steps = [own / (1.0 + group.share[i] * own) - base[i] for i, own in enumerate(self._precisions)]
        q = base + np.array(
            [float(step @ part) if len(step) else 0.0 for step, part in zip(steps, share, strict=True)]
        )
        value, slope = group.information.value_and_gradient(q)
        if value <= least:
            return 0
        terms = [(self._theta[g], 1.0)]
        for i, own in enumerate(self.z):
            terms += [
                (column, -float(slope[i] * step))
                for (_, column), step in zip(own, steps[i], strict=True) if abs(slope[i] * step) > 1e-12
            ]  # fmt: skip
        self._cuts.append(LiveCut(self._row(terms, float(value - slope @ (q - base)), INFINITY)))
        return 1

    def _envelope(self, g: int, share: list[FloatArray], together: dict[Pair, float], least: float) -> int:
        cut = self._envelopes[g].separate(share, together)
        if cut is None:
            return 0
        value = cut.constant + sum(slope * share[i][s] for (i, s), slope in cut.slopes.items())
        value += sum(slope * together.get(pair, 0.0) for pair, slope in cut.pairs.items())
        if value <= least:
            return 0
        terms = [(self._theta[g], 1.0)]
        terms += [(self.z[i][s][1], -slope) for (i, s), slope in cut.slopes.items()]
        terms += [(self._product_column(("taken", *pair)), -slope) for pair, slope in cut.pairs.items()]
        self._cuts.append(LiveCut(self._row(terms, cut.constant, INFINITY)))
        return 1

    def _together(self, point: Point) -> dict[Pair, float]:
        """Return E[n_u n_v] as far as listed schedules bring it about."""
        found: dict[Pair, float] = {}
        for r, robot in enumerate(self.robots):
            if robot.pool is None:
                continue
            for part, codes in self.used(point, r):
                taken = robot.taken_of[codes + robot.capacity]
                sampled = sorted(
                    (self.position[robot.places[w]], int(taken[w])) for w in np.flatnonzero(taken)
                )
                for (u, a), (v, b) in itertools.combinations(sampled, 2):
                    pair = (self.class_of[r], u, v)
                    # a row made before this robot's schedules were listed does not count it
                    if ("taken", *pair) not in self._product or ("taken", *pair) in self._counted[r]:
                        found[pair] = found.get(pair, 0.0) + part * a * b
        return found

    def used(self, point: Point, r: int, least: float = 1e-9) -> list[tuple[float, Codes]]:
        """Return the schedules of robot r that have a share of more than ``least`` at a point."""
        stack = self.stacks[r]
        known = stack.column[stack.column < len(point.x)]
        shares = point.x[known]
        return [(float(shares[k]), stack.codes[k]) for k in np.flatnonzero(shares > least)]

    def _anchor(self, point: Point) -> int:
        """Add violated rows: whoever samples at u and drops at v, somebody picks at v.

        As in `_dropped_where_taken`, for two places: sum_r P(r samples at u and drops at v) is at most the
        number of robots that pick at v and of samples at u beyond the first.
        """
        dropped: dict[Product, float] = {}
        for r, robot in enumerate(self.robots):
            for part, codes in self.used(point, r) if robot.pool is not None else []:
                taken = np.flatnonzero(robot.taken_of[codes + robot.capacity])
                for w in np.flatnonzero(robot.exchange_of[codes + robot.capacity] < 0):
                    for x in taken:
                        product = ("dropped", 0, self.position[robot.places[x]], robot.places[w])
                        dropped[product] = dropped.get(product, 0.0) + part
        found = 0
        for product, part in dropped.items():
            _, _, i, v = product
            beyond = self._beyond_one(i)
            room = point.x[self._fetched[v]] + sum(count * point.x[z] for z, count in beyond)
            if part > room + _ANCHORED and product not in self._anchored and self.problem.candidates[i] != v:
                self._anchored.add(product)
                terms = [(self._fetched[v], 1.0), *beyond, (self._product_column(product), -1.0)]
                self._row(terms, 0.0, INFINITY)
                found += 1
        return found

    def _product_column(self, product: Product) -> int:
        """Return the column of an expectation that is at least what the listed schedules bring about."""
        if product not in self._product:
            column = self._column(0.0, 0.0, INFINITY, [])
            tables = {}
            for r, robot in enumerate(self.robots):
                place = self._places_of(product, r)
                if place is None or robot.pool is None:
                    continue
                self._counted[r].add(product)
                taken, dropped = robot.taken_of, robot.exchange_of < 0
                both = (taken, taken) if product[0] == "taken" else (taken > 0, dropped)
                tables[r] = Own(paired={place: np.outer(*both).astype(float)})
            self._over(tables, [(column, -1.0)], -INFINITY, 0.0)
            self._product[product] = column
        return self._product[product]

    def _places_of(self, product: Product, r: int) -> tuple[int, int] | None:
        """Return the two places of robot r whose codes make up the product; None where it has no part."""
        kind, k, u, v = product
        places = self.robots[r].places
        one = self.problem.candidates[u]
        other = self.problem.candidates[v] if kind == "taken" else v
        if one not in places or other not in places or (kind == "taken" and self.class_of[r] != k):
            return None
        return places.index(one), places.index(other)

    def forbid(self, counts: dict[tuple[int, int], int]) -> None:
        """Forbid all plans that take at least so many samples of each class at each candidate."""
        terms = []
        nodes = sorted({i for _, i in counts})
        for i in nodes:
            wanted = {k: n for (k, j), n in counts.items() if j == i}
            terms += [
                (column, 1.0) for own, column in self.z[i] if all(own[k] >= n for k, n in wanted.items())
            ]
        self._row(terms, -INFINITY, float(len(nodes) - 1))

    def drop_idle(self, point: Point) -> None:
        """Drop cuts that have not been active for long."""
        for cut in self._cuts:
            cut.idle = 0 if abs(point.dual[cut.row]) > 1e-9 else cut.idle + 1
        gone = sorted(cut.row for cut in self._cuts if cut.idle > _IDLE_ROUNDS)
        if len(gone) < _IDLE_AT_ONCE:
            return
        self._solver.deleteRows(len(gone), np.array(gone, dtype=np.int32))
        rows = np.array(gone)
        self._row_count -= len(gone)
        self._cuts = [
            LiveCut(_moved(cut.row, rows), cut.idle) for cut in self._cuts if cut.idle <= _IDLE_ROUNDS
        ]
        for counted in self.rows:
            counted.renumber(rows)


def _moved(row: int, gone: NDArray[np.int64]) -> int:
    return row - int(np.searchsorted(gone, row))
