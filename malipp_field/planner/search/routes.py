"""Compiled bookkeeping of the search: routes, custody, loads, energies, the order of drops, and J.

All functions change a `State` in place. What follows from routes and samples is derived by `derive` (one
robot) and `order` (the team).
"""

from __future__ import annotations

import numpy as np

from malipp_field.planner.draft import COLLECTED, ON_BOARD
from malipp_field.planner.kernels import compiled
from malipp_field.planner.search.state import FIRST_HOP, HOPS, KIND, NODE, ROBOT, Case, Scratch, State


@compiled
def uniform(scratch: Scratch) -> float:
    """Return a random number in [0, 1), by SplitMix64: the same on every machine, wherever a run is split."""
    scratch.rng[0] += np.uint64(0x9E3779B97F4A7C15)
    z = scratch.rng[0]
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    z ^= z >> np.uint64(31)
    return float(z >> np.uint64(11)) / 9007199254740992.0


@compiled
def below(scratch: Scratch, n: int) -> int:
    """Return a random whole number from 0 to n - 1."""
    return int(uniform(scratch) * n)


@compiled
def copy_of(to: np.ndarray, source: np.ndarray) -> None:
    """Copy one row; a plain loop, which compiles far quicker than a slice."""
    for i in range(len(source)):
        to[i] = source[i]


@compiled
def copy_rows(to: np.ndarray, source: np.ndarray, rows: int) -> None:
    """Copy the first rows of a table."""
    for i in range(rows):
        for j in range(source.shape[1]):
            to[i, j] = source[i, j]


@compiled
def copy(to: State, source: State) -> None:
    """Copy all that `derive`, `order` and `find_falls` do not find again."""
    robots = len(source.length)
    copy_rows(to.route, source.route, robots)
    copy_rows(to.pos, source.pos, robots)
    copy_rows(to.collect, source.collect, robots)
    copy_rows(to.give, source.give, robots)
    copy_rows(to.take, source.take, robots)
    for r in range(robots):
        copy_rows(to.pair[r], source.pair[r], robots)
    copy_rows(to.samples, source.samples, source.size[0])
    copy_of(to.size, source.size)
    copy_of(to.length, source.length)
    copy_of(to.board, source.board)
    copy_of(to.energy_j, source.energy_j)
    copy_of(to.value, source.value)
    copy_rows(to.c_vv, source.c_vv, len(source.c_vv))
    copy_rows(to.c_vt, source.c_vt, len(source.c_vt))


@compiled
def derive(case: Case, state: State, r: int) -> bool:
    """Follow a robot along its route; return False where custody, capacity or budget are broken.

    A depot before its own terminal copy, which no leg joins, is let pass while a plan is in the making.
    """
    last, capacity = state.length[r] - 1, case.capacity[r]
    before = state.route[r, 0]
    load, energy_j = state.board[r], 0.0
    for i in range(last + 1):
        v = state.route[r, i]
        if i > 0:
            leg = case.cost[r, before, v]
            energy_j += leg * (case.mass_kg[r] + case.sample_mass_kg * load)
            state.cum[r, i] = state.cum[r, i - 1] + leg
        before = v
        if i == last:
            break
        load += state.collect[r, v]
        given = state.give[r, v]
        if given > load or given > capacity:
            return False
        state.arrive[r, i] = load
        if case.depot[r, v]:
            state.arrive[r, i] = load - given
            load = given  # all that is not handed over is unloaded
        if state.arrive[r, i] > capacity:
            return False
        load += state.take[r, v] - given
        if load > capacity:
            return False
        state.depart[r, i] = load
    state.arrive[r, last] = load
    state.energy_j[r] = energy_j
    _look_ahead(case, state, r)
    return bool(energy_j <= case.budget_j[r])


@compiled
def _look_ahead(case: Case, state: State, r: int) -> None:
    """Find the next unloading, and the most samples held until then, for every stop."""
    last = state.length[r] - 1
    unload = last
    for i in range(last - 1, -1, -1):
        peak = max(state.depart[r, i], state.arrive[r, i + 1])
        if i + 1 < unload:
            peak = max(peak, state.peak[r, i + 1])
        state.unload[r, i] = unload
        state.peak[r, i] = peak
        if case.depot[r, state.route[r, i]]:
            unload = i


@compiled
def derive_team(case: Case, state: State) -> bool:
    """Derive all robots and the order of their stops; return whether every rule is kept."""
    for r in range(len(state.length)):
        if not derive(case, state, r):
            return False
    return order(state)


@compiled
def order(state: State) -> bool:
    """Find the clocks of all stops; return False where drops wait for each other in a circle."""
    robots = len(state.length)
    done = np.zeros(robots, dtype=np.int64)
    moved = True
    while moved:
        moved = False
        for r in range(robots):
            while done[r] < state.length[r] - 1 and _after_its_drops(state, r, done[r], done):
                done[r] += 1
                moved = True
    left = 0
    for r in range(robots):
        left += state.length[r] - 1 - done[r]
    return left == 0


@compiled
def _after_its_drops(state: State, r: int, k: int, done: np.ndarray) -> bool:
    """Set the clock of stop k if all drops it picks up come before; return whether they do."""
    v, robots = state.route[r, k], len(state.length)
    if state.take[r, v] > 0:
        for s in range(robots):
            if state.pair[s, r, v] > 0 and state.pos[s, v] >= done[s]:
                return False
    for q in range(robots):
        state.clock[r, k, q] = state.clock[r, k - 1, q] if k > 0 else -1
    if state.take[r, v] > 0:
        for s in range(robots):
            if state.pair[s, r, v] > 0:
                for q in range(robots):
                    state.clock[r, k, q] = max(state.clock[r, k, q], state.clock[s, state.pos[s, v], q])
    state.clock[r, k, r] = k
    return True


# samples


@compiled
def count(state: State, row: np.ndarray, change: int) -> None:
    """Count a sample in (1) or out (-1) at its stops."""
    holder = row[ROBOT]
    if row[KIND] == COLLECTED:
        state.collect[holder, row[NODE]] += change
    elif row[KIND] == ON_BOARD:
        state.board[holder] += change
    else:
        state.take[holder, row[NODE]] += change
    for h in range(row[HOPS]):
        node, receiver = row[FIRST_HOP + 2 * h], row[FIRST_HOP + 2 * h + 1]
        state.give[holder, node] += change
        state.take[receiver, node] += change
        state.pair[holder, receiver, node] += change
        holder = receiver


@compiled
def count_all(case: Case, state: State) -> None:
    """Count every sample anew, beside what is fixed, and J."""
    for r in range(len(state.length)):
        state.board[r] = case.fixed_board[r]
        copy_of(state.collect[r], case.fixed_collect[r])
        copy_of(state.give[r], case.fixed_give[r])
        copy_of(state.take[r], case.fixed_take[r])
        for v in range(len(case.candidate)):
            for o in range(len(state.length)):
                state.pair[o, r, v] = 0
    for s in range(state.size[0]):
        count(state, state.samples[s], 1)
    learn_all(case, state)


@compiled
def remove(state: State, s: int) -> None:
    """Take sample s out; the last one takes its number."""
    count(state, state.samples[s], -1)
    state.size[0] -= 1
    copy_of(state.samples[s], state.samples[state.size[0]])


@compiled
def cut_at_depots(case: Case, state: State) -> None:
    """End the way of every sample at the first depot its robot passes: there it is unloaded."""
    for s in range(state.size[0]):
        row = state.samples[s]
        holder, node = row[ROBOT], row[NODE]
        since = 0 if row[KIND] == ON_BOARD else state.pos[holder, node]
        if row[KIND] > ON_BOARD:
            since += 1
        for h in range(row[HOPS]):
            drop = state.pos[holder, row[FIRST_HOP + 2 * h]]
            home = False
            for i in range(since, drop):
                home = home or case.depot[holder, state.route[holder, i]]
            if home:
                row[HOPS] = h
                break
            holder = row[FIRST_HOP + 2 * h + 1]
            since = state.pos[holder, row[FIRST_HOP + 2 * h]] + 1


# stops


@compiled
def insert_stop(case: Case, state: State, r: int, i: int, v: int) -> None:
    """Make node v stop i of a robot; a new last stop changes the terminal."""
    for k in range(state.length[r], i, -1):
        state.route[r, k] = state.route[r, k - 1]
    state.route[r, i] = v
    state.length[r] += 1
    last = state.length[r] - 1
    if i == last - 1:
        state.route[r, last] = case.terminal[r, v]
    for k in range(i, last):
        state.pos[r, state.route[r, k]] = k


@compiled
def remove_stop(case: Case, state: State, r: int, i: int) -> None:
    """Leave out stop i, which is not the start."""
    state.pos[r, state.route[r, i]] = -1
    state.length[r] -= 1
    for k in range(i, state.length[r]):
        state.route[r, k] = state.route[r, k + 1]
    for k in range(i, state.length[r] - 1):
        state.pos[r, state.route[r, k]] = k
    set_terminal(case, state, r)


@compiled
def set_terminal(case: Case, state: State, r: int) -> None:
    """End at the depot nearest to the last stop."""
    last = state.length[r] - 1
    v = state.route[r, last - 1]
    state.route[r, last] = case.terminal_at_once[r] if last == 1 else case.terminal[r, v]


@compiled
def tidy(case: Case, state: State, r: int) -> None:
    """Leave out stops at which nothing happens, as `Draft.tidy` does."""
    load, i = state.board[r], 0
    while i < state.length[r] - 1:
        v = state.route[r, i]
        at_depot = case.depot[r, v]
        handled = state.give[r, v] + state.take[r, v]
        if i > 0 and handled + state.collect[r, v] == 0 and not (at_depot and load > 0):
            remove_stop(case, state, r, i)
            continue
        load += state.collect[r, v] - state.give[r, v]
        load = state.take[r, v] + (0 if at_depot else load)
        i += 1
    while state.length[r] > 2:
        i = state.length[r] - 2
        v = state.route[r, i]
        if not case.depot[r, v] or state.give[r, v] + state.take[r, v] > 0:
            break
        remove_stop(case, state, r, i)
    set_terminal(case, state, r)


# where a stop can be, and what it takes


@compiled
def places_of(case: Case, state: State, r: int, v: int) -> tuple[int, int]:
    """Return the first and the last index at which a robot can stop at a node: its stop, or a new one."""
    if not case.place[r, v]:
        return 1, 0
    at = state.pos[r, v]
    return (at, at) if at >= 0 else (1, state.length[r] - 1)


@compiled
def onward(case: Case, state: State, r: int, i: int, v: int) -> float:
    """Return alpha from v as a new stop i to the stop after it."""
    if i == state.length[r] - 1:
        return float(case.home[r, v])
    return float(case.cost[r, v, state.route[r, i]])


@compiled
def stop_energy_j(case: Case, state: State, r: int, i: int, v: int) -> float:
    """Return the energy of a new stop i at v with what is on board there."""
    before, after = state.route[r, i - 1], state.route[r, i]
    alpha = case.cost[r, before, v] + onward(case, state, r, i, v) - case.cost[r, before, after]
    return float(alpha * (case.mass_kg[r] + case.sample_mass_kg * state.depart[r, i - 1]))


@compiled
def may_pass(case: Case, state: State, r: int, i: int, v: int) -> bool:
    """Tell whether v may be new stop i: what is unloaded at a depot must not have to be dropped later."""
    return not case.depot[r, v] or may_unload(state, r, i)


@compiled
def may_unload(state: State, r: int, i: int) -> bool:
    """Tell whether nothing on board before stop i is to be dropped before it is unloaded anyhow."""
    k, end = i, state.unload[r, i - 1]
    while k < end and state.give[r, state.route[r, k]] <= 0:
        k += 1
    return bool(k >= end)


# information


@compiled
def learn(case: Case, state: State, v: int, precision: float) -> None:
    """Change J and the covariances by more precision at candidate v, or less: an update of rank one."""
    c_vv, c_vt, weights = state.c_vv, state.c_vt, case.weights  # by name, so that loops become vector code
    fall = 0.0
    for t in range(len(weights)):
        fall += weights[t] * c_vt[v, t] ** 2
    gain = precision / (1.0 + precision * max(c_vv[v, v], 0.0))
    state.value[0] -= gain * fall
    row_v, row_t = c_vv[v].copy(), c_vt[v].copy()
    for u in range(len(row_v)):
        share = gain * row_v[u]
        for w in range(len(row_v)):
            c_vv[u, w] -= share * row_v[w]
        for t in range(len(row_t)):
            c_vt[u, t] -= share * row_t[t]


@compiled
def learn_all(case: Case, state: State) -> None:
    """Find J and the covariances from the prior: only additions, free of the errors that build up."""
    copy_rows(state.c_vv, case.k_vv, len(case.k_vv))
    copy_rows(state.c_vt, case.k_vt, len(case.k_vt))
    state.value[0] = case.prior
    for node in range(len(case.candidate)):
        precision = 0.0
        for r in range(len(case.precision)):
            precision += state.collect[r, node] * case.precision[r]
        if precision > 0.0:
            learn(case, state, case.candidate[node], precision)


@compiled
def find_falls(case: Case, state: State) -> None:
    """Find -dJ/dp at every candidate (eq:generic_llse2)."""
    c_vt, weights = state.c_vt, case.weights
    for v in range(len(c_vt)):
        fall = 0.0
        for t in range(len(weights)):
            fall += weights[t] * c_vt[v, t] ** 2
        state.fall[v] = fall
