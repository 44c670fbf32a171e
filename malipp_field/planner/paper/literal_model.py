"""The paper's mixed-integer quadratic program, equation by equation (its Section "Problem Formulation").

Every block of constraints stands under its label in the paper; the bounds on departures, which have none
there, are "departure_bounds". The symbols are vectors over index sets
(`literal_sets`). As in the paper's own implementation, big-M constants are tight and
what cannot happen is left out; there are no other valid inequalities. eq:receiver_capacity is implied and
kept apart.

What a mission part-way adds:

- samples on board at the start are carried into it (eq:conservation and what follows from it);
- samples lying at a node are a handoff from the past: F of them are fetched, f indicates it, and they take
  the place of H and delta in eq:conservation, eq:delta_amount, eq:delta_visits and eq:deaddrop_sync;
- precision gained is part of p_v and of every level, and then exactly one level is selected.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import cvxpy as cp
import numpy as np

from malipp_field.field import FloatArray
from malipp_field.planner.paper.literal_sets import Family, Key, Sets, coefficient_bounds, windows
from malipp_field.planner.problem import Problem, RobotView

INFORMATION, ENERGY, MAKESPAN = "eq:llse_objective", "eq:total_energy", "eq:makespan"
"""Keys of `LiteralModel.objectives`, in the order of eq:lex_objective."""


class LiteralModel:
    """The MIQP of a problem.

    Attributes
    ----------
    constraints : dict
        Blocks of constraints by their label in the paper.
    implied : dict
        What the paper derives from them (eq:receiver_capacity): not part of the model.
    objectives : dict
        J, E^tot (J) and T^end (s) as expressions.
    variables : dict
        Variables by the paper's names; ``A_jvi`` has shape (T, L), ``A`` has (T, V), all others are vectors.
    scale : float
        J is minimised in units of it.
    """

    def __init__(self, problem: Problem) -> None:
        self.problem, self.sets = problem, Sets(problem)
        self.constraints: dict[str, list[Any]] = {}
        self.implied: dict[str, list[Any]] = {}
        self.objectives: dict[str, Any] = {}
        self._declare()
        self._information()
        self._objective()
        self._routing()
        self._flow()
        self._payload()
        self._custody()
        self._handoffs()
        self._stocks()
        self._timing()

    def _declare(self) -> None:
        """Declare all variables (eq:domains)."""
        sets = self.sets
        self.x = Family("x", sets.arcs, boolean=True)
        self.y = Family("y", sets.slots, boolean=True)
        self.a = Family("a", sets.samples, integer=True)
        self.p = Family("p", range(len(self.problem.candidates)))
        self.z = Family("z", sets.levels, boolean=True)
        self.phi = Family("phi", sets.arcs)
        self.Q = Family("Q", sets.arcs, integer=True)
        self.H = Family("H", sets.transfers, integer=True)
        self.delta = Family("delta", sets.transfers, boolean=True)
        self.F = Family("F", sets.fetches, integer=True)
        self.f = Family("f", sets.fetches, boolean=True)
        self.g = Family("g", sets.unloads, integer=True)
        self.t = Family("t", sets.slots)
        self.T_end = cp.Variable(name="T_end")
        tests = len(self.problem.information.k_tt)
        self.A_jvi = cp.Variable((tests, len(sets.levels)), name="A_jvi")
        self.A = cp.Variable((tests, len(self.problem.candidates)), name="A")
        # 1, as a variable: solvers measure their gap against an objective that includes its constant
        self.one = cp.Variable(name="one")
        counts = (self.a, self.Q, self.H, self.F, self.g)
        not_negative = [family.variable for family in (*counts, self.phi, self.t)]
        self.constraints["eq:domains"] = [*(v >= 0 for v in (*not_negative, self.T_end)), self.one == 1]

    @property
    def families(self) -> dict[str, Family]:
        """The symbols with index sets, by the paper's names."""
        names = ("x", "y", "a", "p", "z", "phi", "Q", "H", "delta", "F", "f", "g", "t")
        return {name: getattr(self, name) for name in names}

    @property
    def variables(self) -> dict[str, Any]:
        """All variables by the paper's names."""
        vectors = {name: family.variable for name, family in self.families.items()}
        return vectors | {v.name(): v for v in (self.A, self.A_jvi, self.T_end, self.one)}

    def violations(self, tolerance: float = 1e-6) -> dict[str, float]:
        """Return every label that the present values break, and by how much; integrality is eq:domains."""
        worst = {
            label: max((float(np.max(c.violation(), initial=0.0)) for c in block), default=0.0)
            for label, block in self.constraints.items()
        }
        off = [np.abs(v.value - v.project(v.value)) for v in self.variables.values() if v.size]
        worst["eq:domains"] = max(worst["eq:domains"], *(float(np.max(gap)) for gap in off))
        return {label: amount for label, amount in worst.items() if amount > tolerance}

    # Heterogeneous Sensing and Information Model

    def _information(self) -> None:
        problem, z = self.problem, self.z
        nodes = {v: i for i, v in enumerate(problem.candidates)}
        value = self.a.weigh(lambda key: problem.robots[key[0]].precision)
        where = self.a.summing(self.p.keys, lambda key: nodes[key[1]])
        of_node = z.summing(self.p.keys, lambda key: key[0])
        precision = z.weigh(lambda key: key[1])
        selected = of_node @ z.variable
        begun = problem.gained > 0
        most = self.a.weigh(lambda key: self.sets.most(*key))
        self.constraints["eq:sampling_visit"] = [self.a.variable <= cp.multiply(most, self.y.at(self.a.keys))]
        self.constraints["eq:precision"] = [
            self.p.variable == problem.gained + where @ cp.multiply(value, self.a.variable)
        ]
        self.constraints["eq:precision_select"] = [
            self.p.variable == of_node @ cp.multiply(precision, z.variable),
            selected <= 1,
            selected >= begun.astype(float),
        ]
        bound = coefficient_bounds(self.sets)
        active = bound @ cp.diag(z.variable) if z.keys else np.zeros(bound.shape)
        self.constraints["eq:A_activation"] = [
            self.A_jvi @ of_node.T == self.A,
            self.A_jvi <= active,
            -active <= self.A_jvi,
        ]

    def _objective(self) -> None:
        """State J (eq:llse_objective), in units of the prior variance.

        The two quadratic terms of a test point are one sum of squares: one cone for solvers that take cones.
        """
        known = self.problem.information
        unit = float(np.max(known.k_tt))
        values, vectors = np.linalg.eigh(known.k_vv / unit)
        root = np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T  # K_VV = root^T root
        rho = np.array([1.0 / p for _, p in self.z.keys]) / unit
        brackets = [
            cp.sum_squares(cp.hstack([root @ self.A[j], cp.multiply(np.sqrt(rho), self.A_jvi[j])]))
            - 2 * (known.k_tv[j] / unit) @ self.A[j]
            + known.k_tt[j] / unit * self.one
            for j in range(len(known.k_tt))
        ]
        self.scale = max(known.prior, 1e-300)
        self.objectives[INFORMATION] = unit * cp.sum(cp.multiply(known.weights, cp.hstack(brackets)))

    # Robot Routing Model

    def _into(self, family: Family, slots: list[Key]) -> Any:
        """Return the sum over arcs that lead into each slot."""
        return family.total(slots, lambda arc: (arc[0], arc[2]))

    def _out(self, family: Family, slots: list[Key]) -> Any:
        """Return the sum over arcs that leave each slot."""
        return family.total(slots, lambda arc: (arc[0], arc[1]))

    def _routing(self) -> None:
        sets, x, y = self.sets, self.x, self.y
        others = sets.stops + sets.copies
        robots = range(sets.size)
        copies = set(sets.copies)
        self.constraints["eq:start"] = [self._out(x, sets.starts) == 1, self._into(x, sets.starts) == 0]
        self.constraints["eq:visit_terminal"] = [
            y.at(sets.starts) == 1,
            self._into(x, others) == y.at(others),
        ]
        self.constraints["eq:terminal_select"] = [
            y.total(robots, lambda slot: slot[0] if slot in copies else None) == 1
        ]
        self.constraints["eq:balance"] = [self._out(x, sets.stops) == self._into(x, sets.stops)]

    def _flow(self) -> None:
        sets, x, phi, y = self.sets, self.x.variable, self.phi, self.y
        others = sets.stops + sets.copies
        most = self.x.weigh(lambda arc: len(self._robot(arc).places))  # N_r: all places, one copy, no start
        visited = y.total(range(sets.size), lambda slot: slot[0] if slot in set(others) else None)
        self.constraints["eq:flow"] = [x <= phi.variable, phi.variable <= cp.multiply(most, x)]
        self.constraints["eq:flow_balance"] = [
            self._into(phi, others) - self._out(phi, others) == y.at(others)
        ]
        self.constraints["eq:flow_source"] = [
            self._out(phi, sets.starts) - self._into(phi, sets.starts) == visited
        ]

    def _robot(self, key: Key) -> RobotView:
        robot: RobotView = self.problem.robots[key[0]]
        return robot

    # Payload, Custody, and Handoff

    def _payload(self) -> None:
        sets, x, Q = self.sets, self.x.variable, self.Q.variable
        capacity = self.x.weigh(lambda arc: self._robot(arc).capacity)
        alpha = self.x.weigh(sets.alpha)
        empty = self.x.weigh(lambda arc: self._robot(arc).empty_mass_kg)
        mass = cp.multiply(empty, x) + self.problem.sample_mass_kg * Q
        of_robot = self.x.summing(range(sets.size), lambda arc: arc[0])
        budgets = np.array([robot.budget_j for robot in self.problem.robots])
        energies = of_robot @ cp.multiply(alpha, mass)
        self.constraints["eq:payload"] = [Q - cp.multiply(capacity, x) <= 0]
        self.constraints["eq:energy_budget"] = [energies <= budgets]
        self.objectives[ENERGY] = cp.sum(energies)

    def _custody(self) -> None:
        slots, nodes = self.sets.slots, self.sets.starts + self.sets.stops
        capacity = self._capacities(slots)
        q_out = self._out(self.Q, slots)
        given, taken = self.dropped(slots), self.picked(slots)
        unloaded = self.g.total(slots, lambda key: key)
        held = self.brought(slots)
        self.constraints["eq:conservation"] = [held + taken == q_out + given + unloaded]
        self.constraints["eq:source_feasibility"] = [unloaded + given <= held]
        self.constraints["eq:cap_feasibility"] = [held <= capacity + unloaded]
        self.constraints["eq:handoff_capacity"] = [self.dropped(nodes) <= self._capacities(nodes)]
        self.constraints["eq:unload_bound"] = [
            self.g.variable <= cp.multiply(self._capacities(self.g.keys), self.y.at(self.g.keys))
        ]
        self.implied["eq:receiver_capacity"] = [taken <= capacity - (held - unloaded - given)]

    def brought(self, slots: list[Key]) -> Any:
        """Return Q_in + a of each slot; at a start, Q_in is what is on board there."""
        starts = set(self.sets.starts)
        on_board = np.array([float(self._robot(s).on_board if s in starts else 0) for s in slots])
        return on_board + self._into(self.Q, slots) + self.a.total(slots, lambda key: key)

    def dropped(self, slots: list[Key]) -> Any:
        """Return H_out of each slot."""
        return self.H.total(slots, lambda key: (key[0], key[2]))

    def picked(self, slots: list[Key]) -> Any:
        """Return H_in of each slot: drops made for it, and stock fetched."""
        stocks = self.problem.stocks
        handed = self.H.total(slots, lambda key: (key[1], key[2]))
        return handed + self.F.total(slots, lambda key: (key[0], stocks[key[1]].node))

    def _capacities(self, keys: Iterable[Key]) -> FloatArray:
        return np.array([float(self._robot(key).capacity) for key in keys])

    def _handoffs(self) -> None:
        H, delta, y, robots = self.H, self.delta, self.y, self.problem.robots
        most = H.weigh(lambda key: min(robots[key[0]].capacity, robots[key[1]].capacity))
        self.constraints["eq:delta_amount"] = [
            delta.variable <= H.variable,
            H.variable <= cp.multiply(most, delta.variable),
        ]
        self.constraints["eq:delta_visits"] = [
            delta.variable <= y.at((r, v) for r, _, v in delta.keys),
            delta.variable <= y.at((o, v) for _, o, v in delta.keys),
        ]
        pairs = [(r, o, v) for r, o, v in delta.keys if r < o]
        self.constraints["eq:no_mutual"] = [delta.at(pairs) + delta.at((o, r, v) for r, o, v in pairs) <= 1]

    def _stocks(self) -> None:
        """Let samples that lie at nodes be fetched, all of them: the handoffs of the past."""
        stocks, F, f = self.problem.stocks, self.F, self.f
        counts = np.array([float(stock.count) for stock in stocks])
        most = F.weigh(lambda key: min(stocks[key[1]].count, self._robot(key).capacity))
        self.constraints["eq:conservation"] += [F.total(range(len(stocks)), lambda key: key[1]) == counts]
        self.constraints["eq:delta_amount"] += [
            f.variable <= F.variable,
            F.variable <= cp.multiply(most, f.variable),
        ]
        self.constraints["eq:delta_visits"] += [
            f.variable <= self.y.at((r, stocks[s].node) for r, s in f.keys)
        ]

    # Asynchronous Dead-Drop Timing

    def _timing(self) -> None:
        sets, t, x, y = self.sets, self.t, self.x, self.y
        beta, window = self.problem.service_time_s, windows(sets)
        ready = np.array([robot.ready_s for robot in self.problem.robots])
        legs = x.weigh(sets.travel_s) + beta
        off = legs + x.weigh(lambda arc: window.latest[arc[0], arc[1]])  # big-M: t_u + tau + beta at most
        tails, heads = ((r, u) for r, u, _ in x.keys), ((r, v) for r, _, v in x.keys)
        self.constraints["eq:start_time"] = [t.at(sets.starts) >= ready + beta]
        self.constraints["eq:time_propagation"] = [
            t.at(heads) >= t.at(tails) + legs - cp.multiply(off, 1 - x.variable)
        ]
        self.constraints["departure_bounds"] = [
            cp.multiply(t.weigh(lambda slot: window.earliest[slot]), y.variable) <= t.variable,
            t.variable <= cp.multiply(t.weigh(lambda slot: window.latest[slot]), y.variable),
        ]
        wait = beta + self.problem.clearance_s
        off = wait + self.delta.weigh(lambda key: window.latest[key[0], key[2]])
        senders, receivers = ((r, v) for r, _, v in self.delta.keys), ((o, v) for _, o, v in self.delta.keys)
        stocks = self.problem.stocks
        since = self.f.weigh(lambda key: stocks[key[1]].available_s) + beta
        self.constraints["eq:deaddrop_sync"] = [
            t.at(receivers) >= t.at(senders) + wait - cp.multiply(off, 1 - self.delta.variable),
            t.at((r, stocks[s].node) for r, s in self.f.keys) >= cp.multiply(since, self.f.variable),
        ]
        self.constraints["eq:makespan"] = [self.T_end >= t.at(sets.copies)]
        self.objectives[MAKESPAN] = self.T_end
