"""Where the vehicles were, in local metres."""

from __future__ import annotations

import math

import numpy as np
import pymap3d

from malipp_field.field import FloatArray
from malipp_field.mission import ABSTRACT_ORIGIN
from malipp_field.record import Run

# A vehicle that stands still seems to move by the error of its position: less than this is no driving.
_STANDSTILL_M = 0.2


def local_track(run: Run, robot: str) -> tuple[FloatArray, FloatArray]:
    """Return mission times (s), shape (N,), and places (east, north in metres), shape (N, 2)."""
    origin = run.mission.site.origin or ABSTRACT_ORIGIN
    reports = run.telemetry[robot]
    times = np.array([report.time_s - run.start_s for report in reports])
    # As mission.to_local does, but of all reports at once: a long recording has a million of them.
    east_m, north_m, _ = pymap3d.geodetic2enu(
        np.array([report.lat_deg for report in reports]),
        np.array([report.lon_deg for report in reports]),
        origin.alt_m,
        *(origin.lat_deg, origin.lon_deg, origin.alt_m),
    )
    return times, np.stack([east_m, north_m], axis=-1)


def moves(places_m: FloatArray, least_m: float) -> list[int]:
    """Return the indices of places at least ``least_m`` from the one kept before; always the first."""
    kept: list[int] = []
    last = (math.inf, math.inf)
    for index, place in enumerate(places_m.tolist()):
        if math.dist(place, last) >= least_m:
            kept.append(index)
            last = place
    return kept


def driven_m(places_m: FloatArray) -> float:
    """Return the length of a track of shape (N, 2) in metres, without the jitter of standing still."""
    kept = places_m[moves(places_m, _STANDSTILL_M)]
    return float(np.hypot(*np.diff(kept, axis=0).T).sum()) if len(kept) > 1 else 0.0
