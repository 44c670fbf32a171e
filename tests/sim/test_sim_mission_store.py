"""The vehicle's side of the mission protocol, against a scripted client and a bad link."""

from __future__ import annotations

import math
import random
from dataclasses import dataclass, field
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from sim_cases import ground_for, item_int, numbered, of, site, waypoint

from malipp_field.sim import RoverConfig
from malipp_field.sim.mission_store import MAX_ITEMS, FenceStore, MissionStore, Sender
from malipp_field.vehicle.fence import MAX_RALLY_POINTS
from malipp_field.vehicle.items import MissionItem

US = Sender(255, 190)
STRANGER = Sender(254, 190)
HOME = MissionItem(0, 0, 16, 0, 1, 0.0, 0.0, 0.0, 0.0, 340000000, -1180000000, 60.0)


def new_store() -> MissionStore:
    return MissionStore(home=lambda: HOME)


def mission(count: int, lat_e7: int = 340000000) -> list[MissionItem]:
    return [
        MissionItem(i, 3, 16, 0, 1, 0.0, 0.0, 0.0, 0.0, lat_e7 + i, -1180000000, 0.0) for i in range(count)
    ]


def count(n: int, mission_type: int = 0) -> Any:
    return mavlink.MAVLink_mission_count_message(1, 1, n, mission_type)


def results(messages: list[Any]) -> list[int]:
    return [m.type for m in of(messages, "MISSION_ACK")]


def asked(messages: list[Any]) -> list[int]:
    return [m.seq for m in of(messages, "MISSION_REQUEST")]


def upload(store: MissionStore, items: list[MissionItem], now_s: float = 0.0) -> list[Any]:
    """Upload over a perfect link and return the last answers."""
    answers = store.receive(count(len(items)), US, now_s)
    while asked(answers):
        answers = store.receive(item_int(items[asked(answers)[-1]]), US, now_s)
    return answers


def download(store: MissionStore) -> list[Any]:
    (answer,) = store.receive(mavlink.MAVLink_mission_request_list_message(1, 1), US, 0.0)
    requests = [mavlink.MAVLink_mission_request_int_message(1, 1, seq) for seq in range(answer.count)]
    return [store.receive(request, US, 0.0)[0] for request in requests]


def test_a_mission_comes_back_with_home_first() -> None:
    store = new_store()
    assert results(upload(store, mission(4))) == [mavlink.MAV_MISSION_ACCEPTED]
    back = download(store)
    assert [m.seq for m in back] == [0, 1, 2, 3]
    assert (back[0].x, back[0].z, back[0].frame) == (HOME.x, 60.0, 0)
    assert [m.x - 340000000 for m in back[1:]] == [1, 2, 3]
    assert {m.autocontinue for m in back} == {1}


def test_items_are_asked_for_with_the_deprecated_request() -> None:
    answers = new_store().receive(count(3), US, 0.0)
    assert [m.get_msgId() for m in answers] == [40]
    assert (answers[0].target_system, answers[0].target_component) == (255, 190)


def test_the_count_truncates_before_any_item_arrives() -> None:
    store = new_store()
    upload(store, mission(6))
    store.receive(count(3), US, 0.0)
    assert len(store.items) == 3
    assert store.items[1].x == 340000001


def test_a_longer_count_truncates_nothing() -> None:
    store = new_store()
    upload(store, mission(3))
    store.receive(count(6), US, 0.0)
    assert len(store.items) == 3


def test_a_refused_item_leaves_a_mixed_mission() -> None:
    store = new_store()
    upload(store, mission(6))
    new = mission(6, lat_e7=350000000)
    new[3] = new[3]._replace(param1=math.nan)
    assert results(upload(store, new)) == [mavlink.MAV_MISSION_INVALID_PARAM1]
    assert [item.x // 10000000 for item in store.items[1:]] == [35, 35, 34, 34, 34]
    assert not store.receiving


def test_one_item_to_an_empty_mission_becomes_home_and_the_item() -> None:
    store = new_store()
    assert results(upload(store, mission(1, lat_e7=350000000))) == [mavlink.MAV_MISSION_ACCEPTED]
    assert [m.x for m in download(store)] == [HOME.x, 350000000]


def test_duplicate_and_late_items_do_not_end_the_transfer() -> None:
    store, items = new_store(), mission(3)
    store.receive(count(3), US, 0.0)
    store.receive(item_int(items[0]), US, 0.1)
    assert results(store.receive(item_int(items[0]), US, 0.2)) == [mavlink.MAV_MISSION_INVALID_SEQUENCE]
    assert results(store.receive(item_int(items[2]), US, 0.2)) == [mavlink.MAV_MISSION_INVALID_SEQUENCE]
    assert asked(store.receive(item_int(items[1]), US, 0.3)) == [2]
    assert results(store.receive(item_int(items[2]), US, 0.4)) == [mavlink.MAV_MISSION_ACCEPTED]
    assert results(store.receive(item_int(items[2]), US, 0.5)) == [mavlink.MAV_MISSION_ERROR]
    assert [item.x - 340000000 for item in store.items[1:]] == [1, 2]


def test_another_uploader_is_denied_and_does_no_harm() -> None:
    store, items = new_store(), mission(2)
    store.receive(count(2), US, 0.0)
    assert results(store.receive(count(5), STRANGER, 0.1)) == [mavlink.MAV_MISSION_DENIED]
    assert results(store.receive(item_int(items[0]), STRANGER, 0.1)) == [mavlink.MAV_MISSION_DENIED]
    listing = mavlink.MAVLink_mission_request_list_message(1, 1)
    assert results(store.receive(listing, STRANGER, 0.1)) == [mavlink.MAV_MISSION_DENIED]
    store.receive(item_int(items[0]), US, 0.2)
    assert results(store.receive(item_int(items[1]), US, 0.3)) == [mavlink.MAV_MISSION_ACCEPTED]


def test_the_uploader_may_begin_again() -> None:
    store, items = new_store(), mission(3)
    store.receive(count(3), US, 0.0)
    store.receive(item_int(items[0]), US, 0.1)
    assert asked(store.receive(count(3), US, 0.2)) == [0]
    assert results(upload(store, items, 0.3)) == [mavlink.MAV_MISSION_ACCEPTED]


def test_a_request_is_repeated_after_a_second_and_the_upload_given_up_after_eight() -> None:
    store = new_store()
    store.receive(count(3), US, 0.0)
    said = {t / 10: store.poll(t / 10) for t in range(1, 120)}
    times = {t: m[0].get_type() for t, m in said.items() if m}
    assert list(times.values()) == ["MISSION_REQUEST"] * 7 + ["MISSION_ACK"]
    gaps = [b - a for a, b in zip([0.0, *times], times, strict=False)]
    assert max(gaps[:-1]) == pytest.approx(1.1)
    assert list(times)[-1] == pytest.approx(8.1)
    assert results(said[8.1]) == [mavlink.MAV_MISSION_OPERATION_CANCELLED]
    assert not store.receiving
    assert asked(store.receive(count(3), STRANGER, 9.0)) == [0]


def test_every_item_that_arrives_buys_eight_more_seconds() -> None:
    store, items = new_store(), mission(3)
    store.receive(count(3), US, 0.0)
    store.receive(item_int(items[0]), US, 7.9)
    assert asked(store.poll(15.8)) == [1]
    assert results(store.poll(16.0)) == [mavlink.MAV_MISSION_OPERATION_CANCELLED]


def test_there_is_room_for_655_items() -> None:
    store = new_store()
    assert results(store.receive(count(MAX_ITEMS + 1), US, 0.0)) == [mavlink.MAV_MISSION_NO_SPACE]
    assert results(upload(store, mission(655))) == [mavlink.MAV_MISSION_ACCEPTED]
    assert len(store.items) == 655


def test_how_many_items_there_is_room_for_may_be_configured() -> None:
    ground = ground_for(site(), config=RoverConfig(max_items=4))
    world = ground.rover.world
    items = numbered(world, [waypoint(world, "a")] * 4)
    assert ground.upload(items) == mavlink.MAV_MISSION_NO_SPACE
    assert ground.upload(items[:4]) == mavlink.MAV_MISSION_ACCEPTED


def test_rally_points_come_back_as_they_were_sent_but_for_whole_metres_of_height() -> None:
    store = MissionStore(mavlink.MAV_MISSION_TYPE_RALLY, max_items=MAX_RALLY_POINTS)
    point = mission(1)[0]._replace(command=mavlink.MAV_CMD_NAV_RALLY_POINT, z=3.9)
    assert results(upload_typed(store, [point], 2)) == [mavlink.MAV_MISSION_ACCEPTED]
    assert store.items == [point._replace(z=3.0)]
    absolute = point._replace(frame=mavlink.MAV_FRAME_GLOBAL)
    assert results(upload_typed(store, [absolute], 2)) == [mavlink.MAV_MISSION_UNSUPPORTED_FRAME]


def test_a_fence_is_taken_over_whole_or_not_at_all() -> None:
    store = FenceStore()
    command = mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_EXCLUSION
    corners = [item._replace(frame=0, command=command, param1=3.0) for item in mission(3)]
    assert results(upload_typed(store, corners, 1)) == [mavlink.MAV_MISSION_ACCEPTED]
    store.receive(count(2, 1), US, 0.0)  # unlike that of a mission, this count truncates nothing
    assert store.items == corners
    for broken in (corners[:2], [corners[0]._replace(param1=4.0), *corners[1:]]):
        assert results(upload_typed(store, broken, 1)) == [mavlink.MAV_MISSION_ERROR]
        assert store.items == corners


def upload_typed(store: MissionStore, items: list[MissionItem], mission_type: int) -> list[Any]:
    answers = store.receive(count(len(items), mission_type), US, 0.0)
    while asked(answers):
        answers = store.receive(item_int(items[asked(answers)[-1]], mission_type), US, 0.0)
    return answers


@pytest.mark.parametrize("clear", [count(0), mavlink.MAVLink_mission_clear_all_message(1, 1)])
def test_a_count_of_zero_clears_as_clear_all_does(clear: Any) -> None:
    store = new_store()
    upload(store, mission(4))
    assert results(store.receive(clear, US, 0.0)) == [mavlink.MAV_MISSION_ACCEPTED]
    assert download(store) == []


def test_a_running_mission_is_not_cleared() -> None:
    store = new_store()
    upload(store, mission(4))
    store.running = True
    answers = store.receive(mavlink.MAVLink_mission_clear_all_message(1, 1), US, 0.0)
    assert results(answers) == [mavlink.MAV_MISSION_ERROR]
    assert len(store.items) == 4


def test_a_number_beyond_the_end_is_answered_with_the_count() -> None:
    store = new_store()
    upload(store, mission(2))
    answers = store.receive(mavlink.MAVLink_mission_request_message(1, 1, 2), US, 0.0)
    assert [m.count for m in of(answers, "MISSION_COUNT")] == [2]
    assert results(answers) == [mavlink.MAV_MISSION_INVALID_SEQUENCE]


def test_both_requests_are_answered_with_the_integer_item() -> None:
    store = new_store()
    upload(store, mission(2))
    for request in (mavlink.MAVLink_mission_request_message, mavlink.MAVLink_mission_request_int_message):
        assert [m.get_msgId() for m in store.receive(request(1, 1, 1), US, 0.0)] == [73]


def test_partial_writes_are_refused() -> None:
    partial = mavlink.MAVLink_mission_write_partial_list_message(1, 1, 1, 2)
    assert results(new_store().receive(partial, US, 0.0)) == [mavlink.MAV_MISSION_UNSUPPORTED]


@dataclass
class BadLink:
    """Carries messages late, twice, in the wrong order or not at all."""

    rng: random.Random
    loss: float
    under_way: list[tuple[float, Any]] = field(default_factory=list)

    def send(self, message: Any, now_s: float) -> None:
        for _ in range(2 if self.rng.random() < 0.2 else 1):
            if self.rng.random() >= self.loss:
                self.under_way.append((now_s + self.rng.choice([0.02, 0.05, 0.3, 1.2]), message))

    def arrived(self, now_s: float) -> list[Any]:
        here = [message for due_s, message in self.under_way if due_s <= now_s]
        self.under_way = [entry for entry in self.under_way if entry[0] > now_s]
        return here


def upload_over(link_up: BadLink, link_down: BadLink, store: MissionStore, items: list[MissionItem]) -> float:
    """Be a patient client: repeat the count until a request comes, then answer every request."""
    now_s, said_s, requested = 0.0, -math.inf, False
    while now_s < 600.0:
        now_s += 0.02
        if not requested and now_s - said_s >= 1.5:
            link_up.send(count(len(items)), now_s)
            said_s = now_s
        for message in link_up.arrived(now_s):
            for answer in store.receive(message, US, now_s):
                link_down.send(answer, now_s)
        for answer in store.poll(now_s):
            link_down.send(answer, now_s)
        for message in link_down.arrived(now_s):
            if message.get_type() == "MISSION_REQUEST":
                requested = True
                link_up.send(item_int(items[message.seq]), now_s)
            elif message.type == mavlink.MAV_MISSION_ACCEPTED:
                return now_s
            elif message.type == mavlink.MAV_MISSION_OPERATION_CANCELLED:
                requested = False
        complete = len(store.items) == len(items) and store.items[-1].x == items[-1].x
        if complete and not store.receiving:
            return now_s  # its acknowledgement was lost: a download would tell
    raise AssertionError("no end in ten minutes")


@pytest.mark.parametrize("seed", range(12))
def test_a_bad_link_delays_an_upload_but_never_damages_it(seed: int) -> None:
    rng = random.Random(seed)
    loss = [0.0, 0.1, 0.3, 0.4][seed % 4]
    store, items = new_store(), mission(15, lat_e7=350000000)
    upload(store, mission(20))
    upload_over(BadLink(rng, loss), BadLink(rng, loss), store, items)
    assert [item.x for item in store.items[1:]] == [item.x for item in items[1:]]
