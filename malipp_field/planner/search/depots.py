"""Compiled changes of where robots unload on their way."""

from __future__ import annotations

from malipp_field.planner.kernels import compiled
from malipp_field.planner.search.routes import below, derive, insert_stop, remove_stop, uniform
from malipp_field.planner.search.state import Case, Scratch, State

_MORE_DEPOTS, _FEWER_DEPOTS = 0.12, 0.08
"""Chances for each robot to be sent through a depot on the way, or no longer."""
_DEPOT_FIRST = 0.5
"""Chance that a robot unloads before anything else in a plan that is constructed."""


@compiled
def change_depots(case: Case, state: State, scratch: Scratch) -> None:
    """Send robots through one of their depots on the way, or no longer, where their rules allow it."""
    for r in range(len(state.length)):
        chance = uniform(scratch)
        if chance < _MORE_DEPOTS:
            v, i = below(scratch, len(case.candidate)), 1 + below(scratch, state.length[r] - 1)
            _pass(case, state, r, i, v)
        elif chance < _MORE_DEPOTS + _FEWER_DEPOTS:
            _leave_out(case, state, r)


@compiled
def unload_first(case: Case, state: State, scratch: Scratch) -> None:
    """Let some robots pass a depot before anything else, so that a full one can fetch what lies elsewhere."""
    for r in range(len(state.length)):
        if uniform(scratch) < _DEPOT_FIRST:
            _pass(case, state, r, 1, below(scratch, len(case.candidate)))


@compiled
def _pass(case: Case, state: State, r: int, i: int, v: int) -> None:
    """Make depot v stop i. As the last one it costs nothing until something follows, and goes if not."""
    if not case.depot[r, v] or not case.place[r, v] or state.pos[r, v] >= 0:
        return
    insert_stop(case, state, r, i, v)
    if i == state.length[r] - 2:
        state.route[r, i + 1] = v
    if not derive(case, state, r):
        remove_stop(case, state, r, i)


@compiled
def _leave_out(case: Case, state: State, r: int) -> None:
    """Leave out the first depot at which a robot only unloads."""
    for i in range(1, state.length[r] - 1):
        v = state.route[r, i]
        if case.depot[r, v] and state.collect[r, v] + state.give[r, v] + state.take[r, v] == 0:
            remove_stop(case, state, r, i)
            if not derive(case, state, r):
                insert_stop(case, state, r, i, v)
            return
