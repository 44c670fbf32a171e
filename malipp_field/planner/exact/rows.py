"""Rows of the master over what schedules do: sums over places, or over pairs of places.

A row gives every schedule the sum of table entries, one for its code at each place. Pricing needs no more
than these tables. In other rows listed schedules count by their codes at two places together; only a scan of
the list can see them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from malipp_field.field import FloatArray
from malipp_field.planner.exact.schedules import Codes, Pairs, Robot

_FIRST_ROOM = 16
_Entry = TypeVar("_Entry", np.float64, np.int64)


@dataclass(frozen=True)
class Own:
    """What one robot's schedules count in a row; idleness counts nothing at a single place.

    Attributes
    ----------
    single : dict of arrays, shape (C,)
        By place: value of every code.
    paired : dict of arrays, shape (C, C)
        By two places: value of both codes. A row has one kind or the other.
    """

    single: Mapping[int, FloatArray] = field(default_factory=dict)
    paired: Mapping[tuple[int, int], FloatArray] = field(default_factory=dict)

    def values(self, robot: Robot, codes: Codes) -> FloatArray:
        """Return what schedules count, shape (M,).

        Parameters
        ----------
        codes : array, shape (M, P), less K
        """
        shifted = codes + robot.capacity
        total = np.zeros(len(shifted))
        for w, table in self.single.items():
            total += table[shifted[:, w]]
        for (w, x), table in self.paired.items():
            total += table[shifted[:, w], shifted[:, x]]
        return total


class Rows:
    """All rows in which the schedules of one robot count."""

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        cells, width = len(robot.places) * robot.width, robot.width
        self._single_row = _Growing(np.zeros(0, dtype=np.int64))
        self._single = _Growing(np.zeros((0, cells)))
        self._paired_row = _Growing(np.zeros(0, dtype=np.int64))
        self._pair = _Growing(np.zeros((0, 2), dtype=np.int64))
        self._paired = _Growing(np.zeros((0, width, width)))

    def add(self, row: int, own: Own) -> None:
        """Add a row."""
        if own.single:
            table = np.zeros((len(self._robot.places), self._robot.width))
            for w, values in own.single.items():
                table[w] = values
            self._single_row.append(np.array(row))
            self._single.append(table.ravel())
        for pair, values in own.paired.items():
            self._paired_row.append(np.array(row))
            self._pair.append(np.array(pair))
            self._paired.append(values)

    def terms(self, codes: Codes) -> list[tuple[int, float]]:
        """Return the rows in which a schedule counts, and what.

        Parameters
        ----------
        codes : array, shape (P,), less K
        """
        shifted = codes + self._robot.capacity
        cells = np.arange(len(shifted)) * self._robot.width + shifted
        first, second = self._pair.all.T
        paired = self._paired.all[np.arange(len(first)), shifted[first], shifted[second]]
        rows = np.concatenate([self._single_row.all, self._paired_row.all])
        values = np.concatenate([self._single.all[:, cells].sum(axis=1), paired])
        counts = values != 0.0
        return list(zip(rows[counts].tolist(), values[counts].tolist(), strict=True))

    def gains(self, dual: FloatArray) -> FloatArray:
        """Return what each code at each place is worth, shape (P, C)."""
        gains: FloatArray = dual[self._single_row.all] @ self._single.all
        return gains.reshape(len(self._robot.places), self._robot.width)

    def pair_gains(self, dual: FloatArray) -> Pairs:
        """Return pairs of places, and what two codes there are worth besides: nothing is above zero."""
        prices = dual[self._paired_row.all]
        used = np.flatnonzero(prices)
        pairs, which = np.unique(self._pair.all[used], axis=0, return_inverse=True)
        worth = np.zeros((len(pairs), self._robot.width, self._robot.width))
        np.add.at(worth, which.ravel(), prices[used, None, None] * self._paired.all[used])
        return pairs[:, 0].copy(), pairs[:, 1].copy(), np.minimum(worth, 0.0)

    def renumber(self, gone: NDArray[np.int64]) -> None:
        """Follow the master, which has dropped rows (ascending) that are none of these."""
        for rows in (self._single_row, self._paired_row):
            rows.all[:] -= np.searchsorted(gone, rows.all)


class _Growing(Generic[_Entry]):
    """An array that grows along its first axis."""

    def __init__(self, empty: NDArray[_Entry]) -> None:
        self._array = np.resize(empty, (_FIRST_ROOM, *empty.shape[1:]))
        self._count = 0

    def append(self, entry: NDArray[_Entry]) -> None:
        if self._count == len(self._array):
            self._array = np.concatenate([self._array, np.zeros_like(self._array)])
        self._array[self._count] = entry
        self._count += 1

    @property
    def all(self) -> NDArray[_Entry]:
        return self._array[: self._count]
