"""How functions are compiled and kept on disk: loaded quickly, compiled with a notice."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba
from numba.core.caching import FunctionCache
from numba.core.runtime import rtsys

_F = TypeVar("_F", bound=Callable[..., object])

_NOTICE = "compiling the planner's inner loops once, about a minute ..."

_told = False


def njit(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Return `numba.njit` with these options; what it keeps on disk (``cache=True``) loads as told above."""
    make = numba.njit(**options)

    def compiled(function: Callable[..., Any]) -> Any:
        dispatcher = make(function)
        if options.get("cache"):
            dispatcher._cache = _Kept(function)
        return dispatcher

    return compiled


class _Kept(FunctionCache):  # type: ignore[misc]  # numba has no types
    """What is on disk of one function.

    Numba first makes ready all it knows for compiling, which takes longer than loading and which the compiler
    does itself when it comes to that. What is loaded needs only the memory of arrays.
    """

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return the function compiled for these types, None where it must be compiled; say so then."""
        rtsys.initialize(target_context)
        with self._guard_against_spurious_io_errors():
            found = self._load_overload(sig, target_context)
        if found is None:
            _tell()
        return found


def _tell() -> None:
    """Say once that somebody will have to wait."""
    global _told  # noqa: PLW0603 (once in a process)
    if not _told:
        _told = True
        print(_NOTICE, file=sys.stderr, flush=True)


def compiled(function: _F) -> _F:
    """Compile a function that only compiled functions call, without wrappers for Python."""
    make = njit(error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True)
    return cast("_F", make(function))


def spliced(function: _F) -> _F:
    """Make a function a part of whatever calls it: every level of calls is optimised anew by LLVM."""
    return cast("_F", njit(error_model="numpy", inline="always")(function))


def stored(function: _F) -> _F:
    """Compile a function that Python calls, and keep the result on disk; other threads run meanwhile."""
    return cast("_F", njit(error_model="numpy", cache=True, nogil=True)(function))
