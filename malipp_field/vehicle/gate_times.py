"""When gates open by themselves, if every vehicle keeps to the plan and to its gates.

A gate by time opens some margin later than the plan has it. The vehicle is that much late from there on, and
so is whoever waits for what it drops; the gates after it allow for that.
"""

from __future__ import annotations

from typing import NamedTuple

from malipp_field.errors import PlanError
from malipp_field.mission import Mission
from malipp_field.mission.vehicles import ByScript
from malipp_field.plan import Plan
from malipp_field.vehicle.stops import Place, all_stops, drops, in_order

DELAY_GATE_H = 23
"""How long a gate by NAV_DELAY may be waited at: one a day ahead would be taken for one that is due."""
SCRIPT_GATE_H = 11
"""How long one kept by the payload script may be: what is more than half a day ahead it takes for past."""


class GateTime(NamedTuple):
    """A gate that opens by time, in mission time: when it does, and when the vehicle comes to it."""

    opens_s: float
    comes_s: float


def gate_times(mission: Mission, plan: Plan) -> dict[Place, GateTime]:
    """Return the times of all gates that may open by time.

    The service window of a pick begins no earlier in a plan than the sender's departure and the clearance
    (`eq:deaddrop_sync`). Its gate opens `gate_margin_s` after that, later still by what the sender is late;
    without the script, which lets a late vehicle pass, no earlier than that margin after the vehicle comes.

    Raises
    ------
    PlanError
        When the handoffs wait for each other in a circle, or a vehicle would mistake the time of a gate for
        one of another day.
    """
    stops, dropped = dict(all_stops(plan)), drops(plan)
    gates: dict[Place, GateTime] = {}
    late_s: dict[Place, float] = {}
    for place in in_order(plan):
        robot, index = place
        stop, vehicle = stops[place], mission.vehicle(robot)
        begins_s = stop.depart_s - mission.team.service_time_s
        comes_s = (begins_s if stop.arrive_s is None else stop.arrive_s) + late_s.get((robot, index - 1), 0.0)
        senders = [each for sender in stop.pick for each in dropped.get((stop.node, sender, robot), [])]
        free_s = begins_s + max((late_s[each] for each in senders), default=0.0)
        if stop.pick and vehicle.gate == "time":
            scripted = isinstance(vehicle.payload.pick, ByScript)
            free_s = (free_s if scripted else max(free_s, comes_s)) + vehicle.gate_margin_s
            gates[place] = _checked(place, stop.node, GateTime(free_s, comes_s), scripted=scripted)
        late_s[place] = max(0.0, max(comes_s, free_s) - begins_s)
    return gates


def _checked(place: Place, node: str, gate: GateTime, *, scripted: bool) -> GateTime:
    most_h = SCRIPT_GATE_H if scripted else DELAY_GATE_H
    ahead_h = (gate.opens_s - gate.comes_s) / 3600.0
    if ahead_h > most_h:
        raise PlanError(
            f"{place[0]}, stop {place[1]} at '{node}': its time gate opens {ahead_h:.1f} h after it comes; "
            f"the time of day tells at most {most_h} h: say gate: custody, or a smaller gate_margin_s"
        )
    return gate
