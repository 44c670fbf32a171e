"""Compiled listing of all schedules of one robot within a gap, and what a pool of them is worth.

Labels and codes are those of `malipp_field.planner.labels`.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from malipp_field.planner.labels import ONE, ZERO, completion, level, way_home


@njit(cache=True)
def _mixed(h, x):  # type: ignore[no-untyped-def]
    h ^= x + np.uint64(0x9E3779B97F4A7C15) + (h << np.uint64(6)) + (h >> np.uint64(2))
    h *= np.uint64(0xBF58476D1CE4E5B9)
    return h ^ (h >> np.uint64(31))


@njit(cache=True)
def _hash(codes, mask, v, q):  # type: ignore[no-untyped-def]
    h = _mixed(mask, np.uint64(v * 4096 + q))
    for w in range(codes.shape[0]):
        if codes[w] != 0:
            h = _mixed(h, np.uint64(w * 65536 + codes[w]))
    return h


@njit(cache=True)
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
                    spent = energy[i] + actor.cost[place[i], v] * mass
                    q, seen, worth = load[i], mask[i], value[i]
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
                        more = bound[v, after, level(limit - spent, step, slack, levels)]
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
                            energy[found], parent[found] = spent, i
        begin, end = fresh, count
    return count, codes, mask, place, load, energy, parent


@njit(cache=True)
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


@njit(cache=True)
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
def scan(codes, K, gain, firsts, seconds, pair_gain, marks, least, values):  # type: ignore[no-untyped-def]
    """Write the value of every schedule of a pool into ``values``; below ``least`` only a bound on it.

    Parameters
    ----------
    codes : array, shape (M, P)
        Operation codes, less K.
    gain : array, shape (P, C)
        Indexed by code; minus infinity forbids.
    firsts, seconds, pair_gain : array, shape (Q,)
        Two columns of ``marks`` and the value of their product, none above zero.
    marks : array, shape (M, 3 P)
        See `schedules.Robot.marks`.
    """
    M, P = codes.shape
    for i in range(M):
        total = 0.0
        for w in range(P):
            total += gain[w, codes[i, w] + K]
        if total > least:
            for k in range(firsts.shape[0]):
                total += pair_gain[k] * marks[i, firsts[k]] * marks[i, seconds[k]]
        values[i] = total
