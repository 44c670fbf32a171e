"""Where the missions in force count on what will not be: containers, fetchers, samples."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from malipp_field.control.ledger import CustodyLedger
from malipp_field.control.tracks import Track
from malipp_field.vehicle.steps import Action, Step


def broken_chain(tracks: Mapping[str, Track], ledger: CustodyLedger) -> str | None:
    """Return where the missions in force no longer hand every container on, in words; `None`: nowhere.

    After an action that a vehicle went on without, others may wait in vain, or leave something to lie.
    """
    for robot, track in tracks.items():
        for step in _left(track):
            if gone := ledger.gone(step.tags):
                return f"{robot} counts on container {gone[0]} at {step.node}, which will not come"
            if step.action is Action.COLLECT and step.node in ledger.barren and not _is_at(track, step):
                return f"{robot} is to sample at {step.node}, where a sample could not be taken"
    fetched = {tag for track in tracks.values() for tag in _tags(track, Action.PICK)}
    left = {tag for track in tracks.values() for tag in _tags(track, Action.DROP)}
    lying = {tag for tags in ledger.caches().values() for tag in tags}
    forgotten = sorted((left | lying) - fetched - ledger.unsettled)
    return f"nobody is going to fetch container {forgotten[0]}" if forgotten else None


def _left(track: Track) -> Iterator[Step]:
    """Yield the steps that a vehicle has not begun yet; a gate at which it waits is one."""
    step = track.step
    waiting = step is not None and step.action is Action.WAIT
    yield from track.mission.steps[track.current + (not waiting) :]


def _is_at(track: Track, step: Step) -> bool:
    """Tell whether a vehicle has come to the stop of a step already: then it may as well try."""
    return track.step is not None and track.step.stop == step.stop and track.step.action is not Action.DRIVE


def _tags(track: Track, action: Action) -> Iterator[int]:
    """Yield what a vehicle is still to do that with, including what it is doing now."""
    for step in track.mission.steps[track.current :]:
        if step.action is action:
            yield from step.tags
