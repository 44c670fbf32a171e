"""The field estimate as images over the site, one pair after every sample that was confirmed."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from malipp_field.bus.messages import Confirmation
from malipp_field.field import FloatArray, Observation, posterior
from malipp_field.mission import node_positions
from malipp_field.mission.schema import Kernel
from malipp_field.record import Run
from malipp_field.review.site import Frame, frame
from malipp_field.review.summary import done
from malipp_field.vehicle.steps import Action

FloatImage = NDArray[np.float32]

# Cells along the longer side: about as many as a view has pixels for when two stand beside each other.
_CELLS = 112
# Each image is some 40 kB: of very long missions not every sample gets one.
_MOST_IMAGES = 150


@dataclass(frozen=True)
class Grid:
    """Square cells over a frame. Images of it have north up: row 0 is the northernmost."""

    area: Frame
    cell_m: float
    rows: int
    columns: int

    def centres(self) -> FloatArray:
        """Return the places of all cells row by row, shape (rows * columns, 2), in metres."""
        east = self.area.west_m + (np.arange(self.columns) + 0.5) * self.cell_m
        north = self.area.north_m - (np.arange(self.rows) + 0.5) * self.cell_m
        return np.stack(np.meshgrid(east, north), axis=-1).reshape(-1, 2)


@dataclass(frozen=True)
class Estimate:
    """The field after some samples."""

    time_s: float
    """Seconds since the Unix epoch."""
    std: FloatImage
    """Posterior standard deviation, shape (rows, columns); it needs no values."""
    mean: FloatImage | None
    """Posterior mean; null while no sample has a value."""


def grid(run: Run) -> Grid:
    """Return the grid of a run's images."""
    area = frame(run.mission)
    cell_m = area.span_m / _CELLS
    return Grid(
        area=area,
        cell_m=cell_m,
        rows=round((area.north_m - area.south_m) / cell_m),
        columns=round((area.east_m - area.west_m) / cell_m),
    )


def estimates(run: Run, cells: Grid) -> Iterator[Estimate]:
    """Yield the prior and then the field after each confirmed sample."""
    taken = done(run, Action.COLLECT)
    observed = _observations(run, taken)
    counts = np.unique(np.linspace(0, len(taken), min(len(taken), _MOST_IMAGES) + 1).astype(int))
    for count in counts:
        time_s = taken[count - 1].time_s if count else run.start_s
        yield _estimate(run.mission.field.kernel, cells, time_s, taken[:count], observed[:count])


def _observations(run: Run, taken: list[Confirmation]) -> list[Observation]:
    """Return samples as the estimate takes them; where a value is missing only the precision counts."""
    places = node_positions(run.mission)
    return [
        Observation(
            *places[said.node],
            value=0.0 if said.value is None else said.value,
            noise_variance=run.mission.robot(said.robot).noise_variance,
        )
        for said in taken
    ]


def _estimate(
    kernel: Kernel, cells: Grid, time_s: float, taken: list[Confirmation], observed: list[Observation]
) -> Estimate:
    centres, shape = cells.centres(), (cells.rows, cells.columns)
    mean, std = posterior(kernel, observed, centres)
    measured = [seen for said, seen in zip(taken, observed, strict=True) if said.value is not None]
    if len(measured) < len(observed):
        mean, _ = posterior(kernel, measured, centres)
    return Estimate(
        time_s=time_s,
        std=std.reshape(shape).astype(np.float32),
        mean=mean.reshape(shape).astype(np.float32) if measured else None,
    )


def value_ranges(images: list[Estimate]) -> dict[str, tuple[float, float]]:
    """Return the range of values over all images of ``mean`` (where there is one) and ``std``.

    One range for the whole mission, so that a colour means the same at every moment.
    """
    means = [estimate.mean for estimate in images if estimate.mean is not None]
    ranges = {"std": (0.0, float(max(estimate.std.max() for estimate in images)))}
    if means:
        ranges["mean"] = (float(min(m.min() for m in means)), float(max(m.max() for m in means)))
    return ranges
