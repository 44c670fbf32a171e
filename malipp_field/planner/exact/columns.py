"""What goes into and comes out of the master: its points, its schedules, and what a node forbids."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from malipp_field.field import FloatArray
from malipp_field.planner.exact.schedules import Codes


@dataclass
class Point:
    """A solution of the master."""

    value: float
    x: FloatArray
    dual: FloatArray
    reduced: FloatArray
    """Reduced costs of the columns."""
    missing: float
    """Shares of schedules that do not exist."""


class Stack:
    """The schedules of one robot that are in the master, in arrays that grow.

    Attributes
    ----------
    codes : array, shape (M, P), less K
    column : array, shape (M,)
        Where each stands in the master.
    closed : array of bool, shape (M,)
    """

    def __init__(self, places: int) -> None:
        self._codes = np.zeros((256, places), dtype=np.int16)
        self._column = np.zeros(256, dtype=np.int64)
        self._closed = np.zeros(256, dtype=np.bool_)
        self._known: set[bytes] = set()

    def __len__(self) -> int:
        return len(self._known)

    def __contains__(self, codes: Codes) -> bool:
        return codes.tobytes() in self._known

    def add(self, codes: Codes, column: int) -> None:
        """Put one more on top."""
        count = len(self)
        if count == len(self._column):
            self._codes = np.concatenate([self._codes, np.zeros_like(self._codes)])
            self._column = np.concatenate([self._column, np.zeros_like(self._column)])
            self._closed = np.concatenate([self._closed, np.zeros_like(self._closed)])
        self._codes[count], self._column[count] = codes, column
        self._known.add(codes.tobytes())

    @property
    def codes(self) -> Codes:
        """See the class."""
        return self._codes[: len(self)]

    @property
    def column(self) -> NDArray[np.int64]:
        """See the class."""
        return self._column[: len(self)]

    @property
    def closed(self) -> NDArray[np.bool_]:
        """See the class."""
        return self._closed[: len(self)]


@dataclass
class Branch:
    """What a node of the tree forbids.

    Attributes
    ----------
    forbidden : array of bool, one of shape (P, C) a robot
    counts : dict
        Bounds on n_kv by (class, position in V).
    levels : dict
        Bounds on z_vl by (position in V, selector).
    exact_load
        Robots that may have to drop more than they need.
    """

    forbidden: list[NDArray[np.bool_]]
    counts: dict[tuple[int, int], tuple[float, float]] = field(default_factory=dict)
    levels: dict[tuple[int, int], tuple[float, float]] = field(default_factory=dict)
    exact_load: frozenset[int] = frozenset()
