"""What every plan of a team keeps when counts and arcs need not be whole: a polytope around all plans.

The rows are those of the paper's model without timing, so dead drops cost nothing but the energy of carrying
what is in them. Of a handoff only the net exchange of each robot at a node is kept; at every node the
exchanges of the team add up to what lay there (eq:conservation summed over the robots). A row that is left
out makes the polytope larger, never wrong.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import breadth_first_order, maximum_flow

from malipp_field.field import FloatArray
from malipp_field.planner.problem import Arc, Problem

Terms = list[tuple[int, float]]


class Rows(NamedTuple):
    """``matrix @ z`` against ``right``: equal, or at most."""

    matrix: csr_array
    right: FloatArray


@dataclass
class _Builder:
    """Rows as they come, column by column index."""

    terms: list[Terms] = field(default_factory=list)
    right: list[float] = field(default_factory=list)

    def add(self, terms: Terms, right: float) -> None:
        self.terms.append(terms)
        self.right.append(right)

    def rows(self, columns: int) -> Rows:
        """Return the rows, each divided by its largest coefficient: joules and counts side by side."""
        triples = [(i, column, value) for i, row in enumerate(self.terms) for column, value in row]
        i, column, value = np.array(triples, dtype=np.float64).reshape(-1, 3).T
        matrix = csr_array((value, (i.astype(int), column.astype(int))), shape=(len(self.terms), columns))
        size = abs(matrix).max(axis=1).toarray().ravel()
        size[size == 0.0] = 1.0
        return Rows(csr_array(matrix.multiply(1.0 / size[:, None])), np.array(self.right) / size)


@dataclass
class RobotColumns:
    """Columns of one robot by arc and by physical node (indices into `Problem.nodes`).

    ``x`` arcs, ``load`` Q, ``spent`` energy used up to the end of an arc as a share of the budget, ``a``
    samples, ``g`` unloaded, ``h`` net exchange (received less dropped). ``into`` and ``out_of`` list the arcs
    of each node, so that a row takes no search through all of them.
    """

    x: dict[Arc, int] = field(default_factory=dict)
    load: dict[Arc, int] = field(default_factory=dict)
    spent: dict[Arc, int] = field(default_factory=dict)
    a: dict[int, int] = field(default_factory=dict)
    g: dict[int, int] = field(default_factory=dict)
    h: dict[int, int] = field(default_factory=dict)
    into: dict[int, list[Arc]] = field(default_factory=lambda: defaultdict(list))
    out_of: dict[int, list[Arc]] = field(default_factory=lambda: defaultdict(list))

    def entering(self, columns: dict[Arc, int], v: int) -> Terms:
        """Return the columns of the arcs into ``v``."""
        return [(columns[arc], 1.0) for arc in self.into.get(v, ())]

    def leaving(self, columns: dict[Arc, int], v: int) -> Terms:
        """Return the columns of the arcs out of ``v``."""
        return [(columns[arc], 1.0) for arc in self.out_of.get(v, ())]


class Polytope:
    """Rows and box of the relaxation; `cut` adds rows that a point breaks.

    Attributes
    ----------
    lower, upper : arrays, shape (Z,)
        The box; finite, as the certificate of the bound needs it.
    robots : list of RobotColumns
        Where each robot's variables stand in z.
    """

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        self._lower: list[float] = []
        self._upper: list[float] = []
        self._equal, self._at_most = _Builder(), _Builder()
        self._cut: set[tuple[int, int, frozenset[int]]] = set()
        # No robot ever carries more than all there can be: a capacity beyond it only weakens the rows.
        everything = sum(robot.on_board + int(robot.limits.sum()) for robot in problem.robots)
        everything += sum(stock.count for stock in problem.stocks)
        self.capacity = [min(robot.capacity, everything) for robot in problem.robots]
        self.robots = [self._add_robot(r) for r in range(len(problem.robots))]
        self._exchange()

    @property
    def lower(self) -> FloatArray:
        """Lower ends of the box."""
        return np.array(self._lower)

    @property
    def upper(self) -> FloatArray:
        """Upper ends of the box."""
        return np.array(self._upper)

    @property
    def equal(self) -> Rows:
        """Rows that hold with equality."""
        return self._equal.rows(len(self._lower))

    @property
    def at_most(self) -> Rows:
        """Rows that hold as upper bounds."""
        return self._at_most.rows(len(self._lower))

    def precision_map(self) -> csr_array:
        """Return D, shape (V, Z): the precision that z adds at the candidates (eq:precision)."""
        position = {v: i for i, v in enumerate(self.problem.candidates)}
        triples = [
            (position[v], column, robot.precision)
            for robot, columns in zip(self.problem.robots, self.robots, strict=True)
            for v, column in columns.a.items()
        ]
        i, column, value = np.array(triples, dtype=np.float64).reshape(-1, 3).T
        return csr_array(
            (value, (i.astype(int), column.astype(int))), shape=(len(position), len(self._lower))
        )

    def _column(self, lower: float, upper: float) -> int:
        self._lower.append(lower)
        self._upper.append(upper)
        return len(self._lower) - 1

    def _add_robot(self, r: int) -> RobotColumns:
        problem, robot, most = self.problem, self.problem.robots[r], float(self.capacity[r])
        columns = RobotColumns()
        for arc in problem.arcs(r):
            columns.out_of[arc[0]].append(arc)
            columns.into[arc[1]].append(arc)
            columns.x[arc] = self._column(0.0, 1.0)
            columns.load[arc] = self._column(0.0, most)
            columns.spent[arc] = self._column(0.0, 1.0)
        for v in robot.places:
            if robot.limits[v] > 0:
                columns.a[v] = self._column(0.0, float(robot.limits[v]))
            if v in robot.depots:
                columns.g[v] = self._column(0.0, most)
            columns.h[v] = self._column(-most, most)
        self._route(r, columns)
        self._carry(r, columns)
        self._spend(r, columns)
        return columns

    def _route(self, r: int, columns: RobotColumns) -> None:
        """eq:start, eq:visit_terminal, eq:balance, eq:sampling_visit."""
        robot = self.problem.robots[r]
        self._equal.add(columns.leaving(columns.x, robot.start), 1.0)
        for v in robot.stops:
            visited = columns.entering(columns.x, v)
            self._equal.add(visited + _times(columns.leaving(columns.x, v), -1.0), 0.0)
            self._at_most.add(visited, 1.0)
            if v in columns.a:
                limit = float(robot.limits[v])
                self._at_most.add([(columns.a[v], 1.0), *_times(visited, -limit)], 0.0)

    def _carry(self, r: int, columns: RobotColumns) -> None:
        """eq:payload, eq:conservation, eq:cap_feasibility, eq:unload_bound; exchanges only where it stops."""
        robot, most = self.problem.robots[r], float(self.capacity[r])
        for arc, load in columns.load.items():
            self._at_most.add([(load, 1.0), (columns.x[arc], -most)], 0.0)
        for v in robot.places:
            visited, known = ([], 1.0) if v == robot.start else (columns.entering(columns.x, v), 0.0)
            on_board = float(robot.on_board) if v == robot.start else 0.0
            brought = columns.entering(columns.load, v) + [(c, 1.0) for c in _at(columns.a, v)]
            unloaded = [(c, -1.0) for c in _at(columns.g, v)]
            h = columns.h[v]
            gone = _times(columns.leaving(columns.load, v), -1.0)
            self._equal.add(brought + unloaded + [(h, 1.0)] + gone, -on_board)
            self._at_most.add(brought + unloaded + _times(visited, -most), most * known - on_board)
            for g in _at(columns.g, v):
                self._at_most.add([(g, 1.0), *_times(visited, -most)], most * known)
            for sign in (1.0, -1.0):
                self._at_most.add([(h, sign), *_times(visited, -most)], most * known)

    def _spend(self, r: int, columns: RobotColumns) -> None:
        """eq:energy_budget, as a flow of energy spent along the route.

        It grows on each arc by what the arc takes, so no circle apart from the route can feed itself.
        """
        problem, robot = self.problem, self.problem.robots[r]
        budget, cost, n = max(robot.budget_j, 1e-9), robot.closure.energy_per_kg, len(self.problem.nodes)
        nearest = cost[:, list(robot.depots)].min(axis=1)

        def share(arc: Arc) -> float:
            return float(cost[arc[0], arc[1] % n]) / budget

        for (u, head), column in columns.spent.items():
            x, mass = columns.x[u, head], robot.empty_mass_kg
            least = mass * (float(cost[robot.start, u]) / budget + share((u, head)))
            rest = 0.0 if head >= n else mass * float(nearest[head]) / budget
            self._at_most.add([(x, least), (column, -1.0)], 0.0)
            self._at_most.add([(column, 1.0), (x, rest - 1.0)], 0.0)
        for v in robot.places:
            taken: Terms = []
            for arc in columns.out_of.get(v, ()):
                taken.append((columns.x[arc], share(arc) * robot.empty_mass_kg))
                taken.append((columns.load[arc], share(arc) * problem.sample_mass_kg))
            spent = columns.entering(columns.spent, v) if v != robot.start else []
            self._equal.add(spent + taken + _times(columns.leaving(columns.spent, v), -1.0), 0.0)

    def _exchange(self) -> None:
        """Let the team receive at a node what it drops there and what lay there before."""
        lying: dict[int, float] = defaultdict(float)
        for stock in self.problem.stocks:
            lying[stock.node] += stock.count
        nodes = sorted({v for columns in self.robots for v in columns.h} | set(lying))
        for v in nodes:
            self._equal.add([(columns.h[v], 1.0) for columns in self.robots if v in columns.h], lying[v])

    def cut(self, z: FloatArray, margin: float = 0.02) -> int:
        """Add rows against circles apart from the route that ``z`` breaks; return how many.

        For a set S of nodes without the start and v in S: the arcs into S carry at least the visit of v
        (what eq:flow to eq:flow_source give, and more for fractions).
        """
        return sum(self._cut_robot(r, z, margin) for r in range(len(self.robots)))

    def _cut_robot(self, r: int, z: FloatArray, margin: float) -> int:
        robot, columns = self.problem.robots[r], self.robots[r]
        x = columns.x
        graph = _capacities(x, z, len(self.problem.nodes))
        added = 0
        for v in robot.stops:
            visited = sum(z[column] for column, _ in columns.entering(x, v))
            if visited < margin:
                continue
            inside = _behind_minimum_cut(graph, robot.start, v)
            crossing = [(c, -1.0) for (u, head), c in x.items() if head in inside and u not in inside]
            short = visited + sum(z[c] * sign for c, sign in crossing)
            if short > margin and (r, v, inside) not in self._cut:
                self._cut.add((r, v, inside))
                self._at_most.add(columns.entering(x, v) + crossing, 0.0)
                added += 1
        return added


_FLOW_UNIT = 1_000_000
"""SciPy's maximum flow counts in whole numbers: capacities are in millionths of an arc."""


def _capacities(x: dict[Arc, int], z: FloatArray, nodes: int) -> csr_array:
    inner = [(u, head, round(z[column] * _FLOW_UNIT)) for (u, head), column in x.items() if head < nodes]
    u, head, capacity = np.array(inner, dtype=np.int32).reshape(-1, 3).T
    return csr_array((np.maximum(capacity, 0), (u, head)), shape=(nodes, nodes), dtype=np.int32)


def _behind_minimum_cut(graph: csr_array, start: int, v: int) -> frozenset[int]:
    """Return the nodes that a minimum cut parts from the start; v is one of them."""
    left = csr_array(graph - maximum_flow(graph, start, v).flow)
    left.eliminate_zeros()
    reached = breadth_first_order(left, start, return_predecessors=False)
    return frozenset(range(graph.shape[0])) - {int(node) for node in reached}


def _at(columns: dict[int, int], v: int) -> list[int]:
    return [columns[v]] if v in columns else []


def _times(terms: Terms, factor: float) -> Terms:
    return [(column, factor * value) for column, value in terms]
