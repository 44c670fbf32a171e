"""Compiled search for a way home over several drops, the same robots any number of times.

Where `insertion` finds no simple way for a sample, one that is handed back and forth may still fit: a
robot that is short of energy gives it to a partner for a part of its route, and gets it back. A *label*
(drops so far, robot o, node w) is the cheapest chain known by which o has the sample when it leaves w. Labels
of one more drop follow from those of one less, so a chain is found by as many passes as it has drops. Stops
are new or those there are. Several new stops on one leg of a robot follow each other.

What each robot spends on the chain, its room on every leg and the order of all drops are kept exactly, so
every chain found can be put in. As only the cheapest chain of a label is kept, one may be overlooked.
"""

from __future__ import annotations

import numpy as np

from malipp_field.planner.draft import ON_BOARD, STOCK
from malipp_field.planner.kernels import compiled
from malipp_field.planner.search.routes import copy_of, may_pass, onward, places_of, stop_energy_j
from malipp_field.planner.search.state import (
    MOST_DROPS,
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

PICK_AT, GIVER, SLOT, DROP_AT, SINCE, START = range(6)
"""Columns of a label's trail: before which stop the sample comes on board; who dropped it (-1: it is taken
there), where that robot had it from (-1: it took it there), before which stop it drops it, and which of its
stops is over by then; before which stop of its first robot it was taken."""
COST, SPENT_J, HOME, GIVEN_J = range(4)
"""Columns of a label's figures: cost and energy of o's part in the chain on leaving; the cost if o brings the
sample home; the energy of the giver's part."""


@compiled
def find_chain(case: Case, state: State, scratch: Scratch, r: int, v: int, limit: float) -> float:
    """Find a cheap way home of ``scratch.sample`` if robot r takes it at v, into ``scratch.way``.

    Returns its cost, or ``limit`` where none is found that is cheaper.
    """
    team, nodes = range(len(state.length)), range(len(case.candidate))
    for drops in range(MOST_DROPS):
        for o in team:
            for w in nodes:
                scratch.labels[drops, o, w, HOME] = np.inf
    first, last = places_of(case, state, r, v)
    for i in range(first, last + 1):
        limit = _take(case, state, scratch, r, v, i, limit)
    for drops in range(1, MOST_DROPS):
        for o in team:
            for w in nodes:
                if scratch.labels[drops, o, w, HOME] < np.inf and scratch.labels[drops, o, w, COST] < limit:
                    limit = _follow(case, state, scratch, drops, o, w, limit)
    return limit


@compiled
def _take(case: Case, state: State, scratch: Scratch, r: int, v: int, i: int, limit: float) -> float:
    """Improve on ``limit`` by ways that begin with robot r at v, stop i or new stop i, and label them."""
    new, kind = state.pos[r, v] < 0, scratch.sample[0]
    spent_j = stop_energy_j(case, state, r, i, v) if new else 0.0
    if not state.energy_j[r] + spent_j <= case.budget_j[r] or (new and not may_pass(case, state, r, i, v)):
        return limit
    held = state.depart[r, i - 1] if new else state.arrive[r, i]
    if (kind != STOCK and held >= case.capacity[r]) or (kind == ON_BOARD and case.depot[r, v]):
        return limit
    cost, before = spent_j * scratch.weight[r], i - 1 if new else i
    scratch.trail[START] = i
    if kind != STOCK and not case.depot[r, v]:
        limit = _hand_over(case, state, scratch, 0, r, -1, v, i, before, cost, spent_j, limit)
    trail = scratch.trail
    trail[GIVER], trail[SLOT], trail[DROP_AT], trail[SINCE] = -1, -1, -1, -1
    if state.depart[r, before] < case.capacity[r]:
        scratch.labels[0, r, v, HOME] = np.inf
        _keep(scratch, 0, r, v, i, cost, spent_j, 0.0)
        limit = _follow(case, state, scratch, 0, r, v, limit)
    return limit


@compiled
def _leg(case: Case, state: State, o: int, k: int, here: int) -> float:
    """Return alpha to stop k from the stop before it or from a new one between."""
    if here == state.route[o, k - 1]:
        return float(state.cum[o, k] - state.cum[o, k - 1])
    return onward(case, state, o, k, here)


@compiled
def _follow(case: Case, state: State, scratch: Scratch, drops: int, o: int, v: int, limit: float) -> float:
    """Improve on ``limit`` by one more drop after a label; make labels of what may go on from there."""
    figures, k = scratch.labels[drops, o, v], scratch.trails[drops, o, v, PICK_AT]
    cost, spent_j, here = figures[COST], figures[SPENT_J], v
    kg, weight, last = case.sample_mass_kg, scratch.weight[o], state.length[o] - 1
    scratch.trail[START] = scratch.trails[drops, o, v, START]
    left_j = case.budget_j[o] - state.energy_j[o]
    if state.pos[o, v] >= 0:
        k += 1
    while state.depart[o, k - 1] < case.capacity[o]:
        leg = _leg(case, state, o, k, here)
        mass_kg = case.mass_kg[o] + kg * state.depart[o, k - 1]
        for w in range(len(case.candidate)):
            if not scratch.hub[w] or not case.place[o, w] or case.depot[o, w] or state.pos[o, w] >= 0:
                continue
            there = case.cost[o, here, w]
            more_j = (there + onward(case, state, o, k, w) - leg) * mass_kg + kg * there
            fits = spent_j + more_j <= left_j and cost + more_j * weight < limit
            if fits and not _was_at(scratch, drops, o, v, o, w):
                limit = _hand_over(
                    case, state, scratch, drops, o, v, w, k, k - 1,
                    cost + more_j * weight, spent_j + more_j, limit,
                )  # fmt: skip
        spent_j, cost, here = spent_j + kg * leg, cost + kg * leg * weight, state.route[o, k]
        if k == last or case.depot[o, here] or state.arrive[o, k] >= case.capacity[o]:
            break
        if not (spent_j <= left_j and cost < limit):
            break
        limit = _hand_over(case, state, scratch, drops, o, v, here, k, k, cost, spent_j, limit)
        k += 1
    return limit


@compiled
def _hand_over(
    case: Case,
    state: State,
    scratch: Scratch,
    drops: int,
    o: int,
    v: int,
    w: int,
    drop_at: int,
    since: int,
    cost: float,
    spent_j: float,
    limit: float,
) -> float:
    """Improve on ``limit`` by a drop of what o has from v at w, before stop ``drop_at``, after ``since``."""
    trail = scratch.trail
    trail[GIVER], trail[SLOT], trail[DROP_AT], trail[SINCE] = o, v, drop_at, since
    scratch.given[0] = spent_j
    for p in range(len(state.length)):
        if not case.handoff[o, p, w]:
            continue
        after, own_j, base_at, base = _look_back(state, scratch, drops, o, v, p)
        after = max(after, state.clock[o, since, p])
        first, last = places_of(case, state, p, w)
        new = state.pos[p, w] < 0
        if new and (case.depot[p, w] or _was_at(scratch, drops, o, v, p, w)):
            continue
        for q in range(max(first, after + 1), last + 1):
            if state.depart[p, q - 1 if new else q] >= case.capacity[p]:
                continue
            more_j = 0.0
            if new:
                here = base if q == base_at else state.route[p, q - 1]
                way = case.cost[p, here, w] + onward(case, state, p, q, w) - _leg(case, state, p, q, here)
                more_j = way * (case.mass_kg[p] + case.sample_mass_kg * state.depart[p, q - 1])
            there = cost + more_j * scratch.weight[p]
            if not (there < limit and state.energy_j[p] + own_j + more_j <= case.budget_j[p]):
                continue
            home_j = _home_j(case, state, p, w, q)
            home = there + home_j * scratch.weight[p]
            fits = state.energy_j[p] + own_j + more_j + home_j <= case.budget_j[p]
            if home < limit and fits and state.peak[p, q - 1 if new else q] < case.capacity[p]:
                limit = home
                _write(scratch, drops, p, w, q)
            if drops + 1 < MOST_DROPS:
                _keep(scratch, drops + 1, p, w, q, there, own_j + more_j, home)
    return limit


@compiled
def _home_j(case: Case, state: State, o: int, w: int, k: int) -> float:
    """Return the energy it takes o to bring home what it has from w, stop k or new stop k."""
    before, way = k, 0.0
    if state.pos[o, w] < 0:
        before, way = k - 1, onward(case, state, o, k, w)
    return float(case.sample_mass_kg * (way + state.cum[o, state.unload[o, before]] - state.cum[o, k]))


@compiled
def _keep(
    scratch: Scratch, drops: int, o: int, w: int, pick_at: int, cost: float, spent_j: float, home: float
) -> None:
    """Make a label of a chain if it is the cheapest; what is in ``scratch.trail`` of the giver is noted."""
    figures = scratch.labels[drops, o, w]
    if home < figures[HOME]:
        figures[COST], figures[SPENT_J], figures[HOME] = cost, spent_j, home
        figures[GIVEN_J] = scratch.given[0]
        scratch.trail[PICK_AT] = pick_at
        copy_of(scratch.trails[drops, o, w], scratch.trail)


@compiled
def _look_back(
    state: State, scratch: Scratch, drops: int, o: int, v: int, p: int
) -> tuple[int, float, int, int]:
    """Return what a label's chain has for robot p: stop that must be over, energy, and its last new drop.

    Of that drop the stop before which it is and its node; -1 where p's last drop is no new stop.
    """
    after, own_j, base_at, base, met = -1, 0.0, -1, -1, False
    while v >= 0 and scratch.trails[drops, o, v, GIVER] >= 0:
        trail = scratch.trails[drops, o, v]
        giver = trail[GIVER]
        after = max(after, state.clock[giver, trail[SINCE], p])
        if giver == p and not met:
            met, own_j = True, scratch.labels[drops, o, v, GIVEN_J]
            if state.pos[p, v] < 0:
                base_at, base = trail[DROP_AT], v
        drops, o, v = drops - 1, giver, trail[SLOT]
    return after, own_j, base_at, base


@compiled
def _was_at(scratch: Scratch, drops: int, o: int, v: int, p: int, w: int) -> bool:
    """Tell whether a label's chain has a stop of robot p at w already."""
    while v >= 0:
        giver = scratch.trails[drops, o, v, GIVER]
        if v == w and (p in (o, giver)):
            return True
        drops, o, v = drops - 1, giver, scratch.trails[drops, o, v, SLOT]
    return False


@compiled
def _write(scratch: Scratch, drops: int, p: int, w: int, pick_at: int) -> None:
    """Write into ``scratch.way`` the chain that ends as ``scratch.trail`` notes: with a drop at w for p."""
    way, trail = scratch.way, scratch.trail
    way[W_DROPS], way[W_AT] = drops + 1, trail[START]
    for h in range(drops, -1, -1):
        at = W_FIRST + W_WIDTH * h
        giver, slot = trail[GIVER], trail[SLOT]
        way[at], way[at + 1], way[at + 2], way[at + 3] = w, trail[DROP_AT], p, pick_at
        way[W_ROBOT], way[W_NODE] = giver, slot if slot >= 0 else w
        if slot < 0:
            return
        trail, p, w = scratch.trails[h, giver, slot], giver, slot
        pick_at = trail[PICK_AT]
