"""Gates by time allow for the margins of those before them: what is waited for is there when they open."""

from __future__ import annotations

from typing import Any

import pytest
from vehicle_cases import plan_of, small_mission, stop

from malipp_field.mission import Mission
from malipp_field.mission.vehicles import VehicleSettings
from malipp_field.vehicle.gate_times import GateTime, gate_times

RELAY = {"by": "relay", "relay": 0, "duration_s": 1.0}
MARGIN_S = 30.0


def timed(**payloads: Any) -> Mission:
    """Return the small mission, in which these robots keep gates by time."""
    vehicles = {
        robot: VehicleSettings.model_validate({"gate": "time", "gate_margin_s": MARGIN_S, "payload": payload})
        for robot, payload in payloads.items()
    }
    return small_mission().model_copy(update={"vehicles": vehicles})


CHAIN = plan_of(
    {
        "scout": [
            stop("base", 0.0),
            stop("a", 50.0, payload=1, path=("base", "a"), collect=2, drop={"scout2": 1}),
            stop("b", 90.0, path=("a", "b"), drop={"scout2": 1}),
        ],
        "scout2": [
            stop("base", 0.0),
            stop("a", 60.0, payload=1, path=("base", "a"), pick={"scout": 1}),
            stop("b", 100.0, payload=2, path=("a", "b"), pick={"scout": 1}),
            stop("hub", 130.0, path=("b", "hub"), drop={"carrier": 2}),
        ],
        "carrier": [
            stop("base", 0.0),
            stop("hub", 150.0, payload=2, path=("base", "hub"), pick={"scout2": 2}),
            stop("base", 210.0, path=("hub", "base"), unload=2),
        ],
    }
)
"""A sample goes from hand to hand; nobody waits by the plan."""


def test_a_vehicle_without_script_is_at_every_gate_before_it_opens() -> None:
    """A later gate would else open as the vehicle comes, and one that has opened is waited at for a day."""
    gates = gate_times(timed(scout2={"pick": RELAY}), CHAIN)
    assert gates == {
        ("scout2", 1): GateTime(opens_s=90.0, comes_s=60.0),
        ("scout2", 2): GateTime(opens_s=160.0, comes_s=130.0),
    }


def test_the_script_lets_a_late_vehicle_pass() -> None:
    gates = gate_times(timed(scout2={}), CHAIN)
    assert gates["scout2", 2] == GateTime(opens_s=130.0, comes_s=130.0)


@pytest.mark.parametrize(("payload", "late_s"), [({}, 30.0), ({"pick": RELAY}, 60.0)])
def test_who_waits_for_a_vehicle_that_waited_waits_as_much_longer(payload: Any, late_s: float) -> None:
    gates = gate_times(timed(scout2=payload, carrier={}), CHAIN)
    assert gates["carrier", 1] == GateTime(opens_s=150.0 + late_s + MARGIN_S, comes_s=150.0)
    assert gate_times(timed(carrier={}), CHAIN) == {("carrier", 1): GateTime(180.0, 150.0)}


def test_what_the_plan_waits_anyway_makes_up_for_it() -> None:
    scout2 = CHAIN.robot("scout2").route
    patient = scout2[2].model_copy(update={"depart_s": 200.0})
    robots = tuple(
        robot.model_copy(update={"route": (*scout2[:2], patient, scout2[3])})
        if robot.id == "scout2"
        else robot
        for robot in CHAIN.robots
    )
    gates = gate_times(timed(scout2={"pick": RELAY}), CHAIN.model_copy(update={"robots": robots}))
    assert gates["scout2", 2] == GateTime(opens_s=230.0, comes_s=130.0)
