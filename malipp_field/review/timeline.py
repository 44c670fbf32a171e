"""Logging at the two times every moment of a mission has."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import rerun as rr

from malipp_field.field import FloatArray

MISSION_TIME = "mission_time"
UTC = "utc"


def clock(time_s: float) -> str:
    """Return a mission time or duration as minutes and seconds, with hours where there are any."""
    sign = "-" if round(time_s) < 0 else ""
    minutes, seconds = divmod(abs(round(time_s)), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{sign}{hours}:{minutes:02}:{seconds:02}" if hours else f"{sign}{minutes}:{seconds:02}"


class Timeline:
    """A Rerun recording together with its mission time 0.

    Parameters
    ----------
    recording
        Where to log.
    start_s
        Mission time 0, in seconds since the Unix epoch.
    """

    def __init__(self, recording: rr.RecordingStream, start_s: float) -> None:
        self.recording = recording
        self.start_s = start_s

    def log(self, time_s: float, entity: str, *what: rr.AsComponents) -> None:
        """Log at a time in seconds since the Unix epoch."""
        self.recording.set_time(MISSION_TIME, duration=time_s - self.start_s)
        self.recording.set_time(UTC, timestamp=time_s)
        self.recording.log(entity, *what)

    def log_static(self, entity: str, *what: rr.AsComponents) -> None:
        """Log what holds at all times."""
        self.recording.log(entity, *what, static=True)

    def send(self, mission_times_s: Sequence[float] | FloatArray, entity: str, columns: object) -> None:
        """Log one row a time, in mission time, in one go."""
        times = np.asarray(mission_times_s, dtype=np.float64)
        indexes = [
            rr.TimeColumn(MISSION_TIME, duration=times),
            rr.TimeColumn(UTC, timestamp=times + self.start_s),
        ]
        self.recording.send_columns(entity, indexes=indexes, columns=columns)
