from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from typing import Any

import pytest
from link_cases import (
    GROUND,
    SYSTEM,
    MissionVehicle,
    SpecVehicle,
    ack,
    ardupilot,
    converse,
    framed,
    from_ground,
    ids,
    mission_items,
)
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from malipp_field.link.compare import differences
from malipp_field.link.mission_protocol import MissionClear, MissionDownload, MissionType, MissionUpload
from malipp_field.link.parameters import ParameterRead
from malipp_field.sim.mission_store import FenceStore, MissionStore, Sender
from malipp_field.vehicle.items import MissionItem

VEHICLES: list[Callable[[], MissionVehicle]] = [ardupilot, SpecVehicle]


def old_mission(make: Callable[[], MissionVehicle]) -> MissionVehicle:
    """A vehicle that holds another mission already."""
    vehicle = make()
    assert converse_upload(vehicle, 5).done
    return vehicle


def converse_upload(vehicle: MissionVehicle, count: int) -> MissionUpload:
    upload = MissionUpload(mission_items(count), SYSTEM)
    converse(upload, vehicle, bad=False)
    return upload


@pytest.mark.parametrize("make", VEHICLES)
@pytest.mark.parametrize("loss", [0.0, 0.1, 0.25, 0.4])
def test_upload_and_download_over_a_bad_link(make: Callable[[], MissionVehicle], loss: float) -> None:
    succeeded = 0
    for seed in range(25):
        vehicle = old_mission(make)
        items = mission_items(3 + seed % 12)
        upload = MissionUpload(items, SYSTEM)
        converse(upload, vehicle, seed=seed, loss=loss)
        assert upload.done is (upload.failure is None)
        if not upload.done:
            assert upload.failure
            continue
        assert differences(items, vehicle.items) == []
        assert upload.progress == (len(items), len(items))
        download = MissionDownload(SYSTEM)
        converse(download, vehicle, seed=seed + 500, loss=loss, start_s=2000.0)
        assert download.done, download.failure
        assert differences(items, download.items) == []
        succeeded += 1
    assert succeeded >= (25 if loss < 0.4 else 20)


@pytest.mark.parametrize("make", VEHICLES)
def test_no_time_is_lost_on_a_good_link(make: Callable[[], MissionVehicle]) -> None:
    vehicle = make()
    assert converse(MissionUpload(mission_items(30), SYSTEM), vehicle, bad=False) < 30 * 0.2
    assert converse(MissionDownload(SYSTEM), vehicle, bad=False) < 30 * 0.2


@pytest.mark.parametrize("make", VEHICLES)
def test_on_a_slow_link_several_items_are_asked_for_at_a_time_and_each_once(
    make: Callable[[], MissionVehicle],
) -> None:
    vehicle, asked = make(), Counter[int]()
    converse(MissionUpload(mission_items(41), SYSTEM), vehicle, bad=False)

    class Counting(MissionDownload):
        def _request(self, seq: int, now_s: float) -> Any:
            asked[seq] += 1
            return super()._request(seq, now_s)

    download = Counting(SYSTEM)
    took_s = converse(download, vehicle, bad=False, late_s=0.2)
    assert differences(mission_items(41), download.items) == []
    assert took_s < 0.4 * (1 + 41 / 2)  # one after the other: 0.4 s each
    assert asked == Counter(range(41))


@pytest.mark.parametrize("make", VEHICLES)
def test_a_link_cut_at_any_message_ends_in_a_failure_that_says_so(make: Callable[[], MissionVehicle]) -> None:
    for cut in range(8):
        upload = MissionUpload(mission_items(6), SYSTEM)
        took_s = converse(upload, old_mission(make), bad=False, cut_after=cut)
        assert not upload.done
        assert "does not answer MISSION_COUNT" in (upload.failure or "")
        assert 10.0 <= took_s < 30.0
        download = MissionDownload(SYSTEM)
        took_s = converse(download, old_mission(make), bad=False, cut_after=min(cut, 5))
        assert "does not answer" in (download.failure or "")
        assert 10.0 <= took_s < 30.0


@pytest.mark.parametrize("seq", [1, 4, 5])
def test_a_refused_item_is_named(seq: int) -> None:
    vehicle = SpecVehicle(refuse={seq: mavlink.MAV_MISSION_INVALID_PARAM1})
    upload = MissionUpload(mission_items(6), SYSTEM)
    converse(upload, vehicle, seed=seq, loss=0.2)
    assert not upload.done
    assert upload.failure is not None
    assert upload.failure.startswith(f"item {seq} (NAV_")
    assert "MAV_MISSION_INVALID_PARAM1: param1 has an invalid value" in upload.failure


def test_a_late_request_does_not_confuse_which_item_was_refused() -> None:
    upload = MissionUpload(mission_items(6), SYSTEM)
    upload.start(0.0)
    for seq in (0, 1, 2, 0):
        answer = upload.receive(framed(mavlink.MAVLink_mission_request_message(*ids(), seq)), 0.1)
        assert [message.seq for message in answer] == [seq]
    assert [message.seq for message in upload.tick(0.4)] == [2]
    upload.receive(framed(ack(mavlink.MAV_MISSION_INVALID_PARAM5_X)), 0.5)
    assert "item 2 (NAV_" in (upload.failure or "")


def test_ardupilot_refuses_nan_and_keeps_a_mixed_mission() -> None:
    vehicle = old_mission(ardupilot)
    items = mission_items(5)
    items[3] = items[3]._replace(param1=float("nan"))
    upload = MissionUpload(items, SYSTEM)
    converse(upload, vehicle, bad=False)
    assert "item 3" in (upload.failure or "")
    assert "MAV_MISSION_INVALID_PARAM1" in (upload.failure or "")


def test_a_mission_too_large_is_refused_at_once() -> None:
    upload = MissionUpload(mission_items(656), SYSTEM)
    assert converse(upload, ardupilot(), bad=False) < 1.0
    assert "656 items was refused (MAV_MISSION_NO_SPACE" in (upload.failure or "")
    assert converse_upload(ardupilot(), 655).done


@pytest.mark.parametrize("patient", [True, False])
def test_a_second_uploader_waits_its_turn_within_limits(patient: bool) -> None:
    vehicle, other = ardupilot(), Sender(245, 190)
    count = from_ground(mavlink.MAVLink_mission_count_message(SYSTEM, 1, 9))
    vehicle.receive(count, other, 100.0)  # and then says nothing more: ArduPilot gives up after 8 s

    def again(now_s: float) -> None:
        if not patient:
            vehicle.receive(count, other, now_s)

    upload = MissionUpload(mission_items(4), SYSTEM)
    took_s = converse(upload, vehicle, bad=False, meanwhile=again)
    assert upload.done is patient
    assert 8.0 <= took_s < (12.0 if patient else 40.0)
    if not patient:
        assert "MAV_MISSION_DENIED" in (upload.failure or "")


def test_a_download_waits_while_somebody_uploads() -> None:
    vehicle = old_mission(ardupilot)
    vehicle.receive(from_ground(mavlink.MAVLink_mission_count_message(SYSTEM, 1, 5)), Sender(245, 190), 100.0)
    download = MissionDownload(SYSTEM)
    assert 8.0 < converse(download, vehicle, bad=False) < 12.0
    assert len(download.items) == 5


def test_both_kinds_of_request_get_the_same_item() -> None:
    upload = MissionUpload(mission_items(4), SYSTEM)
    upload.start(0.0)
    answers = [
        upload.receive(framed(kind(*ids(), 0)), 0.1)
        for kind in (mavlink.MAVLink_mission_request_message, mavlink.MAVLink_mission_request_int_message)
    ]
    assert [[m.get_type() for m in messages] for messages in answers] == [["MISSION_ITEM_INT"]] * 2


def test_what_others_say_is_not_heard() -> None:
    upload = MissionUpload(mission_items(1), SYSTEM)
    upload.start(0.0)
    accepted = ack(mavlink.MAV_MISSION_ACCEPTED)
    request = mavlink.MAVLink_mission_request_message(*ids(), 0)
    assert upload.receive(framed(request, system=SYSTEM + 1), 0.1) == []
    assert upload.receive(framed(request, component=191), 0.1) == []
    assert upload.receive(framed(mavlink.MAVLink_mission_request_message(*ids(), 0, 1)), 0.1) == []  # a fence
    assert upload.receive(framed(mavlink.MAVLink_mission_request_message(245, 190, 0)), 0.1) == []
    assert (
        upload.receive(framed(mavlink.MAVLink_mission_request_message(*ids(), 1)), 0.1) == []
    )  # no such item
    upload.receive(framed(accepted), 0.1)
    assert not upload.done  # nothing was given yet: news of an earlier upload
    assert len(upload.receive(framed(request), 0.2)) == 1
    upload.receive(framed(ack(mavlink.MAV_MISSION_ACCEPTED, to=(245, 190))), 0.3)
    assert not upload.done
    upload.receive(framed(accepted), 0.4)
    assert upload.done


@pytest.mark.parametrize(
    "result", [mavlink.MAV_MISSION_INVALID_SEQUENCE, mavlink.MAV_MISSION_DENIED, mavlink.MAV_MISSION_ERROR]
)
def test_errors_that_duplicates_earn_are_not_fatal(result: int) -> None:
    upload = MissionUpload(mission_items(2), SYSTEM)
    upload.start(0.0)
    for seq in (0, 1):
        upload.receive(framed(mavlink.MAVLink_mission_request_message(*ids(), seq)), 0.1)
        upload.receive(framed(ack(result)), 0.2)
    upload.receive(framed(ack(mavlink.MAV_MISSION_ACCEPTED)), 0.3)
    assert upload.done


def test_a_lost_final_acknowledgement_is_made_up_for() -> None:
    vehicle = ardupilot()
    real, withheld = vehicle.receive, [1]

    class Forgetful:
        items = vehicle.items
        poll = staticmethod(vehicle.poll)

        @staticmethod
        def receive(message: object, sender: Sender, now_s: float) -> list[object]:
            answers = real(message, sender, now_s)
            accepted = [m for m in answers if m.get_type() == "MISSION_ACK" and m.type == 0]
            if accepted and withheld:
                withheld.pop()
                return []
            return answers

    upload = MissionUpload(mission_items(4), SYSTEM)
    assert converse(upload, Forgetful(), bad=False) < 5.0
    assert upload.done
    assert differences(mission_items(4), vehicle.items) == []


def test_clear_over_a_bad_link() -> None:
    for make in VEHICLES:
        for seed in range(20):
            vehicle = old_mission(make)
            clear = MissionClear(SYSTEM)
            converse(clear, vehicle, seed=seed, loss=0.3)
            assert clear.done
            assert vehicle.items == []


def test_clear_is_refused_while_the_mission_runs() -> None:
    vehicle = ardupilot()
    vehicle.running = True
    clear = MissionClear(SYSTEM)
    assert 30.0 <= converse(clear, vehicle, bad=False) < 35.0
    assert "MAV_MISSION_ERROR" in (clear.failure or "")


def test_count_of_zero_is_the_same_as_clear() -> None:
    vehicle = old_mission(ardupilot)
    upload = MissionUpload([], SYSTEM)
    converse(upload, vehicle, bad=False)
    assert upload.done
    assert vehicle.items == []
    download = MissionDownload(SYSTEM)
    converse(download, vehicle, bad=False)
    assert download.done
    assert download.items == []


def test_items_must_be_numbered() -> None:
    with pytest.raises(ValueError, match="numbered from 0"):
        MissionUpload(mission_items(4)[1:], SYSTEM)


def test_the_ground_is_whom_the_vehicle_answers() -> None:
    answers = ardupilot().receive(
        from_ground(mavlink.MAVLink_mission_count_message(SYSTEM, 1, 3)), GROUND, 0.0
    )
    assert (answers[0].target_system, answers[0].target_component) == ids()


def corners(count: int, command: int = 5001) -> list[MissionItem]:
    return [
        MissionItem(n, 0, command, 0, 1, float(count), 0.0, 0.0, 0.0, 340000000 + 1000 * n, -1180000000, 0.0)
        for n in range(count)
    ]


RALLY = [item._replace(command=5100, frame=3, param1=0.0) for item in corners(3)]
BESIDE = [
    (MissionType.FENCE, FenceStore, corners(5)),
    (MissionType.RALLY, lambda: MissionStore(mavlink.MAV_MISSION_TYPE_RALLY, max_items=20), RALLY),
]


@pytest.mark.parametrize(("kind", "make", "items"), BESIDE)
@pytest.mark.parametrize("loss", [0.0, 0.3])
def test_fence_and_rally_points_travel_by_the_same_protocol(
    kind: MissionType, make: Callable[[], MissionStore], items: list[MissionItem], loss: float
) -> None:
    for seed in range(8):
        store = make()
        upload = MissionUpload(items, SYSTEM, mission_type=kind)
        converse(upload, store, seed=seed, loss=loss)
        assert upload.done, upload.failure
        download = MissionDownload(SYSTEM, mission_type=kind)
        converse(download, store, seed=seed + 500, loss=loss, start_s=2000.0)
        assert differences(items, download.items, home=False) == []
        clear = MissionClear(SYSTEM, mission_type=kind)
        converse(clear, store, seed=seed + 900, loss=loss, start_s=4000.0)
        assert clear.done
        assert store.items == []


def test_answers_about_another_type_are_not_heard() -> None:
    upload = MissionUpload(corners(3), SYSTEM, mission_type=MissionType.FENCE)
    upload.start(0.0)
    assert upload.receive(framed(mavlink.MAVLink_mission_request_message(*ids(), 0, 0)), 0.1) == []
    (item,) = upload.receive(framed(mavlink.MAVLink_mission_request_message(*ids(), 0, 1)), 0.1)
    assert (item.mission_type, item.command) == (1, 5001)


def test_a_fence_that_is_not_whole_is_refused_and_the_one_before_stays() -> None:
    store = FenceStore()
    converse(MissionUpload(corners(4), SYSTEM, mission_type=MissionType.FENCE), store, bad=False)
    upload = MissionUpload(corners(5)[:4], SYSTEM, mission_type=MissionType.FENCE)
    converse(upload, store, bad=False)
    assert "MAV_MISSION_ERROR" in (upload.failure or "")
    assert differences(corners(4), store.items, home=False) == []


def test_too_many_rally_points_are_refused_by_name() -> None:
    store = MissionStore(mavlink.MAV_MISSION_TYPE_RALLY, max_items=2)
    upload = MissionUpload(RALLY, SYSTEM, mission_type=MissionType.RALLY)
    converse(upload, store, bad=False)
    assert "a rally points upload of 3 items was refused (MAV_MISSION_NO_SPACE" in (upload.failure or "")


def test_a_fence_without_home_is_compared_from_its_first_item() -> None:
    moved = [corners(3)[0]._replace(x=350000000), *corners(3)[1:]]
    assert differences(moved, corners(3)) == []
    (found,) = differences(moved, corners(3), home=False)
    assert found.startswith("item 0 (NAV_FENCE_POLYGON_VERTEX_INCLUSION): its place is")


def read(name: str, value: float, index: int = 0) -> Any:
    return framed(mavlink.MAVLink_param_value_message(name.encode(), value, 9, 30, index))


def test_a_parameter_is_asked_for_by_all_its_names_until_one_is_answered() -> None:
    asking = ParameterRead(("MAV_GCS_SYSID", "SYSID_MYGCS"), SYSTEM)
    assert [m.param_id for m in asking.start(0.0)] == ["MAV_GCS_SYSID", "SYSID_MYGCS"]
    assert asking.receive(read("FS_ACTION", 2.0), 0.1) == []
    assert not asking.ended
    assert len(asking.tick(1.6)) == 2
    asking.receive(read("SYSID_MYGCS", 255.0), 1.7)
    assert (asking.done, asking.value) == (True, 255.0)


def test_a_parameter_that_is_not_there_is_named() -> None:
    asking = ParameterRead(("FS_GCS_TIMEOUT",), SYSTEM)
    asking.start(0.0)
    for tenth in range(1, 200):
        asking.tick(tenth / 10)
    assert asking.failure == f"vehicle {SYSTEM} does not tell its parameter FS_GCS_TIMEOUT"
