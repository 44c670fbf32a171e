"""What the compiled search reads and changes: a problem, and a team plan in the making, as flat arrays.

Nodes, robots and candidates are the indices of `Problem`. A plan is, per robot, a list of stops, and per
sample the way it takes home (`malipp_field.planner.draft`); the rest of `State` is derived from these.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from malipp_field.field import FloatArray
from malipp_field.planner.draft import ON_BOARD, STOCK, Draft, Sample
from malipp_field.planner.problem import IntArray, Problem

BoolArray = NDArray[np.bool_]

KIND, NODE, ROBOT, PILE, HOPS, FIRST_HOP = 0, 1, 2, 3, 4, 5
"""Columns of `State.samples`; from ``FIRST_HOP`` on, node and receiver of each drop."""
MOST_DROPS = 3
"""Drops of one sample that the search makes: there, back, and there again."""
LEAST_HOPS = MOST_DROPS
"""Drops a sample's row has room for at least."""
W_ROBOT, W_NODE, W_AT, W_DROPS, W_FIRST = range(5)
"""Columns of a way: who takes the sample where, before which stop; number of drops; from ``W_FIRST`` on, for
each drop, its node, before which stop of the giver it is, who fetches it, and before which stop."""
W_WIDTH = 4
_SLACK, _SLACK_J = 5e-10, 5e-13
"""Half of what `within` forgives, so that no sum in another order is judged otherwise."""


class Case(NamedTuple):
    """A problem as arrays; R robots, N nodes, V candidates, T test points.

    Attributes
    ----------
    cost : array, shape (R, N, N)
        alpha_uv in J/kg, infinity where there is no way.
    back : array, shape (R, N, N)
        The same with from and to exchanged: alpha_uv at (r, v, u).
    home, terminal : array, shape (R, N)
        Cheapest way from a last stop to a depot (never the stop itself), and that depot.
    home_at_once, terminal_at_once : array, shape (R,)
        The same from the start, for a robot that stops nowhere else: its start counts.
    depot, place : array, shape (R, N)
        Where a robot may unload, and where it may operate.
    handoff : array, shape (R, R, N)
        Where sender may leave something for receiver.
    mass_kg, budget_j, capacity, precision : array, shape (R,)
        Budgets include what `within` forgives.
    limits : array, shape (R, N)
        Samples that may be taken.
    candidate : array, shape (N,)
        Position in V, or -1.
    k_vv : array, shape (V, V); k_vt : array, shape (V, T)
        Covariances given what has been gained already.
    prior
        J given what has been gained already.
    fixed_board : array, shape (R,); fixed_collect, fixed_give, fixed_take : array, shape (R, N)
        What the robots do beyond the samples of the search: their part in samples that others handle as well.
    """

    cost: FloatArray
    back: FloatArray
    home: FloatArray
    terminal: IntArray
    home_at_once: FloatArray
    terminal_at_once: IntArray
    start: IntArray
    depot: BoolArray
    place: BoolArray
    handoff: BoolArray
    mass_kg: FloatArray
    budget_j: FloatArray
    capacity: IntArray
    precision: FloatArray
    limits: IntArray
    candidate: IntArray
    k_vv: FloatArray
    k_vt: FloatArray
    weights: FloatArray
    prior: float
    sample_mass_kg: float
    fixed_board: IntArray
    fixed_collect: IntArray
    fixed_give: IntArray
    fixed_take: IntArray


class State(NamedTuple):
    """A plan in the making; L is the most stops a route can have.

    Attributes
    ----------
    route : array, shape (R, L); length : array, shape (R,)
        Nodes from the start to the terminal.
    pos : array, shape (R, N)
        Index of the stop at a node (the terminal is none), or -1.
    collect, give, take : array, shape (R, N)
        Samples collected, dropped, and picked or fetched.
    pair : array, shape (R, R, N)
        Samples that sender drops for receiver.
    board : array, shape (R,)
        Samples on board at the start, as far as they are among ``samples``.
    samples : array, shape (S, FIRST_HOP + 2 H); size : array, shape (1,)
        One row a sample, and how many rows count.
    arrive : array, shape (R, L)
        Samples held at a stop before anything is handed over; at a depot, those to be unloaded.
    depart : array, shape (R, L)
        Samples on board on departure.
    cum : array, shape (R, L)
        alpha from the start to a stop, in J/kg.
    unload : array, shape (R, L)
        Index of the first unloading stop after a stop.
    peak : array, shape (R, L)
        Most samples held from the departure at a stop until that unloading.
    energy_j : array, shape (R,)
    clock : array, shape (R, L, R)
        Index of the last stop of each robot that must be over before a stop, or -1 (a vector clock).
    c_vv, c_vt, fall : array, shape (V, V), (V, T), (V,)
        Posterior covariances, and -dJ/dp.
    value : array, shape (1,)
        J.
    """

    route: IntArray
    length: IntArray
    pos: IntArray
    collect: IntArray
    give: IntArray
    take: IntArray
    pair: IntArray
    board: IntArray
    samples: IntArray
    size: IntArray
    arrive: IntArray
    depart: IntArray
    cum: FloatArray
    unload: IntArray
    peak: IntArray
    energy_j: FloatArray
    clock: IntArray
    c_vv: FloatArray
    c_vt: FloatArray
    fall: FloatArray
    value: FloatArray


class Scratch(NamedTuple):
    """Working arrays of one search.

    Attributes
    ----------
    weight : array, shape (R,)
        What a joule of each robot counts in this iteration.
    shy : array, shape (R,)
        What counts against bringing a sample home oneself: several samples can then change hands at once.
    fetch : array, shape (R, N)
        Least cost for a robot to fetch one sample at a node and bring it to its next unloading stop.
    detour : array, shape (R, N)
        Least cost for a robot to stop at a node.
    least : array, shape (R, N); lowest : array, shape (R,)
        Least ``fetch`` cost of a partner for what a robot leaves at a node, and anywhere: bounds that prune.
    changed : array, shape (R,)
        Robots whose ``fetch`` costs are to be found anew.
    gain : array, shape (R, N)
        What one more sample of a robot at a node is taken to gain in this step, noise included.
    hub : array, shape (N,)
        Nodes at which new stops for a drop are tried in this iteration.
    way, best : array, shape (W_FIRST + W_WIDTH * MOST_DROPS,)
        The insertion looked at, and the best so far.
    labels : array, shape (MOST_DROPS, R, N, 4); trails : array, shape (MOST_DROPS, R, N, 6)
        Labels of the search for chains of drops (`chain`), and how each came about.
    trail : array, shape (6,); given : array, shape (1,)
        How the label looked at came about, and the energy of the giver's part.
    sample : array, shape (4,)
        Kind, node, robot and stock of the sample to be inserted.
    chains : array, shape (1,)
        Whether more than one drop of a sample is looked for in this iteration.
    blink : array, shape (1,)
        Chance that a place in a route is overlooked.
    homeless : array, shape (S, 4)
        Samples taken out that must be put in again.
    key : array, shape (S,)
        Sort keys of samples.
    rng : array, shape (1,)
        State of the random generator.
    """

    weight: FloatArray
    shy: FloatArray
    fetch: FloatArray
    detour: FloatArray
    least: FloatArray
    lowest: FloatArray
    changed: BoolArray
    gain: FloatArray
    hub: BoolArray
    way: IntArray
    best: IntArray
    labels: FloatArray
    trails: IntArray
    trail: IntArray
    given: FloatArray
    sample: IntArray
    chains: BoolArray
    blink: FloatArray
    homeless: IntArray
    key: FloatArray
    rng: NDArray[np.uint64]


def case_of(problem: Problem) -> Case:
    """Return a problem as arrays."""
    robots, n = problem.robots, len(problem.nodes)
    ways_home = [[_way_home(problem, r, v, {v}) for v in range(n)] for r in range(len(robots))]
    at_once = [_way_home(problem, r, robot.start, set()) for r, robot in enumerate(robots)]
    k_vv, k_tv = problem.information.posterior(problem.gained)
    index = np.full(n, -1, dtype=np.int64)
    index[list(problem.candidates)] = np.arange(len(problem.candidates))
    limits = np.array([np.minimum(robot.limits, robot.capacity) for robot in robots], dtype=np.int64)
    place = _mask([robot.places for robot in robots], n)
    return Case(
        cost=np.array([robot.closure.energy_per_kg for robot in robots]),
        back=np.array([robot.closure.energy_per_kg.T for robot in robots]),
        home=np.array([[cost for cost, _ in row] for row in ways_home]),
        terminal=np.array([[depot for _, depot in row] for row in ways_home], dtype=np.int64),
        home_at_once=np.array([cost for cost, _ in at_once]),
        terminal_at_once=np.array([depot for _, depot in at_once], dtype=np.int64),
        start=np.array([robot.start for robot in robots], dtype=np.int64),
        depot=_mask([robot.depots for robot in robots], n),
        place=place,
        handoff=_handoffs(problem),
        mass_kg=np.array([robot.empty_mass_kg for robot in robots]),
        budget_j=np.array([robot.budget_j * (1.0 + _SLACK) + _SLACK_J for robot in robots]),
        capacity=np.array([robot.capacity for robot in robots], dtype=np.int64),
        precision=np.array([robot.precision for robot in robots]),
        limits=np.where(place & (index >= 0), limits, 0),
        candidate=index,
        k_vv=np.ascontiguousarray(k_vv),
        k_vt=np.ascontiguousarray(k_tv.T),
        weights=np.asarray(problem.information.weights, dtype=np.float64),
        prior=problem.information.value(problem.gained),
        sample_mass_kg=float(problem.sample_mass_kg),
        fixed_board=np.zeros(len(robots), dtype=np.int64),
        fixed_collect=np.zeros_like(limits),
        fixed_give=np.zeros_like(limits),
        fixed_take=np.zeros_like(limits),
    )


def state_for(case: Case, samples: int, hops: int) -> State:
    """Return a state with room for so many samples and drops of each; every robot goes home at once."""
    robots, n = case.place.shape
    longest = int(case.place.sum(axis=1).max()) + 2
    v = len(case.k_vt)

    def ints(*shape: int) -> IntArray:
        return np.zeros(shape, dtype=np.int64)

    state = State(
        route=ints(robots, longest), length=np.full(robots, 2, dtype=np.int64), pos=ints(robots, n) - 1,
        collect=ints(robots, n), give=ints(robots, n), take=ints(robots, n), pair=ints(robots, robots, n),
        board=ints(robots), samples=ints(samples, FIRST_HOP + 2 * hops), size=ints(1),
        arrive=ints(robots, longest), depart=ints(robots, longest), cum=np.zeros((robots, longest)),
        unload=ints(robots, longest), peak=ints(robots, longest), energy_j=np.zeros(robots),
        clock=ints(robots, longest, robots) - 1, c_vv=case.k_vv.copy(), c_vt=case.k_vt.copy(),
        fall=np.zeros(v), value=np.full(1, case.prior),
    )  # fmt: skip
    for r in range(robots):
        state.route[r, :2] = case.start[r], case.terminal_at_once[r]
        state.pos[r, case.start[r]] = 0
    return state


def scratch_for(case: Case, samples: int, seed: int) -> Scratch:
    """Return working arrays for a search."""
    robots, n = case.place.shape
    way = W_FIRST + W_WIDTH * MOST_DROPS
    return Scratch(
        weight=np.ones(robots), shy=np.zeros(robots), fetch=np.zeros((robots, n)),
        detour=np.zeros((robots, n)), least=np.zeros((robots, n)),
        lowest=np.zeros(robots),
        changed=np.ones(robots, dtype=np.bool_), gain=np.zeros((robots, n)), hub=np.ones(n, dtype=np.bool_),
        way=np.zeros(way, dtype=np.int64), best=np.zeros(way, dtype=np.int64),
        labels=np.zeros((MOST_DROPS, robots, n, 4)), given=np.zeros(1),
        trails=np.zeros((MOST_DROPS, robots, n, 6), dtype=np.int64),
        trail=np.zeros(6, dtype=np.int64),
        sample=np.zeros(4, dtype=np.int64),
        chains=np.zeros(1, dtype=np.bool_), blink=np.zeros(1),
        homeless=np.zeros((samples, 4), dtype=np.int64),
        key=np.zeros(samples), rng=np.full(1, seed % 2**64, dtype=np.uint64),
    )  # fmt: skip


def most_samples(problem: Problem, case: Case) -> int:
    """Return how many samples a plan can have at most."""
    mandatory = sum(robot.on_board for robot in problem.robots) + sum(s.count for s in problem.stocks)
    return int(case.limits.sum()) + mandatory + 1


def mandatory_samples(problem: Problem) -> list[Sample]:
    """Return the samples that must come home, on board of their robots or in their stocks; no way chosen."""
    found = [
        Sample(ON_BOARD, robot.start, r)
        for r, robot in enumerate(problem.robots)
        for _ in range(robot.on_board)
    ]
    return found + [
        Sample(STOCK, stock.node, 0, (), s)
        for s, stock in enumerate(problem.stocks)
        for _ in range(stock.count)
    ]


def load(state: State, draft: Draft) -> None:
    """Write routes and samples of a draft into a state; the arrays derived from them are left for later."""
    state.pos[:] = -1
    for r, route in enumerate(draft.routes):
        state.length[r] = len(route)
        state.route[r, : len(route)] = route
        state.pos[r, route[:-1]] = np.arange(len(route) - 1)
    state.size[0] = len(draft.samples)
    for row, sample in zip(state.samples, draft.samples, strict=False):
        hops = [entry for hop in sample.hops for entry in hop]
        row[:FIRST_HOP] = sample.kind, sample.node, sample.robot, sample.stock, len(sample.hops)
        row[FIRST_HOP : FIRST_HOP + len(hops)] = hops


def unloaded(problem: Problem, state: State) -> Draft:
    """Return the plan of a state as a draft."""
    routes = [[int(v) for v in row[:k]] for row, k in zip(state.route, state.length, strict=True)]
    samples = []
    for row in state.samples[: state.size[0]].tolist():
        hops = row[FIRST_HOP : FIRST_HOP + 2 * row[HOPS]]
        samples.append(
            Sample(
                row[KIND], row[NODE], row[ROBOT], tuple(zip(hops[::2], hops[1::2], strict=True)), row[PILE]
            )
        )
    return Draft(problem, routes, samples)


def _way_home(problem: Problem, r: int, v: int, barred: set[int]) -> tuple[float, int]:
    """Return the cheapest way from v to a depot that is not barred, and the depot; infinity without one."""
    robot = problem.robots[r]
    ways = [(robot.closure.rows[v][d], d) for d in robot.depots if d not in barred]
    return min(ways, default=(np.inf, v))


def _mask(sets: list[tuple[int, ...]], n: int) -> BoolArray:
    mask = np.zeros((len(sets), n), dtype=np.bool_)
    for row, members in zip(mask, sets, strict=True):
        row[list(members)] = True
    return mask


def _handoffs(problem: Problem) -> BoolArray:
    team, n = range(len(problem.robots)), len(problem.nodes)
    mask = np.zeros((len(team), len(team), n), dtype=np.bool_)
    for r in team:
        for o in team:
            if r != o:
                mask[r, o, problem.shared(r, o)] = True
    return mask
