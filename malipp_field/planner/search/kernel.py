"""The compiled search: ruin, recreate, accept as in annealing; thousands of times a second.

Design: samples with custody chains, taken out and put in again greedily, the next one always the one with the
most gain in J for a power of the energy it costs. What is drawn anew in every iteration: that power, what a
joule of each robot counts, where new drops are tried, noise on the gains, and whether several drops are.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np

from malipp_field.field import FloatArray
from malipp_field.planner import draft
from malipp_field.planner.draft import COLLECTED, ON_BOARD
from malipp_field.planner.kernels import compiled, spliced, stored
from malipp_field.planner.problem import IntArray
from malipp_field.planner.search.chain import find_chain
from malipp_field.planner.search.depots import change_depots, unload_first
from malipp_field.planner.search.insertion import find_costs, find_way, insert
from malipp_field.planner.search.refs import case_ref, scratch_ref, state_ref
from malipp_field.planner.search.routes import (
    below,
    copy,
    copy_of,
    count_all,
    cut_at_depots,
    derive_team,
    find_falls,
    learn_all,
    tidy,
    uniform,
)
from malipp_field.planner.search.ruin import ruin
from malipp_field.planner.search.state import Case, Scratch, State, scratch_for, state_for

DONE, CYCLE, FAILED, ACCEPTED, IMPROVED = range(5)
"""Columns of a search's counters: iterations done in this cycle of cooling, and how many it has; iterations
that gave no plan; plans accepted; best plans found. ``FAILED`` iterations change nothing."""
HEAT, SCALE = range(2)
"""Columns of a search's figures: the temperature, and J where the cycle began."""

_START_TEMPERATURE, _END_TEMPERATURE = 1e-2, 1e-4
"""As shares of J of the plan a cycle begins with."""
LONGER = 2
"""How much longer each cycle of cooling is than the one before."""
_ENERGY_WEIGHT = 3e-4
"""What all budgets count as, as a share of J of the prior: among equals the cheaper is kept."""
_TIE = 1e-9
"""Plans whose J differ by less than this share of the prior's count as equal."""
_LEAST_GAIN = 1e-10
"""A sample that lowers J by less than this share of the prior's is not worth its weight."""
_SMALL_COST = 0.02
"""Added to the share of a budget that a sample costs, so that what is free does not win by itself."""
_AFRESH = 50
"""Plans accepted before the posterior is worked out from the prior again, against the drift of updates."""
_LEAST_POWER, _MOST_POWER = 0.1, 1.3
_SHY, _SHY_ROBOTS = 0.3, 0.08
"""Share of a budget that counts against a way without a drop, and the chance that it does for a robot."""
_NOISE, _BLINK, _CHAINS, _MOST_HUBS = 0.4, 0.02, 0.1, 0.7


@compiled
def _draw(case: Case, scratch: Scratch) -> None:
    """Draw what an iteration looks at."""
    for r in range(len(scratch.weight)):
        scratch.weight[r] = (0.4 + 1.2 * uniform(scratch)) / max(case.budget_j[r], 1e-9)
        scratch.changed[r] = True
    for r in range(len(scratch.shy)):
        scratch.shy[r] = _SHY if uniform(scratch) < _SHY_ROBOTS else 0.0
    chance = uniform(scratch) * _MOST_HUBS
    for w in range(len(scratch.hub)):
        scratch.hub[w] = uniform(scratch) < chance
    scratch.chains[0] = uniform(scratch) < _CHAINS
    scratch.blink[0] = _BLINK


@spliced
def _recreate(case: Case, state: State, scratch: Scratch) -> bool:
    """Put in samples as long as one can be found that fits; return False where a rule broke."""
    power = _LEAST_POWER + (_MOST_POWER - _LEAST_POWER) * uniform(scratch)
    scratch.sample[0], scratch.sample[3] = COLLECTED, -1
    while True:
        find_costs(case, state, scratch)
        find_falls(case, state)
        if not _find_next(case, state, scratch, power):
            return True
        if not insert(case, state, scratch):
            return False


@compiled
def _find_next(case: Case, state: State, scratch: Scratch, power: float) -> bool:
    """Find the sample with the best score and its way; return whether there is one."""
    first = _find_promising(case, state, scratch, power)
    best, n = 0.0, len(case.candidate)
    for k in range(-1, len(state.length) * n):
        p = first if k < 0 else k
        if p < 0 or k == first:
            continue
        r, v = p // n, p % n
        gain = scratch.gain[r, v]
        if gain <= 0.0:
            continue
        limit = np.inf if best == 0.0 else (gain / best) ** (1.0 / power) - _SMALL_COST
        least = min(scratch.fetch[r, v], scratch.detour[r, v] + scratch.lowest[r])
        cost = find_way(case, state, scratch, r, v, limit) if least < limit else limit
        if scratch.chains[0] and scratch.detour[r, v] < cost:
            cost = find_chain(case, state, scratch, r, v, cost)
        if cost < limit:
            best = gain / (_SMALL_COST + max(cost, 0.0)) ** power
            copy_of(scratch.best, scratch.way)
    return best > 0.0


@compiled
def _find_promising(case: Case, state: State, scratch: Scratch, power: float) -> int:
    """Draw what every sample is taken to gain; return which seems best, brought home by its own robot, or -1.

    Looked at first, it sets a limit that spares most of the others a closer look.
    """
    best, first, n = 0.0, -1, len(case.candidate)
    for r in range(len(state.length)):
        for v in range(n):
            scratch.gain[r, v] = 0.0
            if state.collect[r, v] >= case.limits[r, v]:
                continue
            u = case.candidate[v]
            gain = case.precision[r] * state.fall[u]
            gain /= 1.0 + case.precision[r] * max(state.c_vv[u, u], 0.0)
            if gain <= _LEAST_GAIN * case.prior:
                continue
            scratch.gain[r, v] = gain * (1.0 - _NOISE * uniform(scratch))
            score = scratch.gain[r, v] / (_SMALL_COST + max(scratch.fetch[r, v], 0.0)) ** power
            if score > best:
                best, first = score, r * n + v
    return first


@compiled
def _bring_home(case: Case, state: State, scratch: Scratch, homeless: int) -> bool:
    """Put in, in random order, the samples that must come home; return False where one finds no way."""
    for left in range(homeless, 0, -1):
        s = below(scratch, left)
        for k in range(4):
            scratch.sample[k] = scratch.homeless[s, k]
            scratch.homeless[s, k] = scratch.homeless[left - 1, k]
        if not _bring_one(case, state, scratch):
            return False
    return True


@spliced
def _bring_one(case: Case, state: State, scratch: Scratch) -> bool:
    """Put in one sample that must come home; return False where it finds no way."""
    find_costs(case, state, scratch)
    first, last = 0, len(state.length) - 1
    if scratch.sample[0] == ON_BOARD:
        first, last = scratch.sample[2], scratch.sample[2]
    limit = np.inf
    for r in range(first, last + 1):
        cost = find_way(case, state, scratch, r, scratch.sample[1], limit)
        if scratch.chains[0]:
            cost = find_chain(case, state, scratch, r, scratch.sample[1], cost)
        if cost < limit:
            limit = cost
            copy_of(scratch.best, scratch.way)
    return limit < np.inf and insert(case, state, scratch)


@compiled
def _finish(case: Case, state: State) -> bool:
    """Leave out what is idle; return whether the plan keeps every rule."""
    for r in range(len(state.length)):
        tidy(case, state, r)
        last = state.length[r] - 1
        if last > 1 and state.route[r, last] == state.route[r, last - 1]:
            return False  # no leg leads from a depot to its own terminal copy
    return derive_team(case, state)


@spliced
def _change(case: Case, state: State, scratch: Scratch) -> bool:
    """Ruin and recreate a plan; return False where no plan came of it."""
    _draw(case, scratch)
    homeless = ruin(case, state, scratch)
    if not derive_team(case, state):
        return False
    change_depots(case, state, scratch)
    if not derive_team(case, state):
        return False
    if not _bring_home(case, state, scratch, homeless):
        return False
    if not _recreate(case, state, scratch):
        return False
    return _finish(case, state)


@compiled
def _worth(case: Case, state: State) -> float:
    """Return J and, of little weight, the energy."""
    shares = 0.0
    for r in range(len(state.length)):
        shares += state.energy_j[r] / max(case.budget_j[r], 1e-9)
    return float(state.value[0] + _ENERGY_WEIGHT * case.prior * shares / len(state.length))


@compiled
def _energy_j(state: State) -> float:
    energy_j = 0.0
    for r in range(len(state.energy_j)):
        energy_j += state.energy_j[r]
    return energy_j


@compiled
def _better(case: Case, state: State, best: State) -> bool:
    """Tell whether a plan has less J than the best so far or, for the same J, takes less energy."""
    less = best.value[0] - state.value[0]
    tie = _TIE * case.prior
    return less > tie or (less > -tie and _energy_j(state) < _energy_j(best) * (1.0 - _TIE))


@spliced
def _begin_cycle(case: Case, now: State, best: State, counters: IntArray, figures: FloatArray) -> None:
    """Heat up again, from the best plan."""
    copy(now, best)
    counters[DONE] = 0
    counters[CYCLE] *= LONGER
    figures[SCALE] = max(best.value[0], _TIE * case.prior)
    figures[HEAT] = _START_TEMPERATURE * figures[SCALE]


@spliced
def _search(
    case: Case,
    best: State,
    now: State,
    trial: State,
    scratch: Scratch,
    counters: IntArray,
    figures: FloatArray,
    iterations: int,
) -> None:
    for _ in range(iterations):
        if counters[DONE] >= counters[CYCLE]:
            _begin_cycle(case, now, best, counters, figures)
        cooling = (_END_TEMPERATURE / _START_TEMPERATURE) ** (counters[DONE] / counters[CYCLE])
        figures[HEAT] = _START_TEMPERATURE * figures[SCALE] * cooling
        counters[DONE] += 1
        copy(trial, now)
        if not _change(case, trial, scratch):
            counters[FAILED] += 1
            continue
        worse = _worth(case, trial) - _worth(case, now)
        if worse < 0.0 or uniform(scratch) < np.exp(-worse / figures[HEAT]):
            copy(now, trial)
            counters[ACCEPTED] += 1
            if counters[ACCEPTED] % _AFRESH == 0 or _better(case, now, best):
                learn_all(case, now)
                if _better(case, now, best):
                    copy(best, now)
                    counters[IMPROVED] += 1


@spliced
def _begin(case: Case, state: State, scratch: Scratch, homeless: int) -> bool:
    """Derive everything of a plan just written, and put in what is homeless; False where a rule is broken."""
    cut_at_depots(case, state)
    count_all(case, state)
    if not _finish(case, state):
        return False
    if homeless == 0:
        return True
    _draw(case, scratch)
    scratch.chains[0], scratch.blink[0] = True, 0.0
    for w in range(len(scratch.hub)):
        scratch.hub[w] = True
    unload_first(case, state, scratch)
    return derive_team(case, state) and _bring_home(case, state, scratch, homeless) and _finish(case, state)


def _stamp() -> int:
    """Return a number that changes with the text of any file that is compiled.

    Numba looks only at the file of the function it has stored; what that calls may lie in others.
    """
    files = [Path(str(draft.__file__)), *sorted(Path(__file__).parent.glob("*.py"))]
    return zlib.crc32(b"".join(file.read_bytes() for file in files))


def _stored(stamp: int) -> Callable[..., bool]:
    """Return the function that Python calls, compiled and kept on disk; ``stamp`` is part of its key."""

    @stored
    def run(
        case: Case,
        best: State,
        now: State,
        trial: State,
        scratch: Scratch,
        counters: IntArray,
        figures: FloatArray,
        homeless: int,
        iterations: int,
    ) -> bool:
        if stamp < 0:
            return False
        if iterations == 0:
            return _begin(case, best, scratch, homeless)
        _search(case, best, now, trial, scratch, counters, figures, iterations)
        return True

    return run


_run = _stored(_stamp())


class Kernel:
    """The compiled functions with the arrays of one problem's search.

    Attributes
    ----------
    best : State
        The best plan.
    scratch : Scratch
        Working arrays.
    counters : array, shape (5,); figures : array, shape (2,)
        How the search stands: ``DONE`` and so on, ``HEAT`` and ``SCALE``.
    """

    def __init__(self, case: Case, samples: int, hops: int, seed: int) -> None:
        self.best = state_for(case, samples, hops)
        self.scratch = scratch_for(case, samples, seed)
        self.counters = np.zeros(5, dtype=np.int64)
        self.figures = np.zeros(2)
        states = self.best, state_for(case, samples, hops), state_for(case, samples, hops)
        self._arguments = (
            case_ref(case), *map(state_ref, states), scratch_ref(self.scratch), self.counters, self.figures
        )  # fmt: skip

    def begin(self, homeless: int = 0) -> bool:
        """Derive all of a plan just written into ``best``, and put in the first of ``scratch.homeless``.

        Returns False where that breaks a rule, or where a sample finds no way home.
        """
        return bool(_run(*self._arguments, homeless, 0))

    def search(self, iterations: int) -> None:
        """Do so many iterations, at least one."""
        _run(*self._arguments, 0, max(1, iterations))
