"""Custody is conserved: nothing appears, nothing vanishes, nothing is in two hands."""

from __future__ import annotations

import pytest
from control_cases import confirm
from hypothesis import given
from hypothesis import strategies as st

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
