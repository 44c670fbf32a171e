"""One MCAP file for a whole mission: written from the bus, read back as typed messages."""

from malipp_field.record.reader import Run, read_run
from malipp_field.record.recorder import RECORDER_PRESENCE, Recorder
from malipp_field.record.writer import RunWriter

__all__ = ["RECORDER_PRESENCE", "Recorder", "Run", "RunWriter", "read_run"]
