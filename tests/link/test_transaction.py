"""New missions for a whole team or for nobody, whatever goes wrong with one vehicle of it."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest
from link_cases import framed
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from transaction_cases import FENCE, MISSION, NEW, NEW_LENGTH, OLD_LENGTH, RALLY, ROBOTS, TEAM, Field

from malipp_field.link.compare import differences
from malipp_field.vehicle.fence import fence_items, rally_items


@pytest.mark.parametrize("loss", [0.0, 0.1, 0.25])
def test_all_get_theirs_and_it_is_told_how_far_it_is(loss: float) -> None:
    async def scene(field: Field) -> None:
        transaction = field.transaction()
        assert await field.carry_out(transaction), [member.words for member in transaction.members]
        assert field.aboard == ["new"] * 3
        if not loss:
            assert {radio.uplinks for radio in field.radios.values()} == {MESSAGES}
        assert {member.words for member in transaction.members} == {
            "has its new mission, read back and compared"
        }
        assert ("carrier", f"mission upload {NEW_LENGTH}/{NEW_LENGTH}") in field.said
        assert ("spare", f"mission read back {NEW_LENGTH}/{NEW_LENGTH}") in field.said

    Field(seed=3, loss=loss).run(scene)


def test_fence_and_rally_points_go_with_the_mission() -> None:
    async def scene(field: Field) -> None:
        assert TEAM.site.origin is not None
        fence, rally = fence_items(TEAM, TEAM.site.origin), rally_items(TEAM, TEAM.site.origin, "scout")
        assert await field.carry_out(field.transaction(wanted={MISSION: NEW, FENCE: fence, RALLY: rally}))
        for radio in field.radios.values():
            stores = radio.rover._stores
            assert differences(fence, stores[FENCE].items, home=False) == []
            assert differences(rally, stores[RALLY].items, home=False) == []
        assert field.aboard == ["new"] * 3

    Field().run(scene)


def test_what_is_there_already_is_not_sent_again() -> None:
    async def scene(field: Field) -> None:
        assert await field.carry_out(field.transaction())
        field.said.clear()
        assert await field.carry_out(field.transaction())
        assert not [words for _, words in field.said if "upload" in words]

    Field().run(scene)


def test_a_vehicle_that_had_got_further_begins_anew() -> None:
    async def scene(field: Field) -> None:
        run = field.radios["scout"].rover.autopilot.run
        run.set_current(4)
        assert await field.carry_out(field.transaction())
        assert run.seq == 1

    Field().run(scene)


def test_a_vehicle_that_had_got_further_and_now_stays_is_emptied() -> None:
    async def scene(field: Field) -> None:
        for radio in field.radios.values():
            assert radio.rover.autopilot.run.set_current(3)
        assert await field.carry_out(field.transaction(wanted={MISSION: NEW[:1]})), field.said
        assert all(len(radio.rover.autopilot.store.items) <= 1 for radio in field.radios.values())

    Field().run(scene)


@pytest.mark.parametrize("hold", [False, True])
def test_a_vehicle_that_drives_is_refused_or_held(hold: bool) -> None:
    async def scene(field: Field) -> None:
        autopilot = field.radios["carrier"].rover.autopilot
        assert autopilot.arm()
        assert autopilot.set_mode(mavlink.ROVER_MODE_AUTO)
        await field.live(2.0)
        transaction = field.transaction(hold=hold)
        assert await field.carry_out(transaction) is hold
        assert field.aboard == ["new" if hold else "old"] * 3
        if hold:
            field.check(transaction)
        else:
            assert autopilot.mode == mavlink.ROVER_MODE_AUTO  # not ours to stop
            assert "it is in AUTO, where it may drive" in transaction.members[1].words

    Field().run(scene)


@pytest.mark.parametrize(
    ("ahead_s", "words"),
    [(-3600.0, "its clock is 3600 s behind this computer's"), (None, "does not know the time of day")],
)
def test_gates_by_time_are_only_sent_where_all_clocks_agree(ahead_s: float | None, words: str) -> None:
    """One clock that is wrong, and nobody is stopped or given anything."""

    async def scene(field: Field) -> None:
        driving = field.radios["scout"].rover.autopilot
        assert driving.arm()
        assert driving.set_mode(mavlink.ROVER_MODE_AUTO)
        field.radios["carrier"].rover._telemetry._builders[mavlink.MAVLINK_MSG_ID_SYSTEM_TIME] = (
            lambda now_s: mavlink.MAVLink_system_time_message(
                0 if ahead_s is None else int((now_s + ahead_s) * 1e6), 0
            )
        )
        await field.live(3.0)
        sent = {robot: radio.uplinks for robot, radio in field.radios.items()}
        transaction = field.transaction(hold=True)
        for member in transaction.members:
            member.keeps_time = True
        assert not await field.carry_out(transaction)
        assert words in transaction.members[1].words
        assert {robot: radio.uplinks for robot, radio in field.radios.items()} == sent
        assert driving.mode == mavlink.ROVER_MODE_AUTO
        assert {member.words for member in transaction.members[::2]} == {"has what it had"}

    Field().run(scene)


@pytest.mark.parametrize("seq", [1, 4])
def test_one_refusal_puts_all_back_on_what_they_had(seq: int) -> None:
    async def scene(field: Field) -> None:
        store = field.radios["carrier"].rover.autopilot.store
        honest = store.receive

        def receive(message: Any, sender: Any, now_s: float) -> list[Any]:
            if message.get_type() == "MISSION_ITEM_INT" and message.seq == seq and message.x == NEW[seq].x:
                message.param1 = float("nan")
            return honest(message, sender, now_s)

        store.receive = receive  # type: ignore[method-assign]
        field.radios["scout"].rover.autopilot.run.set_current(4)
        transaction = field.transaction()
        assert not await field.carry_out(transaction)
        assert field.aboard == ["old"] * 3
        assert field.radios["scout"].rover.autopilot.run.seq == 4
        field.check(transaction)
        words = [member.words for member in transaction.members]
        assert words[0] == words[2] == "has what it had"
        assert words[1].startswith(
            f"has what it had (item {seq} (NAV_WAYPOINT) was refused (MAV_MISSION_INVALID"
        )

    Field().run(scene)


def test_a_full_store_leaves_all_as_they_were() -> None:
    async def scene(field: Field) -> None:
        field.radios["spare"].rover.autopilot.store.max_items = 4
        transaction = field.transaction()
        assert not await field.carry_out(transaction)
        assert field.aboard[:2] == ["old", "old"]
        assert "MAV_MISSION_NO_SPACE" in transaction.members[2].words

    Field().run(scene)


MESSAGES = 22
"""Of the ground to one vehicle on a good link: snapshot, upload and read-back."""


@pytest.mark.parametrize("cut_at", range(MESSAGES - 1))
def test_a_link_cut_at_any_message(cut_at: int) -> None:
    """One of three is lost; the others get back what they had. What is said of the one is so."""

    async def scene(field: Field) -> None:
        radio = field.radios["carrier"]
        radio.cut_at = cut_at
        transaction = field.transaction()
        assert not await field.carry_out(transaction)
        field.check(transaction)
        assert [field.aboard[0], field.aboard[2]] == ["old", "old"]
        lost = transaction.members[1]
        assert any(words in lost.fault for words in ("does not answer", "not heard", "does not report"))
        if lost.state == "unknown":
            assert "is not known; as far as is known it stands; do not start it" in lost.words

    Field().run(scene)


@pytest.mark.parametrize("after_s", [0.0, 0.3, 0.7, 0.9, 1.1, 1.3, 1.6, 2.2])
def test_broken_off_it_gives_back_what_it_touched(after_s: float) -> None:
    async def scene(field: Field) -> None:
        transaction = field.transaction()
        task = asyncio.create_task(transaction.run())
        await field.live(after_s)
        if task.done():
            assert after_s > 2.0
            return
        task.cancel()
        await field.finish(task)
        assert task.cancelled()
        field.check(transaction)
        assert field.aboard == ["old"] * 3
        assert {member.state for member in transaction.members} == {"had"}

    Field().run(scene)


def test_broken_off_twice_it_says_of_whom_nothing_is_known() -> None:
    async def scene(field: Field) -> None:
        transaction = field.transaction()
        task = asyncio.create_task(transaction.run())
        while not any(member.state == "unknown" for member in transaction.members):
            await field.live()
        await field.live(0.2)
        for _ in range(2):
            task.cancel()
            await field.live(0.1)
        assert task.cancelled()
        field.check(transaction)
        assert {member.state for member in transaction.members} == {"unknown"}

    Field().run(scene)


@pytest.mark.parametrize("robot", ROBOTS)
def test_a_restart_in_the_middle(robot: str) -> None:
    async def scene(field: Field) -> None:
        radio = field.radios[robot]
        transaction = field.transaction()
        task = asyncio.create_task(transaction.run())
        while not radio.rover.autopilot.store.receiving:
            await field.live()
        radio.rover.reboot(field.clock.now_s())
        await field.finish(task)
        field.check(transaction)
        assert field.aboard in (["new"] * 3, ["old"] * 3)

    Field().run(scene)


def test_another_station_on_one_vehicle_delays_all() -> None:
    async def scene(field: Field) -> None:
        stranger = framed(mavlink.MAVLink_mission_count_message(2, 1, OLD_LENGTH), 245, 190)
        field.radios["carrier"].rover.receive(stranger, "stranger", field.clock.now_s())
        transaction = field.transaction()
        assert await field.carry_out(transaction), [member.words for member in transaction.members]
        field.check(transaction)

    Field().run(scene)
