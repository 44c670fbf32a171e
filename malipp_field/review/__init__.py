"""What became of a mission, from its recording alone: figures, and a Rerun recording to look at."""

from __future__ import annotations

from pathlib import Path

from malipp_field.record import read_run
from malipp_field.review.rerun_log import write_review
from malipp_field.review.summary import Summary, summarise
from malipp_field.review.tables import print_summary

__all__ = ["Summary", "print_summary", "review", "summarise", "write_review"]


def review(mcap_path: Path, rrd_path: Path) -> Summary:
    """Make a Rerun recording from a mission's MCAP file and return the mission in figures.

    Raises
    ------
    InputError
        When the one cannot be read or the other not be written.
    """
    run = read_run(mcap_path)
    write_review(run, rrd_path)
    return summarise(run)
