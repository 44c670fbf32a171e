"""How the functions of the search are compiled."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar, cast

from malipp_field.planner.kernels import njit

_F = TypeVar("_F", bound=Callable[..., object])


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
