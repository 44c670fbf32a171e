"""When a mission is over, and how it ended, in words."""

from __future__ import annotations

from collections.abc import Mapping

from malipp_field.bus import SampleRecord
from malipp_field.control.ledger import CustodyLedger
from malipp_field.control.tracks import Track
from malipp_field.mission import Mission


def conclusion(
    mission: Mission, tracks: Mapping[str, Track], ledger: CustodyLedger, start_s: float, now_s: float
) -> tuple[bool, str] | None:
    """Return whether a mission is complete, and why it is over; `None` while it goes on.

    Parameters
    ----------
    start_s, now_s
        On the team's clock.
    """
    if all(track.finished for track in tracks.values()):
        return _all_done(ledger)
    stall_s = mission.replanning.stall_s
    progress_s = max(start_s, *(track.progress_s for track in tracks.values()))
    if now_s - progress_s <= stall_s:
        return None
    stuck = ", ".join(_stuck(mission, track) for track in tracks.values() if not track.finished)
    return False, f"no progress for {stall_s:.0f} s: {stuck}"


def _all_done(ledger: CustodyLedger) -> tuple[bool, str]:
    records = ledger.records.values()
    given_up = [str(tag) for tag in ledger.given_up]
    not_taken = f"; not taken: container {', '.join(given_up)}" if given_up else ""
    if ledger.all_home:
        home = any(record.state == "delivered" for record in records)
        return True, ("every sample taken is home" if home else "no sample was taken") + not_taken
    away = [record for record in records if record.state in ("on_board", "cached", "lost")]
    which = ", ".join(_whereabouts(record) for record in away)
    samples = "1 sample is" if len(away) == 1 else f"{len(away)} samples are"
    return False, f"all vehicles are done, but {samples} not home: {which}{not_taken}"


def _whereabouts(record: SampleRecord) -> str:
    missing = "missing, last " if record.state == "lost" else ""
    preposition = "on" if record.history[-1].action.value in ("collect", "pick") else "at"
    return f"{record.sample.tag} from {record.sample.node} ({missing}{preposition} {record.holder})"


def _stuck(mission: Mission, track: Track) -> str:
    """Return a vehicle that gets no further, with the reason where it is plain."""
    robot, telemetry = track.robot_id, track.telemetry
    if telemetry is None or not telemetry.link_ok:
        return f"{robot} (not heard any more)"
    if telemetry.energy_used_j >= 0.999 * mission.robot(robot).energy_budget_j:
        return f"{robot} (battery empty)"
    return robot if telemetry.awaits is None else f"{robot} (waits for a person: {telemetry.awaits})"
