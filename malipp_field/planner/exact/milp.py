"""The paper's model as one mixed-integer linear program; every block of rows names its equation.

Differences to the letter of the paper, none of which changes the set of plans or their objectives:

- J enters through cuts (`malipp_field.planner.exact.cuts`) over the selectors z, not through the estimator A.
- A robot at a node either drops or picks (`roles`): goods it would pass on at once can be passed directly.
- Timing in the information and energy stages only forbids drops that wait for each other in a circle, so
  these rows are added when a solution first needs them (`add_timing`), and always for the makespan.
- Payloads are continuous: once the integers are fixed, conservation makes them whole.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field

import numpy as np

from malipp_field.field import FloatArray
from malipp_field.planner.exact.cuts import Group, split_information
from malipp_field.planner.linear import INFINITY, LinearModel
from malipp_field.planner.problem import Arc, Problem

_MAX_LEVELS = 64
"""Candidates with more precision levels than this enter J without selectors (and without D)."""

ArcColumns = dict[Arc, int]
SlotColumns = dict[int, int]
Terms = list[tuple[int, float]]


@dataclass
class Columns:
    """Where each variable of the paper stands; lists by robot, slots are nodes and terminal copies."""

    x: list[ArcColumns] = field(default_factory=list)
    load: list[ArcColumns] = field(default_factory=list)
    """Q_uv."""
    spent: list[ArcColumns] = field(default_factory=list)
    """Share of the budget spent on arrival over each arc; stands in for the flow phi."""
    y: list[SlotColumns] = field(default_factory=list)
    a: list[SlotColumns] = field(default_factory=list)
    g: list[SlotColumns] = field(default_factory=list)
    t: list[SlotColumns] = field(default_factory=list)
    gives: list[SlotColumns] = field(default_factory=list)
    """1 where the robot drops rather than picks."""
    h: dict[tuple[int, int, int], int] = field(default_factory=dict)
    """H_v^{r->o} by (r, o, v)."""
    delta: dict[tuple[int, int, int], int] = field(default_factory=dict)
    fetch: dict[tuple[int, int], int] = field(default_factory=dict)
    """Samples robot r takes from stock s, by (r, s)."""
    fetches: dict[tuple[int, int], int] = field(default_factory=dict)
    z: dict[int, list[tuple[tuple[int, ...], int]]] = field(default_factory=dict)
    """By position in V: (samples by sensor class, selector)."""
    theta: list[int] = field(default_factory=list)
    end: int = -1
    """T^end."""


class TeamModel:
    """Columns and rows for a problem.

    Parameters
    ----------
    problem
        What is to be planned.
    precision : array, shape (V,), optional
        Fixes the precision of every candidate (the energy and makespan stages); J then needs no columns.
    seed
        Passed to HiGHS.
    """

    def __init__(
        self,
        problem: Problem,
        *,
        precision: FloatArray | None = None,
        seed: int = 0,
    ) -> None:
        self.problem = problem
        self.linear = LinearModel(seed=seed)
        self.columns = Columns()
        self.classes = sorted({robot.precision for robot in problem.robots})
        self.groups: tuple[Group, ...] = ()
        self.timed = False
        for r in range(len(problem.robots)):
            self._add_robot_columns(r)
        self._add_transfer_columns()
        self._inflow = [self._by_head(r) for r in range(len(problem.robots))]
        self._outflow = [self._by_tail(r) for r in range(len(problem.robots))]
        for r in range(len(problem.robots)):
            self._route(r)
            self._carry(r)
        self._hand_over()
        self._clear_stock()
        if precision is None:
            self._select_precision()
        else:
            self._fix_precision(precision)

    # columns

    def _add_robot_columns(self, r: int) -> None:
        robot, columns, n = self.problem.robots[r], self.columns, len(self.problem.nodes)
        column = self.linear.column
        arcs = self.problem.arcs(r)
        slots = [robot.start, *robot.stops, *(n + d for d in robot.depots)]
        room = max(robot.capacity, robot.on_board)
        columns.x.append({arc: column(0, 1, integer=True) for arc in arcs})
        columns.load.append({arc: column(0, room) for arc in arcs})
        columns.spent.append({arc: column(0, 1) for arc in arcs})
        columns.y.append({v: column(float(v == robot.start), 1, integer=True) for v in slots})
        columns.a.append(
            {
                v: column(0, min(int(robot.limits[v]), robot.capacity), integer=True)
                for v in robot.places
                if robot.limits[v] > 0
            }
        )
        unloads = [d for d in robot.depots if d in robot.places] + [n + d for d in robot.depots]
        columns.g.append({v: column(0, robot.capacity, integer=v < n) for v in unloads})
        columns.t.append({v: column(0, INFINITY) for v in slots})

    def _add_transfer_columns(self) -> None:
        problem, columns, column = self.problem, self.columns, self.linear.column
        columns.gives = [{} for _ in problem.robots]
        for r, o in itertools.permutations(range(len(problem.robots)), 2):
            for v in problem.shared(r, o):
                most = min(problem.robots[r].capacity, problem.robots[o].capacity)
                columns.h[r, o, v] = column(0, most, integer=True)
                columns.delta[r, o, v] = column(0, 1, integer=True)
                for i in (r, o):
                    if v not in columns.gives[i]:
                        columns.gives[i][v] = column(0, 1, integer=True)
        for s, stock in enumerate(problem.stocks):
            for r, robot in enumerate(problem.robots):
                if stock.node in robot.places and robot.capacity:
                    columns.fetch[r, s] = column(0, min(stock.count, robot.capacity), integer=True)
                    columns.fetches[r, s] = column(0, 1, integer=True)
        columns.end = column(0, INFINITY)

    def _by_head(self, r: int) -> dict[int, list[Arc]]:
        found: dict[int, list[Arc]] = {v: [] for v in self.columns.y[r]}
        for arc in self.columns.x[r]:
            found[arc[1]].append(arc)
        return found

    def _by_tail(self, r: int) -> dict[int, list[Arc]]:
        found: dict[int, list[Arc]] = {v: [] for v in self.columns.y[r]}
        for arc in self.columns.x[r]:
            found[arc[0]].append(arc)
        return found

    # rows

    def _route(self, r: int) -> None:
        robot, n, row = self.problem.robots[r], len(self.problem.nodes), self.linear.row
        x, y = self.columns.x[r], self.columns.y[r]
        into, out = self._inflow[r], self._outflow[r]
        row(((x[arc], 1.0) for arc in out[robot.start]), 1, 1)  # eq:start
        for v in y:
            if v == robot.start:
                continue
            row([*((x[arc], 1.0) for arc in into[v]), (y[v], -1.0)], 0, 0)  # eq:visit_terminal
            if v < n:
                row([*((x[arc], 1.0) for arc in out[v]), (y[v], -1.0)], 0, 0)  # eq:balance
        row(((y[n + d], 1.0) for d in robot.depots), 1, 1)  # eq:terminal_select
        for u, v in x:
            if u < v and (v, u) in x:  # valid: the two arcs of a pair exclude each other
                row([(x[u, v], 1.0), (x[v, u], 1.0), (y[u], -1.0)], upper=0)
                row([(x[u, v], 1.0), (x[v, u], 1.0), (y[v], -1.0)], upper=0)
        self._spend(r)

    def _spend(self, r: int) -> None:
        """Rows eq:flow to eq:flow_source with energy as the commodity, and eq:energy_budget with them.

        What a visit consumes is the energy of the leg that leaves it instead of one unit. A circle off the
        route would have to spend without supply, so connectivity follows as it does from phi, and the bounds
        (energy needed to get there, energy needed to get home) are far tighter than N_r.
        """
        robot, n, row = self.problem.robots[r], len(self.problem.nodes), self.linear.row
        x, load, spent = self.columns.x[r], self.columns.load[r], self.columns.spent[r]
        into, out = self._inflow[r], self._outflow[r]
        cost, scale = robot.closure.energy_per_kg, max(robot.budget_j, 1e-9)
        home = cost[:, list(robot.depots)].min(axis=1)
        mass, sample = robot.empty_mass_kg / scale, self.problem.sample_mass_kg / scale
        for (u, head), column in spent.items():
            v = head % n
            least = mass * (cost[robot.start, u] + cost[u, v])
            most = 1.0 - (mass * home[v] if head < n else 0.0)
            row([(column, 1.0), (x[u, head], -min(least, most))], lower=0)
            row([(column, 1.0), (x[u, head], -most)], upper=0)
        for u in robot.places:
            terms: Terms = [(spent[arc], -1.0) for arc in into[u]]
            for arc in out[u]:
                alpha = float(cost[u, arc[1] % n])
                terms += [(spent[arc], 1.0), (x[arc], -alpha * mass), (load[arc], -alpha * sample)]
            row(terms, 0, 0)

    def _carry(self, r: int) -> None:
        robot, n, row = self.problem.robots[r], len(self.problem.nodes), self.linear.row
        x, load, y, a, g = (getattr(self.columns, name)[r] for name in ("x", "load", "y", "a", "g"))
        for arc, column in load.items():
            row([(column, 1.0), (x[arc], -float(robot.capacity))], upper=0)  # eq:payload
        for v, column in a.items():
            row([(column, 1.0), (y[v], -self.linear.upper[column])], upper=0)  # eq:sampling_visit
        for v, column in g.items():
            row([(column, 1.0), (y[v], -self.linear.upper[column])], upper=0)  # eq:unload_bound
        for v in y:
            on_board = float(robot.on_board if v == robot.start else 0)
            brought: Terms = [(load[arc], 1.0) for arc in self._inflow[r][v]]
            if v in a:
                brought.append((a[v], 1.0))
            unloaded: Terms = [(g[v], 1.0)] if v in g else []
            carried: Terms = [(load[arc], 1.0) for arc in self._outflow[r][v]] if v < n else []
            picked, dropped = self.transfers(r, v)
            row(
                [*brought, *picked, *_minus(carried), *_minus(dropped), *_minus(unloaded)],
                -on_board, -on_board,
            )  # eq:conservation  # fmt: skip
            if unloaded or dropped:
                row([*unloaded, *dropped, *_minus(brought)], upper=on_board)  # eq:source_feasibility
            if v in a or on_board:
                row([*brought, *_minus(unloaded)], upper=robot.capacity - on_board)  # eq:cap_feasibility
            if dropped:
                row(dropped, upper=robot.capacity)  # eq:handoff_capacity

    def transfers(self, r: int, v: int) -> tuple[Terms, Terms]:
        """Return H_in (drops made for it and stock fetched) and H_out of a visit."""
        columns, team = self.columns, range(len(self.problem.robots))
        picked = [(columns.h[o, r, v], 1.0) for o in team if (o, r, v) in columns.h]
        dropped = [(columns.h[r, o, v], 1.0) for o in team if (r, o, v) in columns.h]
        for s, stock in enumerate(self.problem.stocks):
            if stock.node == v and (r, s) in columns.fetch:
                picked.append((columns.fetch[r, s], 1.0))
        return picked, dropped

    def _hand_over(self) -> None:
        columns, row = self.columns, self.linear.row
        for (r, o, v), amount in columns.h.items():
            delta = columns.delta[r, o, v]
            row([(amount, 1.0), (delta, -1.0)], lower=0)  # eq:delta_amount
            row([(amount, 1.0), (delta, -self.linear.upper[amount])], upper=0)
            # eq:delta_visits and eq:no_mutual, by the role each plays at the node
            row([(delta, 1.0), (columns.gives[r][v], -1.0)], upper=0)
            row([(delta, 1.0), (columns.gives[o][v], 1.0), (columns.y[o][v], -1.0)], upper=0)
        for r, roles in enumerate(columns.gives):
            for v, gives in roles.items():
                row([(gives, 1.0), (columns.y[r][v], -1.0)], upper=0)

    def _clear_stock(self) -> None:
        """Every sample left lying is fetched by somebody: the source of eq:conservation."""
        columns, row = self.columns, self.linear.row
        for s, stock in enumerate(self.problem.stocks):
            takers = [r for r in range(len(self.problem.robots)) if (r, s) in columns.fetch]
            row([(columns.fetch[r, s], 1.0) for r in takers], stock.count, stock.count)
            for r in takers:
                fetch, flag = columns.fetch[r, s], columns.fetches[r, s]
                row([(fetch, 1.0), (flag, -self.linear.upper[fetch])], upper=0)
                row([(flag, 1.0), (columns.y[r][stock.node], -1.0)], upper=0)

    # information

    def _samplers(self, v: int) -> list[tuple[int, float]]:
        """Return (a column, 1 / sigma^2) of every robot that may sample node v."""
        robots = self.problem.robots
        return [
            (self.columns.a[r][v], robots[r].precision) for r in range(len(robots)) if v in self.columns.a[r]
        ]

    def _pairs(self) -> list[tuple[SlotColumns, SlotColumns]]:
        return list(zip(self.columns.y, self.columns.a, strict=True))

    def _select_precision(self) -> None:
        """Selectors of precision levels (eq:precision_select) and one theta a group of test points."""
        problem, linear = self.problem, self.linear
        free = np.zeros(len(problem.candidates), dtype=bool)
        for i, v in enumerate(problem.candidates):
            samplers = self._samplers(v)
            most = [
                sum(int(linear.upper[column]) for column, precision in samplers if precision == kind)
                for kind in self.classes
            ]
            free[i] = np.prod([m + 1.0 for m in most]) <= _MAX_LEVELS
            if not free[i] or not samplers:
                continue
            levels = [counts for counts in itertools.product(*(range(m + 1) for m in most)) if any(counts)]
            self.columns.z[i] = [(counts, linear.column(0, 1)) for counts in levels]
            selectors: Terms = [(column, 1.0) for _, column in self.columns.z[i]]
            linear.row(selectors, upper=1)
            # valid: no level without a visit of somebody who may sample here
            linear.row([*selectors, *((y[v], -1.0) for y, a in self._pairs() if v in a)], upper=0)
            for k, kind in enumerate(self.classes):  # eq:precision, by sensor class
                taken: Terms = [(column, -1.0) for column, precision in samplers if precision == kind]
                if taken:
                    linear.row([*((z, float(c[k])) for c, z in self.columns.z[i]), *taken], 0, 0)
        self.groups = split_information(problem.information, free, max(self.classes))
        self.columns.theta = [linear.column(0, INFINITY, cost=1.0) for _ in self.groups]

    def _fix_precision(self, precision: FloatArray) -> None:
        for i, v in enumerate(self.problem.candidates):
            samplers = self._samplers(v)
            if samplers:
                unit = max(value for _, value in samplers)
                wanted = float(precision[i] - self.problem.gained[i]) / unit
                self.linear.row([(column, value / unit) for column, value in samplers], wanted, wanted)

    def _scaled_terms(self, group: Group, i: int) -> Terms:
        """Return q_i - q_i(gained) of a group as a linear expression."""
        gained = float(self.problem.gained[i])
        if i not in self.columns.z:
            assert group.share[i] == 0.0 or not self._samplers(self.problem.candidates[i])
            return self._samplers(self.problem.candidates[i])
        share = float(group.share[i])
        base = gained / (1.0 + share * gained)
        terms = []
        for counts, column in self.columns.z[i]:
            p = gained + sum(c * kind for c, kind in zip(counts, self.classes, strict=True))
            terms.append((column, p / (1.0 + share * p) - base))
        return terms

    def add_cuts(self, point: FloatArray, tolerance: float = 1e-7) -> int:
        """Add theta >= J(q_k) + grad J(q_k) (q - q_k) where theta is below J; return how many cuts.

        Parameters
        ----------
        point : array
            Values of all columns, fractional or not.
        """
        added = 0
        for group, theta in zip(self.groups, self.columns.theta, strict=True):
            terms = [self._scaled_terms(group, i) for i in range(len(self.problem.candidates))]
            gained = group.scaled(self.problem.gained)
            rise = np.array([sum(point[c] * k for c, k in part) for part in terms])
            value, gradient = group.information.value_and_gradient(gained + np.maximum(rise, 0.0))
            if point[theta] >= value - tolerance:
                continue
            slopes = [(c, -gradient[i] * k) for i, part in enumerate(terms) for c, k in part]
            self.linear.row([(theta, 1.0), *slopes], lower=value - float(gradient @ np.maximum(rise, 0.0)))
            added += 1
        return added

    def set_information(self, point: FloatArray) -> None:
        """Set selectors and thetas of an integer point to what its samples mean."""
        precision = self.problem.gained.copy()
        for i, v in enumerate(self.problem.candidates):
            taken = [0] * len(self.classes)
            for column, value in self._samplers(v):
                precision[i] += point[column] * value
                taken[self.classes.index(value)] += round(point[column])
            for counts, column in self.columns.z.get(i, []):
                point[column] = float(counts == tuple(taken))
        for group, theta in zip(self.groups, self.columns.theta, strict=True):
            point[theta] = group.information.value(group.scaled(precision))

    def energy_terms(self) -> Terms:
        """Return E^tot (eq:total_energy), in joules."""
        n, terms = len(self.problem.nodes), []
        for r, robot in enumerate(self.problem.robots):
            for (u, head), column in self.columns.x[r].items():
                alpha = float(robot.closure.energy_per_kg[u, head % n])
                terms.append((column, alpha * robot.empty_mass_kg))
                terms.append((self.columns.load[r][u, head], alpha * self.problem.sample_mass_kg))
        return terms


def _minus(terms: Terms) -> Terms:
    return [(column, -coefficient) for column, coefficient in terms]
