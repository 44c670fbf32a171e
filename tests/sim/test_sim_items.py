import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from sim_cases import action, from_ground

from malipp_field.sim.items import RefusedItemError, item_of, stored
from malipp_field.vehicle.items import MissionItem
from malipp_field.vehicle.steps import Action

MISSION, FENCE, RALLY = 0, 1, 2
WAYPOINT = MissionItem(3, 3, 16, 1, 0, 0.0, 0.0, 0.0, 0.0, 340219000, -1182870000, 1.239)
SCRIPT = action(Action.COLLECT, stop=2, tag=17)
single = st.floats(-1e6, 1e6, width=32)


def refusal(item: MissionItem, mission_type: int = MISSION) -> int:
    with pytest.raises(RefusedItemError) as refused:
        stored(item, mission_type)
    return refused.value.result


def test_a_waypoint_keeps_whole_seconds_of_hold_and_centimetres_of_altitude() -> None:
    kept = stored(WAYPOINT._replace(param1=3.9, param2=5.0, param3=1.0, param4=math.nan), MISSION)
    assert kept == MissionItem(3, 3, 16, 0, 1, 3.0, 0.0, 0.0, 0.0, 340219000, -1182870000, 1.24)


def test_a_script_item_is_cut_to_its_bytes() -> None:
    item = SCRIPT._replace(param1=258.0, param2=300.0, param3=2049.0, param4=0.1, x=40000, y=-40000, z=5.0)
    kept = stored(item, MISSION)
    assert (kept.param1, kept.param2, kept.param3) == (2.0, 44.0, 2048.0)
    assert kept.param4 == float(np.float16(0.1))
    assert (kept.x, kept.y, kept.z, kept.frame) == (40000 - 65536, 65536 - 40000, 0.0, 0)


def test_what_our_own_steps_need_comes_back_unharmed() -> None:
    for what in (Action.WAIT, Action.COLLECT, Action.DROP, Action.PICK, Action.UNLOAD):
        item = action(what, stop=40, tag=32767)
        kept = stored(item, MISSION)
        assert kept[5:] == item[5:]


def test_a_servo_is_not_range_checked() -> None:
    item = WAYPOINT._replace(command=183, param1=9.0, param2=99999.0)
    assert stored(item, MISSION).param2 == 34463.0


@pytest.mark.parametrize(("frame", "back"), [(0, 0), (5, 0), (2, 0), (3, 3), (6, 3), (10, 10), (11, 10)])
def test_frames_come_back_as_0_3_or_10(frame: int, back: int) -> None:
    assert stored(WAYPOINT._replace(frame=frame), MISSION).frame == back


@pytest.mark.parametrize("number", [1, 2, 3, 4])
def test_nan_is_refused_but_in_param_4_of_16_and_17(number: int) -> None:
    nan: dict[str, Any] = {f"param{number}": math.nan}
    assert refusal(SCRIPT._replace(**nan)) == mavlink.MAV_MISSION_INVALID_PARAM1 + number - 1
    for command in (16, 17):
        item = WAYPOINT._replace(command=command, **nan)
        if number == 4:
            assert stored(item, MISSION).param4 == 0.0
        else:
            assert refusal(item) == mavlink.MAV_MISSION_INVALID_PARAM1 + number - 1


def test_the_reason_of_a_refusal_is_named() -> None:
    assert refusal(WAYPOINT._replace(frame=1)) == mavlink.MAV_MISSION_UNSUPPORTED_FRAME
    assert refusal(WAYPOINT._replace(command=85)) == mavlink.MAV_MISSION_UNSUPPORTED
    assert refusal(WAYPOINT._replace(x=910000000)) == mavlink.MAV_MISSION_INVALID_PARAM5_X
    assert refusal(WAYPOINT._replace(y=-1810000000)) == mavlink.MAV_MISSION_INVALID_PARAM6_Y
    assert refusal(WAYPOINT._replace(z=math.nan)) == mavlink.MAV_MISSION_INVALID_PARAM7
    assert refusal(WAYPOINT._replace(z=40000.0)) == mavlink.MAV_MISSION_INVALID_PARAM7


def test_fence_and_rally_take_their_own_items_only() -> None:
    vertex = WAYPOINT._replace(command=mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION, param1=4.0)
    assert stored(vertex, FENCE).param1 == 4.0
    assert refusal(vertex, RALLY) == mavlink.MAV_MISSION_UNSUPPORTED
    assert refusal(WAYPOINT, FENCE) == mavlink.MAV_MISSION_UNSUPPORTED


def test_legacy_items_lose_decimetres_of_latitude_and_longitude() -> None:
    legacy = mavlink.MAVLink_mission_item_message(
        1, 1, 3, 3, 16, 0, 1, 0.0, 0.0, 0.0, 0.0, 34.0219, -118.287, 0.0
    )
    item = item_of(from_ground(legacy))
    assert item.x == pytest.approx(340219000, abs=20)
    assert item.y == pytest.approx(-1182870000, abs=40)
    script = mavlink.MAVLink_mission_item_message(1, 1, 3, 2, 42702, 0, 1, 2.0, 0.0, 0.0, 0.0, 17.0, 0.0, 0.0)
    assert item_of(from_ground(script)).x == 17


@given(
    st.sampled_from([16, 17, 19, 20, 93, 112, 181, 183, 211, 217, 42600, 42702]),
    st.tuples(single, single, single, single),
    st.integers(-900000000, 900000000),
    st.integers(-1800000000, 1800000000),
)
def test_what_was_stored_once_is_stored_the_same_again(
    command: int, params: tuple[float, float, float, float], x: int, y: int
) -> None:
    kept = stored(MissionItem(1, 0, command, 0, 1, *params, x, y, 0.0), MISSION)
    assert stored(kept, MISSION) == kept
