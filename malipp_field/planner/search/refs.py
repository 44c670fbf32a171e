"""The arrays of the search by reference: what compiled functions hand to each other.

Numba passes a named tuple array by array, some hundred words a call; a structref is one pointer. Field names
are those of the named tuples, so that types and code read the same.
"""

from __future__ import annotations

from numba import types
from numba.experimental import structref

from malipp_field.planner.kernels import stored
from malipp_field.planner.search.state import Case, Scratch, State


@structref.register
class CaseType(types.StructRef):  # type: ignore[misc]  # numba has no types
    """Numba's type of a `Case` by reference."""


class CaseRef(structref.StructRefProxy):  # type: ignore[misc]
    """A `Case` by reference."""


@structref.register
class StateType(types.StructRef):  # type: ignore[misc]  # numba has no types
    """Numba's type of a `State` by reference."""


class StateRef(structref.StructRefProxy):  # type: ignore[misc]
    """A `State` by reference."""


@structref.register
class ScratchType(types.StructRef):  # type: ignore[misc]  # numba has no types
    """Numba's type of a `Scratch` by reference."""


class ScratchRef(structref.StructRefProxy):  # type: ignore[misc]
    """A `Scratch` by reference."""


structref.define_proxy(CaseRef, CaseType, list(Case._fields))
structref.define_proxy(StateRef, StateType, list(State._fields))
structref.define_proxy(ScratchRef, ScratchType, list(Scratch._fields))


@stored
def case_ref(case: Case) -> Case:
    """Return a reference to the arrays of a case."""
    reference: Case = CaseRef(*case)
    return reference


@stored
def state_ref(state: State) -> State:
    """Return a reference to the arrays of a state."""
    reference: State = StateRef(*state)
    return reference


@stored
def scratch_ref(scratch: Scratch) -> Scratch:
    """Return a reference to the working arrays."""
    reference: Scratch = ScratchRef(*scratch)
    return reference
