"""Where the vehicles were, in local metres."""

from __future__ import annotations

import numpy as np

from malipp_field.field import FloatArray
from malipp_field.mission import ABSTRACT_ORIGIN, to_local
from malipp_field.record import Run

# A vehicle that stands still seems to move by the error of its position: less than this is no driving.
_STANDSTILL_M = 0.2


def local_track(run: Run, robot: str) -> tuple[FloatArray, FloatArray]:
    """Return mission times (s), shape (N,), and places (east, north in metres), shape (N, 2)."""
    origin = run.mission.site.origin or ABSTRACT_ORIGIN
    reports = run.telemetry[robot]
    times = np.array([report.time_s - run.start_s for report in reports])
    places = np.array([to_local(report.lat_deg, report.lon_deg, origin) for report in reports])
    return times, places.reshape(-1, 2)


def moves(places_m: FloatArray, least_m: float) -> list[int]:
    """Return the indices of places at least ``least_m`` from the one kept before; always the first."""
    if not len(places_m):
        return []
    kept = [0]
    for index in range(1, len(places_m)):
        if np.hypot(*(places_m[index] - places_m[kept[-1]])) >= least_m:
            kept.append(index)
    return kept


def driven_m(places_m: FloatArray) -> float:
    """Return the length of a track of shape (N, 2) in metres, without the jitter of standing still."""
    kept = places_m[moves(places_m, _STANDSTILL_M)]
    return float(np.hypot(*np.diff(kept, axis=0).T).sum()) if len(kept) > 1 else 0.0
