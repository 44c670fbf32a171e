"""Compiled search for the cheapest way home of one more sample, and its insertion.

A way is: brought home by the robot that takes it; or dropped where it was taken, at a later stop or at a new
one, for the robot that fetches it at least cost, by passing or by a detour. `chain` finds longer ones.
All tests of energy, room and order take constant time on what `derive` and `order` have found.
"""

from __future__ import annotations

import numpy as np

from malipp_field.planner.draft import COLLECTED, ON_BOARD, STOCK
from malipp_field.planner.kernels import compiled
from malipp_field.planner.search.routes import (
    count,
    derive,
    insert_stop,
    learn,
    may_pass,
    may_unload,
    onward,
    order,
    places_of,
    stop_energy_j,
    uniform,
)
from malipp_field.planner.search.state import (
    FIRST_HOP,
    HOPS,
    KIND,
    NODE,
    PILE,
    ROBOT,
    W_AT,
    W_DROPS,
    W_FIRST,
    W_NODE,
    W_ROBOT,
    W_WIDTH,
    Case,
    Scratch,
    State,
)


@compiled
def find_costs(case: Case, state: State, scratch: Scratch) -> None:
    """Fill the tables of what fetching costs at least, whatever the order of stops.

    Only robots marked as changed are looked at: what fetching costs one hangs on its own route alone.
    """
    for o in range(len(state.length)):
        if scratch.changed[o]:
            _tabulate(case, state, scratch, o)
            scratch.changed[o] = False
    _find_least(case, scratch)


@compiled
def _tabulate(case: Case, state: State, scratch: Scratch, o: int) -> None:
    """Find what it costs robot o at least to stop at each node, and to fetch one sample there."""
    detour, fetch, last = scratch.detour[o], scratch.fetch[o], state.length[o] - 1
    for w in range(len(fetch)):
        detour[w], fetch[w] = np.inf, np.inf
    for k in range(1, last + 1):
        _pass_between(case, state, o, k, detour, fetch)
    for k in range(last):
        v = state.route[o, k]
        detour[v], fetch[v] = 0.0, np.inf
        if state.peak[o, k] < case.capacity[o]:
            fetch[v] = case.sample_mass_kg * (state.cum[o, state.unload[o, k]] - state.cum[o, k])
    left_j = case.budget_j[o] - state.energy_j[o]
    for w in range(len(fetch)):
        possible = case.place[o, w]
        detour[w] = detour[w] * scratch.weight[o] if possible and detour[w] <= left_j else np.inf
        fetch[w] = fetch[w] * scratch.weight[o] if possible and fetch[w] <= left_j else np.inf


@compiled
def _pass_between(case: Case, state: State, o: int, k: int, detour: np.ndarray, fetch: np.ndarray) -> None:
    """Lower what stopping and fetching cost, in joules, where a new stop k is cheaper."""
    before, after = state.route[o, k - 1], state.route[o, k]
    there, onward = case.cost[o, before], case.back[o, after]
    if k == state.length[o] - 1:
        onward = case.home[o]
    sample_kg, leg = case.sample_mass_kg, there[after]
    mass_kg = case.mass_kg[o] + sample_kg * state.depart[o, k - 1]
    rest = state.cum[o, state.unload[o, k - 1]] - state.cum[o, k]
    room, no_depots = state.peak[o, k - 1] < case.capacity[o], not may_unload(state, o, k)
    for w in range(len(fetch)):
        energy_j = (there[w] + onward[w] - leg) * mass_kg
        if not energy_j < np.inf or (no_depots and case.depot[o, w]):
            continue
        detour[w] = min(detour[w], energy_j)
        if room:
            fetch[w] = min(fetch[w], energy_j + sample_kg * (onward[w] + rest))


@compiled
def _find_least(case: Case, scratch: Scratch) -> None:
    robots, n = case.place.shape
    for r in range(robots):
        least = scratch.least[r]
        for w in range(n):
            least[w] = np.inf
        for o in range(robots):
            handoff, fetch = case.handoff[r, o], scratch.fetch[o]
            for w in range(n):
                if handoff[w] and fetch[w] < least[w]:
                    least[w] = fetch[w]
        scratch.lowest[r] = np.inf
        for w in range(n):
            scratch.lowest[r] = min(scratch.lowest[r], least[w])


@compiled
def _fetch_cost(case: Case, state: State, scratch: Scratch, o: int, k: int, w: int) -> float:
    """Return what it costs robot o to take one sample at w, stop k or new stop k, to its next unloading."""
    if state.pos[o, w] >= 0:
        if state.peak[o, k] >= case.capacity[o]:
            return np.inf
        energy_j = case.sample_mass_kg * (state.cum[o, state.unload[o, k]] - state.cum[o, k])
    else:
        if state.peak[o, k - 1] >= case.capacity[o] or not may_pass(case, state, o, k, w):
            return np.inf
        rest = state.cum[o, state.unload[o, k - 1]] - state.cum[o, k]
        energy_j = stop_energy_j(case, state, o, k, w)
        energy_j += case.sample_mass_kg * (onward(case, state, o, k, w) + rest)
    if state.energy_j[o] + energy_j <= case.budget_j[o]:
        return float(energy_j * scratch.weight[o])
    return np.inf


@compiled
def _carrier(case: Case, state: State, scratch: Scratch, r: int, since: int, w: int, limit: float) -> float:
    """Find who fetches best what robot r drops at w, when its stop ``since`` is over; return the cost.

    Returns ``limit`` where nobody is cheaper; else the way's part from ``W_DROPS`` on is written, but for
    the drop itself.
    """
    for o in range(len(state.length)):
        if not case.handoff[r, o, w] or scratch.fetch[o, w] >= limit:
            continue
        first, last = places_of(case, state, o, w)
        for k in range(max(first, state.clock[r, since, o] + 1), last + 1):
            cost = _fetch_cost(case, state, scratch, o, k, w)
            if cost < limit:
                limit = cost
                scratch.way[W_DROPS], scratch.way[W_FIRST + 2], scratch.way[W_FIRST + 3] = 1, o, k
    return limit


@compiled
def find_way(
    case: Case,
    state: State,
    scratch: Scratch,
    r: int,
    v: int,
    limit: float,
) -> float:
    """Find the cheapest way home of ``scratch.sample`` if robot r takes it at v, into ``scratch.way``.

    Returns its cost (energy weighted by ``scratch.weight``), or ``limit`` where none is cheaper. Places
    are overlooked with probability ``scratch.blink``.
    """
    first, last = places_of(case, state, r, v)
    for i in range(first, last + 1):
        if uniform(scratch) < scratch.blink[0]:
            continue
        limit = _ways_from(case, state, scratch, r, v, i, limit)
    return limit


@compiled
def _ways_from(
    case: Case,
    state: State,
    scratch: Scratch,
    r: int,
    v: int,
    i: int,
    limit: float,
) -> float:
    """Improve on ``limit`` by ways that begin at stop i, or at a new stop i."""
    new, kind = state.pos[r, v] < 0, scratch.sample[0]
    detour_j = stop_energy_j(case, state, r, i, v) if new else 0.0
    held = state.depart[r, i - 1] if new else state.arrive[r, i]
    cheap = detour_j * scratch.weight[r] < limit and state.energy_j[r] + detour_j <= case.budget_j[r]
    if not cheap or (new and not may_pass(case, state, r, i, v)):
        return limit
    if kind != STOCK and held >= case.capacity[r]:
        return limit
    before = i - 1 if new else i
    way = onward(case, state, r, i, v) if new else 0.0
    home_j = detour_j + case.sample_mass_kg * (way + state.cum[r, state.unload[r, before]] - state.cum[r, i])
    room = state.peak[r, before] < case.capacity[r]
    if kind == ON_BOARD and case.depot[r, v]:
        home_j, room = 0.0, True  # it is unloaded before anything else happens
    home = home_j * scratch.weight[r] + scratch.shy[r]
    if room and home < limit and state.energy_j[r] + home_j <= case.budget_j[r]:
        limit = home
        _note(scratch, r, v, i, 0, 0)
        scratch.way[W_DROPS] = 0
    if (case.depot[r, v] and kind != STOCK) or detour_j * scratch.weight[r] + scratch.lowest[r] >= limit:
        return limit
    if kind != STOCK:
        limit = _with_drop(case, state, scratch, r, v, i, v, i, before, detour_j, limit)
    return _ways_with_drop(case, state, scratch, r, v, i, detour_j, limit)


@compiled
def _note(scratch: Scratch, r: int, v: int, i: int, w: int, j: int) -> None:
    scratch.way[W_ROBOT], scratch.way[W_NODE], scratch.way[W_AT] = r, v, i
    scratch.way[W_FIRST], scratch.way[W_FIRST + 1] = w, j


@compiled
def _with_drop(
    case: Case,
    state: State,
    scratch: Scratch,
    r: int,
    v: int,
    i: int,
    w: int,
    j: int,
    since: int,
    energy_j: float,
    limit: float,
) -> float:
    """Improve on ``limit`` by a drop at w, stop j or new stop j, to which robot r needs so much energy."""
    own = float(energy_j * scratch.weight[r])
    if own + scratch.least[r, w] >= limit or not (state.energy_j[r] + energy_j <= case.budget_j[r]):
        return limit
    rest = _carrier(case, state, scratch, r, since, w, limit - own)
    if rest < limit - own:
        _note(scratch, r, v, i, w, j)
        return own + rest
    return limit


@compiled
def _ways_with_drop(
    case: Case,
    state: State,
    scratch: Scratch,
    r: int,
    v: int,
    i: int,
    detour_j: float,
    limit: float,
) -> float:
    """Improve on ``limit`` by drops at later stops of robot r and at new ones between them."""
    new = state.pos[r, v] < 0
    before = i - 1 if new else i
    m = before + 1
    here, driven = v, 0.0  # the stop before m, and alpha to it from where the sample is taken
    leg = onward(case, state, r, i, v) if new else state.cum[r, m] - state.cum[r, i]
    while state.depart[r, m - 1] < case.capacity[r]:
        limit = _new_drops(case, state, scratch, r, v, i, m, here, leg, driven, detour_j, limit)
        if m >= state.unload[r, before] or state.arrive[r, m] >= case.capacity[r]:
            break
        driven += leg
        here = state.route[r, m]
        more_j = detour_j + case.sample_mass_kg * driven
        limit = _with_drop(case, state, scratch, r, v, i, here, m, m, more_j, limit)
        m += 1
        leg = state.cum[r, m] - state.cum[r, m - 1]
    return limit


@compiled
def _new_drops(
    case: Case,
    state: State,
    scratch: Scratch,
    r: int,
    v: int,
    i: int,
    m: int,
    here: int,
    leg: float,
    driven: float,
    detour_j: float,
    limit: float,
) -> float:
    """Improve on ``limit`` by drops at a new stop on the leg from ``here`` to stop m."""
    mass_kg = case.mass_kg[r] + case.sample_mass_kg * state.depart[r, m - 1]
    own = detour_j * scratch.weight[r]
    for w in range(len(case.candidate)):
        if own + scratch.least[r, w] >= limit or not scratch.hub[w] or not case.place[r, w]:
            continue
        if state.pos[r, w] >= 0 or w == v or case.depot[r, w]:
            continue
        there = case.cost[r, here, w]
        energy_j = detour_j + (there + onward(case, state, r, m, w) - leg) * mass_kg
        energy_j += case.sample_mass_kg * (driven + there)
        limit = _with_drop(case, state, scratch, r, v, i, w, m, m - 1, energy_j, limit)
    return limit


@compiled
def insert(case: Case, state: State, scratch: Scratch) -> bool:
    """Put in ``scratch.sample`` by the way ``scratch.best``; return False where that breaks a rule."""
    way, kind = scratch.best, scratch.sample[0]
    r, v, drops = way[W_ROBOT], way[W_NODE], way[W_DROPS]
    row = state.samples[state.size[0]]
    state.size[0] += 1
    row[KIND], row[NODE], row[ROBOT], row[PILE], row[HOPS] = kind, v, r, scratch.sample[3], drops
    for h in range(drops - 1, -1, -1):  # from the last stop to the first, so that indices stay what they are
        at = W_FIRST + W_WIDTH * h
        w, receiver, giver = way[at], way[at + 2], way[at - 2] if h > 0 else r
        row[FIRST_HOP + 2 * h], row[FIRST_HOP + 2 * h + 1] = w, receiver
        if state.pos[receiver, w] < 0:
            insert_stop(case, state, receiver, way[at + 3], w)
        if state.pos[giver, w] < 0:
            insert_stop(case, state, giver, way[at + 1], w)
    if state.pos[r, v] < 0:
        insert_stop(case, state, r, way[W_AT], v)
    count(state, row, 1)
    if kind == COLLECTED:
        learn(case, state, case.candidate[v], case.precision[r])
    good = derive(case, state, r)
    scratch.changed[r] = True
    for h in range(drops):
        receiver = row[FIRST_HOP + 2 * h + 1]
        scratch.changed[receiver] = True
        good = good and derive(case, state, receiver)
    return good and order(state)
