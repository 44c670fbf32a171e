"""Custody is conserved: nothing appears, nothing vanishes, nothing is in two hands."""

from __future__ import annotations

import pytest
from control_cases import confirm
from hypothesis import given
from hypothesis import strategies as st

from malipp_field.bus import Confirmation
from malipp_field.control.ledger import CustodyLedger
from malipp_field.vehicle.steps import Action, Sample


def ledger_of(*tags: int) -> CustodyLedger:
    ledger = CustodyLedger()
    ledger.expect([Sample(tag=tag, node="far", sampler="scout") for tag in tags])
    return ledger


def test_the_whole_way_of_a_container() -> None:
    ledger = ledger_of(1)
    for robot, action, node in (
        ("scout", Action.COLLECT, "far"),
        ("scout", Action.DROP, "hub"),
        ("carrier", Action.PICK, "hub"),
        ("carrier", Action.UNLOAD, "base"),
    ):
        assert ledger.confirm(confirm(robot, action, 1, node)) is None
    record = ledger.records[1]
    assert (record.state, record.holder, record.value) == ("delivered", "base", 0.5)
    assert [(e.action, e.robot, e.node) for e in record.history] == [
        (Action.COLLECT, "scout", "far"),
        (Action.DROP, "scout", "hub"),
        (Action.PICK, "carrier", "hub"),
        (Action.UNLOAD, "carrier", "base"),
    ]
    assert ledger.all_home


@pytest.mark.parametrize(
    ("robot", "action", "node", "words"),
    [
        ("scout", Action.DROP, "hub", "is planned"),
        ("carrier", Action.COLLECT, "far", "was promised to scout"),
        ("carrier", Action.PICK, "hub", "is planned"),
        ("scout", Action.WAIT, "hub", "cannot be waited"),
    ],
)
def test_what_cannot_have_happened_changes_nothing(robot: str, action: Action, node: str, words: str) -> None:
    ledger = ledger_of(1)
    before = ledger.records
    refusal = ledger.confirm(confirm(robot, action, 1, node))
    assert refusal is not None
    assert words in refusal
    assert ledger.records == before


def test_an_unknown_container_is_refused() -> None:
    assert ledger_of(1).confirm(confirm("scout", Action.COLLECT, 7, "far")) == "container 7 is not known"


def test_on_board_caches_and_promises() -> None:
    ledger = ledger_of(1, 2, 3, 4)
    for tag in (2, 1, 3):
        ledger.confirm(confirm("scout", Action.COLLECT, tag, "far", time_s=float(10 - tag)))
    ledger.confirm(confirm("scout", Action.DROP, 3, "hub"))
    assert ledger.on_board("scout") == (2, 1)
    assert ledger.caches() == {("hub", "scout"): (3,)}
    assert ledger.collected_by("scout") == {"far": 3}
    assert ledger.promised_to("scout") == {"far": (4,)}
    assert not ledger.all_home


def test_a_withdrawn_tag_is_never_given_again() -> None:
    ledger = ledger_of(1, 2)
    ledger.expect([Sample(tag=1, node="far", sampler="scout")])
    assert ledger.records[2].state == "withdrawn"
    assert ledger.next_tag == 3
    assert ledger.all_home


def test_a_sample_taken_though_it_was_withdrawn_has_to_come_home() -> None:
    ledger = ledger_of(1, 2)
    ledger.expect([Sample(tag=1, node="far", sampler="scout")])
    assert ledger.confirm(confirm("carrier", Action.COLLECT, 2, "far")) is not None
    assert ledger.confirm(confirm("scout", Action.COLLECT, 2, "far")) is None
    assert ledger.on_board("scout") == (2,)
    assert not ledger.all_home


ROBOTS, NODES = ("scout", "carrier"), ("far", "hub", "base")


@given(
    st.lists(
        st.tuples(
            st.sampled_from(ROBOTS), st.sampled_from(list(Action)), st.integers(1, 3), st.sampled_from(NODES)
        ),
        max_size=40,
    )
)
def test_no_sequence_of_confirmations_breaks_conservation(
    actions: list[tuple[str, Action, int, str]],
) -> None:
    ledger = ledger_of(1, 2, 3)
    for robot, action, tag, node in actions:
        before = ledger.records
        refused = ledger.confirm(confirm(robot, action, tag, node))
        changed = [t for t in before if ledger.records[t] != before[t]]
        assert changed == ([] if refused else [tag])
    for tag, record in ledger.records.items():
        places = [
            *(robot for robot in ROBOTS if tag in ledger.on_board(robot)),
            *(node for (node, _), tags in ledger.caches().items() if tag in tags),
        ]
        assert len(places) == (1 if record.state in ("on_board", "cached") else 0)
        taken = sum(e.action is Action.COLLECT for e in record.history)
        delivered = sum(e.action is Action.UNLOAD for e in record.history)
        assert taken == (0 if record.state == "planned" else 1)
        assert delivered == (1 if record.state == "delivered" else 0)


def missed(robot: str, action: Action, tag: int, node: str) -> Confirmation:
    return confirm(robot, action, tag, node).model_copy(update={"ok": False, "goes_on": True})


def test_what_was_not_there_is_missing_where_it_was_known_last_and_may_turn_up() -> None:
    ledger = ledger_of(1, 2)
    for tag in (1, 2):
        ledger.confirm(confirm("scout", Action.COLLECT, tag, "far"))
    ledger.confirm(confirm("scout", Action.DROP, 1, "hub"))
    ledger.miss(missed("carrier", Action.PICK, 1, "hub"))
    ledger.miss(missed("scout", Action.DROP, 2, "hub"))
    assert {t: (r.state, r.holder) for t, r in ledger.records.items()} == {
        1: ("lost", "hub"), 2: ("lost", "scout"),
    }  # fmt: skip
    assert (ledger.caches(), ledger.on_board("scout"), ledger.gone([1, 2, 3])) == ({}, (), [1, 2])
    assert not ledger.all_home
    assert ledger.confirm(confirm("carrier", Action.PICK, 1, "far")) is not None
    assert ledger.confirm(confirm("carrier", Action.PICK, 1, "hub")) is None
    assert ledger.on_board("carrier") == (1,)


def test_a_receiver_that_came_too_early_loses_nothing() -> None:
    ledger = ledger_of(1)
    ledger.confirm(confirm("scout", Action.COLLECT, 1, "far"))
    ledger.miss(missed("carrier", Action.PICK, 1, "hub"))
    assert ledger.on_board("scout") == (1,)
    ledger.miss(missed("carrier", Action.UNLOAD, 1, "base"))
    ledger.miss(missed("carrier", Action.PICK, 9, "hub"))
    assert ledger.on_board("scout") == (1,)


def test_what_could_not_be_taken_is_withdrawn_and_named() -> None:
    ledger = ledger_of(1, 2)
    ledger.miss(missed("scout", Action.COLLECT, 1, "far"))
    assert (ledger.records[1].state, ledger.given_up, ledger.gone([1, 2])) == ("withdrawn", [1], [1])
    assert list(ledger.barren) == ["far"]
    ledger.confirm(confirm("scout", Action.COLLECT, 1, "far"))
    assert (ledger.given_up, list(ledger.barren)) == ([], [])


def test_a_pick_heard_of_before_its_drop_counts_when_the_drop_is_known() -> None:
    """The receiver kept its gate by time while nobody heard the sender."""
    ledger = ledger_of(1)
    ledger.confirm(confirm("scout", Action.COLLECT, 1, "far"))
    assert ledger.confirm(confirm("carrier", Action.PICK, 1, "hub")) is not None
    assert ledger.confirm(confirm("carrier", Action.UNLOAD, 1, "base")) is not None
    assert (ledger.unsettled, ledger.on_board("scout")) == ({1}, (1,))
    assert ledger.confirm(confirm("scout", Action.DROP, 1, "hub")) is None
    assert (ledger.records[1].state, ledger.records[1].holder, ledger.unsettled) == (
        "delivered",
        "base",
        set(),
    )
    assert len(ledger.records[1].history) == 4
    assert ledger.all_home
