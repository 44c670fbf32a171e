"""Compiled ruin: which samples are taken out of a plan."""

from __future__ import annotations

import numpy as np

from malipp_field.planner.draft import COLLECTED
from malipp_field.planner.kernels import compiled
from malipp_field.planner.search.routes import below, learn, learn_all, remove, tidy, uniform
from malipp_field.planner.search.state import FIRST_HOP, HOPS, KIND, NODE, PILE, ROBOT, Case, Scratch, State

_MOST_TAKEN_OUT = 10
_WHOLE_ROBOT = 0.5
"""Chance that all samples of a robot are taken out, not just some."""


@compiled
def ruin(case: Case, state: State, scratch: Scratch) -> int:
    """Take samples out; return how many of them have to be put in again (``scratch.homeless``)."""
    homeless = 0
    if state.size[0] > 0:
        taken, going = _choose(case, state, scratch), 0
        for s in range(state.size[0]):
            going += scratch.key[s] < taken
        anew = 2 * going > state.size[0]
        for s in range(state.size[0] - 1, -1, -1):
            if scratch.key[s] < taken:
                row = state.samples[s]
                if row[KIND] == COLLECTED and not anew:
                    learn(case, state, case.candidate[row[NODE]], -case.precision[row[ROBOT]])
                if row[KIND] != COLLECTED:
                    scratch.homeless[homeless, 0], scratch.homeless[homeless, 1] = row[KIND], row[NODE]
                    scratch.homeless[homeless, 2], scratch.homeless[homeless, 3] = row[ROBOT], row[PILE]
                    homeless += 1
                remove(state, s)
        if anew:
            learn_all(case, state)
    for r in range(len(state.length)):
        tidy(case, state, r)
    return homeless


@compiled
def _choose(case: Case, state: State, scratch: Scratch) -> float:
    """Give every sample a key; those below the number returned go."""
    size = state.size[0]
    most = 1 + below(scratch, min(_MOST_TAKEN_OUT, size))
    how = uniform(scratch)
    if how < 0.3:
        _near(case, state, scratch)
    elif how < 0.55:
        share = 1.0 if uniform(scratch) < _WHOLE_ROBOT else uniform(scratch)
        _of_robots(state, scratch, 1 + below(scratch, 2))
        return share
    elif how < 0.7:
        _of_string(state, scratch)
        return 1.0
    elif how < 0.85:
        for s in range(size):
            scratch.key[s] = uniform(scratch)
    else:
        _of_drop(state, scratch)
        return 1.0
    return _limit_of_smallest(scratch, size, most)


@compiled
def _limit_of_smallest(scratch: Scratch, size: int, count: int) -> float:
    """Return a number with ``count`` keys (more if they are equal) below it."""
    limit = -1.0
    for _ in range(count):
        least = np.inf
        for s in range(size):
            if limit <= scratch.key[s] < least:
                least = scratch.key[s]
        limit = np.nextafter(least, np.inf)
    return limit


@compiled
def _near(case: Case, state: State, scratch: Scratch) -> None:
    """Order samples by how far they lie from one of them, as a random robot drives, with some noise."""
    cost = case.cost[below(scratch, len(state.length))]
    centre = state.samples[below(scratch, state.size[0]), NODE]
    for s in range(state.size[0]):
        scratch.key[s] = cost[centre, state.samples[s, NODE]] * (0.7 + 0.6 * uniform(scratch))


@compiled
def _of_robots(state: State, scratch: Scratch, robots: int) -> None:
    """Let those go, in random order, that one of so many random robots handles."""
    for s in range(state.size[0]):
        scratch.key[s] = 2.0
    for _ in range(robots):
        robot = below(scratch, len(state.length))
        for s in range(state.size[0]):
            row = state.samples[s]
            handled = row[ROBOT] == robot
            for h in range(row[HOPS]):
                handled = handled or row[FIRST_HOP + 2 * h + 1] == robot
            if handled:
                scratch.key[s] = uniform(scratch)


@compiled
def _of_string(state: State, scratch: Scratch) -> None:
    """Let those go that are handled by one robot on a string of neighbouring stops."""
    robot = below(scratch, len(state.length))
    stops = state.length[robot] - 1
    first = below(scratch, stops)
    last = min(stops - 1, first + below(scratch, 4))
    for s in range(state.size[0]):
        row = state.samples[s]
        scratch.key[s] = 2.0
        holder, node = row[ROBOT], row[NODE]
        for h in range(row[HOPS] + 1):
            if holder == robot and first <= state.pos[holder, node] <= last:
                scratch.key[s] = 0.0
            if h < row[HOPS]:
                node = row[FIRST_HOP + 2 * h]
                if holder == robot and first <= state.pos[holder, node] <= last:
                    scratch.key[s] = 0.0
                holder = row[FIRST_HOP + 2 * h + 1]


@compiled
def _of_drop(state: State, scratch: Scratch) -> None:
    """Let those go that are dropped where a random one is; that one alone if it is not dropped."""
    chosen = state.samples[below(scratch, state.size[0])]
    place = chosen[FIRST_HOP] if chosen[HOPS] > 0 else -1
    for s in range(state.size[0]):
        row = state.samples[s]
        scratch.key[s] = 2.0
        for h in range(row[HOPS]):
            if row[FIRST_HOP + 2 * h] == place:
                scratch.key[s] = 0.0
        if place < 0 and row[NODE] == chosen[NODE] and row[ROBOT] == chosen[ROBOT]:
            scratch.key[s] = 0.0
