"""Ruin and recreate: a quick search for better plans, started from any plan.

A few samples are taken out of the plan, then samples are put in one after the other, each with the way home
that buys most information for the energy it costs. Which ways are tried is drawn at random. Changes are
accepted as in annealing on J. It proves nothing; it gives the exact search its incumbents.
"""

from __future__ import annotations

import math
import random

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from malipp_field.field import FloatArray
from malipp_field.planner.draft import COLLECTED, ON_BOARD, STOCK, Draft, Sample, draft_of
from malipp_field.planner.extract import TeamPlan, team_plan
from malipp_field.planner.linear import Effort
from malipp_field.planner.problem import Problem

_CONSTRUCTIONS = 20
"""Attempts to build a plan where there is none to begin with."""
_TRIES = 20
"""Ways home tried for each insertion."""
_MOST_TAKEN_OUT = 8
_PART_OF_A_ROBOT = 0.6
"""Chance that a robot whose samples are taken out keeps some."""
_OWN_WAY = 0.2
"""Chance that a way without a drop is tried."""
_HUB = 0.3
"""Chance that a drop is tried at the one node that a change prefers: several samples move there together."""
_START_TEMPERATURE, _END_TEMPERATURE = 2e-2, 1e-4
"""As shares of J of the plan begun with."""
_ENERGY_WEIGHT = 1e-3
"""What the whole of every budget counts as, as a share of J: among equals the cheaper plan is kept."""


class Improver:
    """Repeated improvement of one problem's plans, reproducible for a seed."""

    def __init__(self, problem: Problem, seed: int) -> None:
        self.problem = problem
        self._random = random.Random(seed)  # noqa: S311 (a search, not a secret)
        self._position = {v: i for i, v in enumerate(problem.candidates)}
        self._pairs = [
            (r, v) for r, robot in enumerate(problem.robots) for v in robot.places if robot.limits[v] > 0
        ]
        self._places = [set(robot.places) for robot in problem.robots]
        self._hubs = sorted(set().union(*self._places))
        self._hub = self._hubs[0]

    def improve(self, team: TeamPlan, iterations: int, effort: Effort) -> TeamPlan:
        """Return the best plan found in so many iterations; never a worse one than ``team``."""
        current = draft_of(self.problem, team)
        value = self._value(current)
        best, best_value = current, value
        scale = max(team.information, 1e-9)
        for i in range(iterations):
            if effort.over:
                break
            heat = scale * _START_TEMPERATURE * (_END_TEMPERATURE / _START_TEMPERATURE) ** (i / iterations)
            draft = self._changed(current)
            if draft is None:
                continue
            new = self._value(draft)
            if new < value or self._random.random() < math.exp((value - new) / heat):
                current, value = draft, new
            if value < best_value:
                best, best_value = current, value
        found = team_plan(self.problem, best.visits())
        return found if found is not None and found.rank < team.rank else team

    def construct(self) -> TeamPlan | None:
        """Return a plan in which all robots and what must come home do come home; None if none is found.

        The paper's fallback of direct-depot routes, with samples on board and in drops put in one by one.
        """
        for _ in range(_CONSTRUCTIONS):
            draft = Draft(self.problem, [[robot.start, robot.start] for robot in self.problem.robots], [])
            draft.tidy()
            must = [
                Sample(ON_BOARD, robot.start, r) for r, robot in enumerate(self.problem.robots)
                for _ in range(robot.on_board)
            ]  # fmt: skip
            must += [
                Sample(STOCK, stock.node, 0, (), s) for s, stock in enumerate(self.problem.stocks)
                for _ in range(stock.count)
            ]  # fmt: skip
            self._random.shuffle(must)
            if all(self._place(draft, sample) for sample in must):
                found = team_plan(self.problem, draft.visits())
                if found is not None:
                    return found
        return None

    def _place(self, draft: Draft, sample: Sample) -> bool:
        """Put in a sample that must come home; one on board may stay there if its robot can carry it."""
        if sample.kind == ON_BOARD and not math.isinf(draft.energy_j(sample.robot)):
            draft.add(sample)
            return True
        return self._insert(draft, [(sample, 1.0)])

    # objective

    def _precision(self, draft: Draft) -> FloatArray:
        precision = self.problem.gained.copy()
        for robot, collect in zip(self.problem.robots, draft.collect, strict=True):
            for v, count in collect.items():
                if count:
                    precision[self._position[v]] += count * robot.precision
        return precision

    def _value(self, draft: Draft) -> float:
        """Return J and, of little weight, the energy; infinity where a route breaks a rule."""
        information = self.problem.information.value(self._precision(draft))
        shares = [
            draft.energy_j(r) / max(robot.budget_j, 1e-9) for r, robot in enumerate(self.problem.robots)
        ]
        return information + _ENERGY_WEIGHT * self.problem.information.prior * sum(shares) / len(shares)

    def _gains(self, draft: Draft) -> dict[tuple[int, int], float]:
        """Return by how much J falls with one more sample of robot r at v, for every (r, v) still open."""
        information = self.problem.information
        root = np.sqrt(self._precision(draft))
        factor = cho_factor(np.eye(root.size) + root[:, None] * information.k_vv * root, lower=True)
        known = cho_solve(factor, root[:, None] * information.k_vv)
        c_vv = information.k_vv - (information.k_vv * root) @ known
        c_tv = information.k_tv - (information.k_tv * root) @ known
        fall, spread = information.weights @ c_tv**2, np.diag(c_vv)
        gains = {}
        for r, v in self._pairs:
            robot = self.problem.robots[r]
            if draft.collect[r][v] < robot.limits[v]:
                i = self._position[v]
                gains[r, v] = float(robot.precision * fall[i] / (1.0 + robot.precision * max(spread[i], 0.0)))
        return gains

    # ruin

    def _changed(self, current: Draft) -> Draft | None:
        """Return a changed copy; None where a sample that must come home found no way."""
        draft = current.copy()
        self._hub = self._random.choice(self._hubs)
        homeless = self._ruin(draft)
        draft.tidy()
        if self._random.random() < 0.15:
            self._visit_depot(draft)
        if any(math.isinf(draft.energy_j(r)) for r in range(len(draft.routes))):
            return None
        for sample in homeless:
            if not self._insert(draft, [(sample, 1.0)]):
                return None
        self._recreate(draft)
        draft.tidy()
        return draft

    def _ruin(self, draft: Draft) -> list[Sample]:
        """Take samples out; return those that have to be put in again."""
        if not draft.samples:
            return []
        how = self._random.random()
        count = self._random.randint(1, max(1, min(_MOST_TAKEN_OUT, len(draft.samples))))
        drops = [node for s in draft.samples for node, _ in s.hops]
        if how < 0.2 and drops:
            place = self._random.choice(drops)
            gone = [s for s in draft.samples if place in {node for node, _ in s.hops}]
        elif how < 0.4:
            gone = self._random.sample(draft.samples, count)
        elif how < 0.7:
            robot = self._random.randrange(len(draft.routes))
            gone = [s for s in draft.samples if robot in {s.robot, *(o for _, o in s.hops)}]
            self._random.shuffle(gone)
            gone = gone[: 2 * count] if self._random.random() < _PART_OF_A_ROBOT else gone
        else:
            cost = self.problem.robots[self._random.randrange(len(draft.routes))].closure.rows
            centre = self._random.choice(draft.samples).node
            gone = sorted(draft.samples, key=lambda s: cost[centre][s.node])[:count]
        for sample in gone:
            draft.remove(sample)
        return [Sample(s.kind, s.node, s.robot, (), s.stock) for s in gone if s.kind != COLLECTED]

    def _visit_depot(self, draft: Draft) -> None:
        """Send a random robot through one of its depots on the way."""
        r = self._random.randrange(len(draft.routes))
        route, robot = draft.routes[r], self.problem.robots[r]
        depots = [d for d in robot.depots if d in self._places[r] and d not in route[:-1]]
        if depots and len(route) > 2:
            route.insert(self._random.randint(2, len(route) - 1), self._random.choice(depots))
            route[-1] = draft.terminal(r, route[:-1])

    # recreate

    def _recreate(self, draft: Draft) -> None:
        """Put in samples as long as one can be found that fits."""
        greed = self._random.uniform(0.0, 1.2)
        found = True
        while found:
            gains = self._gains(draft)
            if not gains:
                return
            pairs = sorted(gains, key=lambda pair: -gains[pair] * self._random.uniform(0.5, 1.0))
            wanted = [(Sample(COLLECTED, v, r), gains[r, v]) for r, v in pairs]
            found = self._insert(draft, wanted, greed)

    def _insert(self, draft: Draft, wanted: list[tuple[Sample, float]], greed: float = 1.0) -> bool:
        """Insert one of the samples wanted by the best way of those tried; tell whether one was found."""
        before = [draft.energy_j(r) for r in range(len(draft.routes))]
        options: list[tuple[float, int, Sample, dict[int, list[int]]]] = []
        for _ in range(_TRIES):
            bare, gain = wanted[int(len(wanted) * self._random.random() ** 2)]
            option = self._option(draft, bare, before)
            if option is not None:
                cost, sample, routes = option
                options.append((gain / (0.02 + cost) ** greed, len(options), sample, routes))
        for _, _, sample, routes in sorted(options, key=lambda o: (-o[0], o[1])):
            old = draft.routes
            draft.routes = [routes.get(r, route) for r, route in enumerate(old)]
            draft.add(sample)
            if draft.in_order():
                return True
            draft.remove(sample)
            draft.routes = old
        return False

    def _option(
        self, draft: Draft, bare: Sample, before: list[float]
    ) -> tuple[float, Sample, dict[int, list[int]]] | None:
        """Return a random way home for a sample: its cost in shares of budgets, and the routes it changes."""
        r, routes = bare.robot, {}
        if bare.kind == STOCK:
            r = self._random.randrange(len(draft.routes))
            bare = Sample(bare.kind, bare.node, r, (), bare.stock)
            if bare.node not in self._places[r]:
                return None
        routes[r] = self._passing(draft.routes[r], r, bare.node)
        sample = bare
        if self.problem.handoffs and self._random.random() > _OWN_WAY:
            place = routes[r].index(bare.node)
            node = self._drop_place(routes[r], place)
            o = self._random.randrange(len(draft.routes))
            if o == r or node not in self._places[r] or node not in self._places[o]:
                return None
            if node in self.problem.closed:
                return None
            if node not in routes[r][:-1]:
                routes[r] = self._passing(routes[r], r, node, place + 1)
            routes[o] = self._passing(draft.routes[o], o, node)
            sample = Sample(bare.kind, bare.node, r, ((node, o),), bare.stock)
        return self._cost(draft, sample, routes, before)

    def _drop_place(self, route: list[int], place: int) -> int:
        """Return where to drop: at this change's hub, on the spot, at a later stop, or anywhere."""
        if self._random.random() < _HUB:
            return self._hub
        how = self._random.random()
        if how < 0.4 or (place + 2 >= len(route) and how < 0.8):
            return route[place]
        if how < 0.8:
            return self._random.choice(route[place + 1 : -1])
        places = self.problem.robots[self._random.randrange(len(self.problem.robots))].places
        return self._random.choice(places)

    def _cost(
        self, draft: Draft, sample: Sample, routes: dict[int, list[int]], before: list[float]
    ) -> tuple[float, Sample, dict[int, list[int]]] | None:
        old = draft.routes
        draft.routes = [routes.get(r, route) for r, route in enumerate(old)]
        draft.count(sample, 1)
        cost = 0.0
        for r in routes:
            energy = draft.energy_j(r)
            if math.isinf(energy):
                cost = energy
                break
            more = energy - (0.0 if math.isinf(before[r]) else before[r])
            cost += max(more, 0.0) / max(self.problem.robots[r].budget_j, 1e-9)
        draft.count(sample, -1)
        draft.routes = old
        return None if math.isinf(cost) else (cost, sample, routes)

    def _passing(self, route: list[int], r: int, node: int, first: int = 1) -> list[int]:
        """Return the route with ``node`` as a stop, put where the detour is least (mostly)."""
        if node in route[:-1]:
            return route
        cost = self.problem.robots[r].closure.rows
        if self._random.random() < 0.7:
            away = cost[node]
            detours = [
                cost[before][node] + away[after] - cost[before][after]
                for before, after in zip(route[first - 1 :], route[first:], strict=False)
            ]
            i = first + detours.index(min(detours))
        else:
            i = self._random.randrange(first, len(route))
        return [*route[:i], node, *route[i:]]
