"""Missions in force that no longer hand every container on, and gates whose times have changed."""

from __future__ import annotations

from control_cases import compiled, confirm, drop_plan, relay_mission

from malipp_field.bus import Confirmation
from malipp_field.control.ledger import CustodyLedger
from malipp_field.control.revision import same_work
from malipp_field.control.stranded import broken_chain
from malipp_field.control.tracks import Track
from malipp_field.vehicle.steps import Action, Step


def under_way() -> tuple[dict[str, Track], CustodyLedger]:
    mission, (missions, ledger) = relay_mission(), compiled(drop_plan())
    return {r: Track(mission, drop_plan().robot(r), missions[r]) for r in missions}, ledger


def report(tracks: dict[str, Track], robot: str, action: Action, tag: int) -> Confirmation:
    """Confirm to the track the first such step, and all steps before it; return the confirmation."""
    steps = tracks[robot].mission.steps
    at = next(i for i, s in enumerate(steps) if s.action is action and tag in s.tags)
    for step in steps[: at + 1]:
        tracks[robot].confirm(step.uid)
    return confirm(robot, action, tag, steps[at].node)


def test_a_chain_that_holds_is_none_at_every_moment() -> None:
    tracks, ledger = under_way()
    assert broken_chain(tracks, ledger) is None
    for robot, action, tag in (
        ("scout", Action.COLLECT, 1),
        ("scout", Action.COLLECT, 2),
        ("scout", Action.DROP, 1),
        ("carrier", Action.PICK, 1),
        ("scout", Action.UNLOAD, 2),
        ("carrier", Action.UNLOAD, 1),
    ):
        assert ledger.confirm(report(tracks, robot, action, tag)) is None
        assert broken_chain(tracks, ledger) is None


def test_a_receiver_that_waits_for_what_was_never_taken() -> None:
    tracks, ledger = under_way()
    ledger.miss(report(tracks, "scout", Action.COLLECT, 1))
    found = broken_chain(tracks, ledger)
    assert found is not None
    assert "counts on container 1 at far, which will not come" in found


def test_a_container_that_is_dropped_after_its_receiver_went_on_without() -> None:
    tracks, ledger = under_way()
    ledger.confirm(report(tracks, "scout", Action.COLLECT, 1))
    ledger.miss(report(tracks, "carrier", Action.PICK, 1))
    assert broken_chain(tracks, ledger) == "nobody is going to fetch container 1"
    ledger.confirm(report(tracks, "scout", Action.DROP, 1))
    assert broken_chain(tracks, ledger) == "nobody is going to fetch container 1"


def test_a_pick_ahead_of_the_news_of_its_drop_is_no_broken_chain() -> None:
    tracks, ledger = under_way()
    ledger.confirm(report(tracks, "scout", Action.COLLECT, 1))
    assert ledger.confirm(report(tracks, "carrier", Action.PICK, 1)) is not None
    assert broken_chain(tracks, ledger) is None


def test_a_gate_that_would_open_too_early_makes_it_another_mission() -> None:
    steps = compiled(drop_plan())[0]["carrier"].steps
    at = next(i for i, step in enumerate(steps) if step.action is Action.WAIT)

    def opening(not_before_s: float | None) -> tuple[Step, ...]:
        return (*steps[:at], steps[at].model_copy(update={"not_before_s": not_before_s}), *steps[at + 1 :])

    def same(old: float | None, new: float | None) -> bool:
        return same_work(opening(old), opening(new))

    assert same(None, None)
    assert same(100.0, 100.5)
    assert same(100.0, 60.0), "the coordinator opens it sooner"
    assert same(None, 100.0)
    assert not same(100.0, 140.0)
    assert not same(100.0, None)
    lenient = [s.model_copy(update={"if_missing": "go_on"}) for s in steps]
    assert not same_work(steps, lenient)


def test_a_teammate_is_not_sent_where_nothing_could_be_taken() -> None:
    tracks, ledger = under_way()
    scout = tracks["scout"]
    ledger.miss(report(tracks, "scout", Action.COLLECT, 1))
    scout.mission = scout.mission.model_copy(
        update={"steps": tuple(step for step in scout.mission.steps if 1 not in step.tags)}
    )
    tracks["carrier"].mission = scout.mission
    assert broken_chain({"scout": scout}, ledger) is None, "it stands there already, and may as well try"
    found = broken_chain(tracks, ledger)
    assert found == "carrier is to sample at far, where a sample could not be taken"
