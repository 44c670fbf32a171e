"""Compiled labelling over one robot's schedules: the pricing and the enumeration of `schedules`.

A label is a partial schedule: where the robot is, its load, the energy spent, the value gathered and the
places visited. What is spent may count against the value: an actor has a toll, zero for J, where energy only
has to suffice. Operations at a place are coded ``a * (2 K + 1) + h + K``: a samples taken, h the net exchange
(picked less dropped) with K the capacity; the code K is idleness. Place 0 is the start.

All of it stands in one file because numba looks only at the file of a stored function to see whether it is
stale.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from malipp_field.planner.kernels import njit

FloatArray = NDArray[np.float64]

ONE = np.uint64(1)
ZERO = np.uint64(0)
LEVELS = 192
"""Steps of energy in the completion bound."""


class Actor(NamedTuple):
    """One robot in arrays over its P places.

    Attributes
    ----------
    cost : array, shape (P, P)
        alpha between places.
    home : array, shape (P,)
        alpha of the cheapest way to a terminal; from a depot, to another depot (the start excepted).
    limits, most_drop, most_pick : array, shape (P,)
        Bounds on a and on the exchange at each place.
    depot : array, shape (P,)
        Whether it unloads there.
    toll
        Value lost for each joule spent.
    """

    cost: FloatArray
    home: FloatArray
    empty_mass: float
    sample_mass: float
    budget: float
    capacity: int
    on_board: int
    limits: NDArray[np.int64]
    most_drop: NDArray[np.int64]
    most_pick: NDArray[np.int64]
    depot: NDArray[np.bool_]
    toll: float = 0.0


@njit(cache=True)
def _mixed(h, x):  # type: ignore[no-untyped-def]
    h ^= x + np.uint64(0x9E3779B97F4A7C15) + (h << np.uint64(6)) + (h >> np.uint64(2))
    h *= np.uint64(0xBF58476D1CE4E5B9)
    return h ^ (h >> np.uint64(31))


@njit(cache=True)
def way_home(actor, u, mask):  # type: ignore[no-untyped-def]
    """Return alpha of the cheapest end of a route at ``u``.

    No arc leads from a depot to its own terminal copy: a robot that has picked something up at a depot goes
    to another one, or comes back over a place it has not visited.
    """
    best = actor.home[u]
    if u > 0 and actor.depot[u]:
        for v in range(1, actor.cost.shape[0]):
            if v != u and not (mask >> np.uint64(v)) & ONE:
                best = min(best, actor.cost[u, v] + actor.cost[v, u])
    return best


@njit(cache=True)
def completion(actor, gain):  # type: ignore[no-untyped-def]
    """Return upper bounds on the value still to be gathered, by place, load and energy level left.

    The relaxation forgets which places were visited and rounds energies down to ``budget / LEVELS``.

    Returns
    -------
    array, shape (P, K + 1, E), the energy of a level, and levels added to make up for legs below one level.
    """
    P = gain.shape[0]
    K = actor.capacity
    step = actor.budget / LEVELS
    if step <= 0.0:
        step = 1e-12
    slack = 0
    for u in range(P):
        for v in range(1, P):
            if u != v and actor.cost[u, v] * actor.empty_mass < step:
                slack = P
    E = LEVELS + slack + 1
    bound = np.full((P, K + 1, E), -np.inf)
    arrive = np.full((P, K + 1, E), -np.inf)
    for e in range(E):
        for u in range(P):
            for q in range(K + 1):
                mass = actor.empty_mass + actor.sample_mass * q
                best = -np.inf
                home = way_home(actor, u, ZERO) * mass
                if home <= (e + 1) * step:
                    best = -actor.toll * home
                for v in range(1, P):
                    if v == u:
                        continue
                    leg = actor.cost[u, v] * mass
                    if not leg / step < e + 1:
                        continue
                    left = e - max(1, int(leg / step))
                    if left >= 0:
                        best = max(best, arrive[v, q, left] - actor.toll * leg)
                bound[u, q, e] = best
        for v in range(1, P):
            for q in range(K + 1):
                best = -np.inf
                for a in range(actor.limits[v] + 1):
                    brought = q + a
                    if brought > K:
                        break
                    most_drop = min(brought, actor.most_drop[v])
                    base = 0 if actor.depot[v] else brought
                    for h in range(-most_drop, actor.most_pick[v] + 1):
                        after = base + h
                        if after > K:
                            break
                        best = max(best, gain[v, a * (2 * K + 1) + h + K] + bound[v, after, e])
                arrive[v, q, e] = best
    return bound, step, slack


@njit(cache=True)
def _level(energy_left, step, slack, levels):  # type: ignore[no-untyped-def]
    return min(int(max(energy_left, 0.0) / step) + slack, levels - 1)


@njit(cache=True)
def _hash(codes, mask, v, q):  # type: ignore[no-untyped-def]
    h = _mixed(mask, np.uint64(v * 4096 + q))
    for w in range(codes.shape[0]):
        if codes[w] != 0:
            h = _mixed(h, np.uint64(w * 65536 + codes[w]))
    return h


@njit(cache=True, nogil=True)
def enumerate_labels(actor, gain, least, room):  # type: ignore[no-untyped-def]
    """List every partial schedule that some schedule of value ``least`` or more begins with.

    Labels that differ only in the order of their stops are kept once, with the least energy.

    Parameters
    ----------
    gain : array, shape (P, C)
        Value of each operation code; minus infinity forbids it.
    room
        Most labels.

    Returns
    -------
    Number of labels (-1: there are more than ``room``), codes (less K, so that 0 is idle), visited, place,
    load, energy, parent.
    """
    P = actor.cost.shape[0]
    K = actor.capacity
    bound, step, slack = completion(actor, gain)
    levels = bound.shape[2]
    codes = np.zeros((room, P), np.int16)
    mask = np.zeros(room, np.uint64)
    place = np.zeros(room, np.int16)
    load = np.zeros(room, np.int16)
    energy = np.zeros(room)
    value = np.zeros(room)
    parent = np.full(room, -1, np.int32)
    size = 64
    while size < 2 * room:
        size *= 2
    table = np.full(size, -1, np.int32)
    limit = actor.budget * (1.0 + 1e-9) + 1e-12
    count = 0
    begin, end = -1, 0
    while begin < end:
        fresh = count
        for i in range(begin, end):
            for v in range(P):
                if (i < 0) != (v == 0):
                    continue
                if i < 0:
                    spent, q, seen, worth = 0.0, actor.on_board, ZERO, 0.0
                else:
                    if (mask[i] >> np.uint64(v)) & ONE:
                        continue
                    mass = actor.empty_mass + actor.sample_mass * load[i]
                    leg = actor.cost[place[i], v] * mass
                    spent = energy[i] + leg
                    q, seen, worth = load[i], mask[i], value[i] - actor.toll * leg
                if not spent <= limit:
                    continue
                for a in range(actor.limits[v] + 1):
                    brought = q + a
                    if brought > K and not actor.depot[v]:
                        break
                    base = 0 if actor.depot[v] else brought
                    for h in range(-min(brought, actor.most_drop[v]), actor.most_pick[v] + 1):
                        after = base + h
                        if after > K:
                            break
                        if a == 0 and h == 0 and v > 0 and not (actor.depot[v] and q > 0):
                            continue
                        code = a * (2 * K + 1) + h + K
                        new = worth + gain[v, code]
                        more = bound[v, after, _level(limit - spent, step, slack, levels)]
                        if not new + more >= least:
                            continue
                        if count >= room:
                            return -1, codes, mask, place, load, energy, parent
                        k = count
                        if i >= 0:
                            codes[k] = codes[i]
                        else:
                            codes[k] = 0
                        codes[k, v] = code - K
                        seen_now = seen | (ONE << np.uint64(v))
                        slot = _hash(codes[k], seen_now, v, after) & np.uint64(size - 1)
                        found = -1
                        while table[slot] >= 0:
                            j = table[slot]
                            if mask[j] == seen_now and place[j] == v and load[j] == after:
                                same = True
                                for w in range(P):
                                    if codes[j, w] != codes[k, w]:
                                        same = False
                                        break
                                if same:
                                    found = j
                                    break
                            slot = (slot + ONE) & np.uint64(size - 1)
                        if found < 0:
                            table[slot] = k
                            mask[k], place[k], load[k] = seen_now, v, after
                            energy[k], value[k], parent[k] = spent, new, i
                            count += 1
                        elif spent < energy[found]:
                            energy[found], value[found], parent[found] = spent, new, i
        begin, end = fresh, count
    return count, codes, mask, place, load, energy, parent


@njit(cache=True, nogil=True)
def complete_schedules(actor, count, codes, mask, place, load, energy):  # type: ignore[no-untyped-def]
    """Return the cheapest label, and its energy, of every set of operations that the budget allows."""
    P = codes.shape[1]
    size = 64
    while size < 2 * count + 2:
        size *= 2
    table = np.full(size, -1, np.int32)
    label = np.zeros(count, np.int32)
    least = np.zeros(count)
    limit = actor.budget * (1.0 + 1e-9) + 1e-12
    n = 0
    for i in range(count):
        spent = energy[i] + way_home(actor, place[i], mask[i]) * (
            actor.empty_mass + actor.sample_mass * load[i]
        )
        if not spent <= limit:
            continue
        slot = _hash(codes[i], ZERO, 0, 0) & np.uint64(size - 1)
        found = -1
        while table[slot] >= 0:
            j = table[slot]
            same = True
            for w in range(P):
                if codes[label[j], w] != codes[i, w]:
                    same = False
                    break
            if same:
                found = j
                break
            slot = (slot + ONE) & np.uint64(size - 1)
        if found < 0:
            table[slot] = n
            label[n], least[n] = i, spent
            n += 1
        elif spent < least[found]:
            label[found], least[found] = i, spent
    return label[:n], least[:n]


@njit(cache=True, nogil=True)
def without_dominated(codes, K, limits, most_pick):  # type: ignore[no-untyped-def]
    """Tell which schedules no other one beats by one sample taken or one unit of exchange more.

    ``codes`` are less K. What is taken or picked besides does no harm: J falls with every sample, and of a
    pick only what is dropped need be used.
    """
    n, P = codes.shape
    H = 2 * K + 1
    size = 64
    while size < 2 * n + 2:
        size *= 2
    table = np.full(size, -1, np.int32)
    for i in range(n):
        slot = _hash(codes[i], ZERO, 0, 0) & np.uint64(size - 1)
        while table[slot] >= 0:
            slot = (slot + ONE) & np.uint64(size - 1)
        table[slot] = i
    keep = np.ones(n, np.bool_)
    trial = np.zeros(P, np.int16)
    for i in range(n):
        trial[:] = codes[i]
        for w in range(P):
            code = codes[i, w] + K
            for kind in range(2):
                a, h = code // H, code % H - K
                if kind == 0:
                    a += 1
                    if a > limits[w]:
                        continue
                else:
                    h += 1
                    if h > most_pick[w]:
                        continue
                trial[w] = a * H + h
                slot = _hash(trial, ZERO, 0, 0) & np.uint64(size - 1)
                while table[slot] >= 0 and keep[i]:
                    same = True
                    for x in range(P):
                        if codes[table[slot], x] != trial[x]:
                            same = False
                            break
                    if same:
                        keep[i] = False
                    slot = (slot + ONE) & np.uint64(size - 1)
                if not keep[i]:
                    break
            trial[w] = codes[i, w]
            if not keep[i]:
                break
    return keep


@njit(cache=True)
def _push(keys, items, size, key, item):  # type: ignore[no-untyped-def]
    """Put an item on a heap of ``size`` whose largest key is on top."""
    k = size
    while k > 0:
        up = (k - 1) // 2
        if keys[up] >= key:
            break
        keys[k], items[k] = keys[up], items[up]
        k = up
    keys[k], items[k] = key, item


@njit(cache=True)
def _pop(keys, items, size):  # type: ignore[no-untyped-def]
    """Take the top off a heap of ``size``."""
    top = items[0]
    key, item = keys[size - 1], items[size - 1]
    k = 0
    while True:
        down = 2 * k + 1
        if down >= size - 1:
            break
        if down + 1 < size - 1 and keys[down + 1] > keys[down]:
            down += 1
        if keys[down] <= key:
            break
        keys[k], items[k] = keys[down], items[down]
        k = down
    keys[k], items[k] = key, item
    return top


@njit(cache=True, nogil=True)
def price_labels(actor, gain, must, exact_load, least, room, enough):  # type: ignore[no-untyped-def]
    """Find schedules worth more than ``least`` by labelling with dominance, the most promising labels first.

    A label is dominated by one at the same place with no more load, energy or visited places and no less
    value; ``exact_load`` asks for the same load (where dropping less than planned is forbidden somewhere).

    Parameters
    ----------
    must : uint64
        Places at which the schedule has to do something.
    room, enough
        The search ends with so many labels, or so many schedules found.

    Returns
    -------
    An upper bound on the value of schedules that were not found (no more than ``least`` when the search was
    complete), labels of schedules found, their values, and the labels' code, place and parent.
    """
    P = actor.cost.shape[0]
    K = actor.capacity
    H = 2 * K + 1
    bound, step, slack = completion(actor, gain)
    levels = bound.shape[2]
    # empty: clearing all of it would take longer than most searches
    mask = np.empty(room, np.uint64)
    place = np.empty(room, np.int16)
    load = np.empty(room, np.int16)
    code_of = np.empty(room, np.int16)
    energy = np.empty(room)
    value = np.empty(room)
    parent = np.empty(room, np.int32)
    dead = np.empty(room, np.bool_)
    done = np.empty(room, np.bool_)
    keys = np.empty(room)
    heap = np.empty(room, np.int32)
    waiting = 0
    follows = np.empty(room, np.int32)
    first = np.full(P, -1, np.int32)
    found = np.empty(room, np.int32)
    worths = np.empty(room)
    n_found = 0
    limit = actor.budget * (1.0 + 1e-9) + 1e-12
    # loops, since loading what uses NumPy's own reductions imports all of scipy.linalg
    lightens = False  # whether it may drop or unload on its way
    best_gain = np.zeros(P)
    for v in range(P):
        lightens = lightens or actor.most_drop[v] > 0 or (v > 0 and actor.depot[v])
        for code in range(gain.shape[1]):
            best_gain[v] = max(best_gain[v], gain[v, code])
    worth_of_i = np.inf
    count = 0
    i = -1
    while True:
        for v in range(P):
            if (i < 0) != (v == 0):
                continue
            if i < 0:
                spent, q, seen, worth = 0.0, actor.on_board, ZERO, 0.0
            else:
                if (mask[i] >> np.uint64(v)) & ONE:
                    continue
                mass = actor.empty_mass + actor.sample_mass * load[i]
                leg = actor.cost[place[i], v] * mass
                spent = energy[i] + leg
                q, seen, worth = load[i], mask[i], value[i] - actor.toll * leg
            if not spent <= limit:
                continue
            for a in range(actor.limits[v] + 1):
                brought = q + a
                if brought > K and not actor.depot[v]:
                    break
                base = 0 if actor.depot[v] else brought
                for h in range(-min(brought, actor.most_drop[v]), actor.most_pick[v] + 1):
                    after = base + h
                    if after > K:
                        break
                    if a == 0 and h == 0 and v > 0 and not (actor.depot[v] and q > 0):
                        continue
                    code = a * H + h + K
                    g = gain[v, code]
                    if g == -np.inf:
                        continue
                    if not exact_load and (
                        (h > 0 and g <= gain[v, code - 1] + 1e-12)
                        or (a > 0 and h >= 0 and g <= gain[v, code - H] + 1e-12)
                        or (a > 0 and h < 0 and g <= gain[v, code - H + 1] + 1e-12)
                    ):
                        continue  # one less to carry for the same
                    new = worth + g
                    rest = bound[v, after, _level(limit - spent, step, slack, levels)]
                    if not new + rest > least:
                        continue
                    seen_now = seen | (ONE << np.uint64(v))
                    mass = actor.empty_mass + (0.0 if lightens else actor.sample_mass * after)
                    open_gain = 0.0
                    for w in range(1, P):
                        if not (seen_now >> np.uint64(w)) & ONE:
                            reach = (
                                spent
                                + actor.cost[v, w] * mass
                                + min(actor.home[w], way_home(actor, w, ZERO)) * actor.empty_mass
                            )
                            if reach > limit:
                                if (must >> np.uint64(w)) & ONE:
                                    open_gain = -np.inf
                                    break
                                seen_now |= ONE << np.uint64(w)
                            else:
                                open_gain += best_gain[w]
                    if not new + open_gain > least:
                        continue
                    j = first[v]
                    beaten = False
                    while j >= 0:
                        if not dead[j]:
                            if (
                                energy[j] <= spent + 1e-9
                                and value[j] >= new - 1e-9
                                and (load[j] == after or (load[j] < after and not exact_load))
                                and (mask[j] & ~seen_now) == ZERO
                                and ((mask[j] ^ seen_now) & must) == ZERO
                            ):
                                beaten = True
                                break
                            if (
                                not done[j]
                                and spent <= energy[j]
                                and new >= value[j]
                                and (load[j] == after or (after < load[j] and not exact_load))
                                and (seen_now & ~mask[j]) == ZERO
                                and ((mask[j] ^ seen_now) & must) == ZERO
                            ):
                                dead[j] = True
                        j = follows[j]
                    if beaten:
                        continue
                    if count >= room:
                        open_value = max(worth_of_i, new + rest)
                        if waiting > 0:
                            open_value = max(open_value, keys[0])
                        return open_value, found[:n_found], worths[:n_found], code_of, place, parent
                    k = count
                    mask[k], place[k], load[k], code_of[k] = seen_now, v, after, code - K
                    energy[k], value[k], parent[k] = spent, new, i
                    follows[k], dead[k], done[k] = first[v], False, False
                    first[v] = k
                    count += 1
                    total = spent + way_home(actor, v, seen_now) * (
                        actor.empty_mass + actor.sample_mass * after
                    )
                    in_all = new - actor.toll * (total - spent)
                    if in_all > least and total <= limit and (seen_now & must) == must:
                        found[n_found], worths[n_found] = k, in_all
                        n_found += 1
                    _push(keys, heap, waiting, min(new + rest, new + open_gain), k)
                    waiting += 1
        if i >= 0:
            done[i] = True
        i = -1
        while waiting > 0 and i < 0:
            worth_of_i = keys[0]
            i = _pop(keys, heap, waiting)
            waiting -= 1
            if dead[i]:
                i = -1
        if i < 0:
            return least, found[:n_found], worths[:n_found], code_of, place, parent
        if n_found >= enough:
            return worth_of_i, found[:n_found], worths[:n_found], code_of, place, parent


@njit(cache=True, nogil=True)
def scan(codes, K, gain, firsts, seconds, pair_gain, least, values):  # type: ignore[no-untyped-def]
    """Write the value of every schedule of a pool into ``values``; below ``least`` only a bound on it.

    Parameters
    ----------
    codes : array, shape (M, P)
        Operation codes, less K.
    gain : array, shape (P, C)
        Indexed by code; minus infinity forbids.
    firsts, seconds : array, shape (Q,)
        Pairs of places.
    pair_gain : array, shape (Q, C, C)
        What the codes at both are worth besides, never above zero.
    """
    M, P = codes.shape
    for i in range(M):
        total = 0.0
        for w in range(P):
            total += gain[w, codes[i, w] + K]
        if total > least:
            for k in range(firsts.shape[0]):
                total += pair_gain[k, codes[i, firsts[k]] + K, codes[i, seconds[k]] + K]
        values[i] = total
