"""Missions with every kind of payload hardware and gate, for hypothesis."""

from __future__ import annotations

from typing import Any

from hypothesis import strategies as st
from vehicle_cases import ROBOTS, small_mission

from malipp_field.mission import Mission

CONFIRMED = st.sampled_from(["progress", "operator"])
DURATION_S = st.sampled_from([0.1, 2.5, 20.0, 3600.0]) | st.floats(0.01, 3600.0)
SERVO = {"by": st.just("servo"), "channel": st.integers(1, 32), "pwm_us": st.integers(500, 2500)}
RELAY = {"by": st.just("relay"), "relay": st.integers(0, 15)}
GRIPPER = {
    "by": st.just("gripper"),
    "gripper": st.integers(1, 8),
    "move": st.sampled_from(["grab", "release"]),
}
TIMED = {"duration_s": DURATION_S, "confirm": CONFIRMED}
MEANS: st.SearchStrategy[dict[str, Any]] = st.one_of(
    st.just({"by": "script"}),
    st.just({"by": "manual"}),
    st.fixed_dictionaries(SERVO | TIMED, optional={"rest_us": st.integers(500, 2500)}),
    st.fixed_dictionaries(RELAY | TIMED),
    st.fixed_dictionaries(GRIPPER | TIMED),
)
VEHICLE = st.fixed_dictionaries(
    {
        "payload": st.sampled_from(["script", "manual"])
        | st.fixed_dictionaries(dict.fromkeys(("collect", "drop", "pick", "unload"), MEANS)),
        "gate": st.sampled_from(["custody", "time"]),
        "gate_margin_s": st.sampled_from([0.0, 30.0, 3000.5]),
        "if_missing": st.sampled_from(["hold", "go_on"]),
    }
)
START_S = st.none() | st.integers(1_700_000_000, 1_900_000_000).map(float)
FENCE = [
    {"x_m": x_m, "y_m": y_m} for x_m, y_m in ((-20.0, -40.0), (220.0, -40.0), (220.0, 90.0), (-20.0, 90.0))
]


@st.composite
def equipped_missions(draw: st.DrawFn) -> Mission:
    """Draw the small mission with hardware for each robot, with a fence or without."""
    record = small_mission().model_dump(mode="json", by_alias=True, exclude_none=True)
    record["vehicles"] = {robot: draw(VEHICLE) for robot in ROBOTS}
    if draw(st.booleans()):
        record["site"]["fence"] = FENCE
    return Mission.model_validate(record)
