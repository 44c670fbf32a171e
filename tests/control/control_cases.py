"""A small team under way: a scout that leaves samples at a hub, a carrier that fetches them."""

from __future__ import annotations

from malipp_field.bus import Confirmation, Telemetry
from malipp_field.control.ledger import CustodyLedger
from malipp_field.mission import Mission, parse_mission, to_globe
from malipp_field.plan import Plan, RobotPlan, Stop
from malipp_field.vehicle.compile import compile_plan
from malipp_field.vehicle.steps import Action, VehicleMission

MISSION = """
format: malipp-mission/1
name: relay
site:
  origin: {lat_deg: 50.0, lon_deg: 8.0}
  nodes:
    - {id: base, x_m: 0, y_m: 0, role: depot}
    - {id: hub, x_m: 100, y_m: 0}
    - {id: far, x_m: 200, y_m: 0}
    - {id: gate, x_m: 150, y_m: 0, role: via}
  edges:
    - {from: base, to: hub}
    - {from: hub, to: gate}
    - {from: gate, to: far}
field:
  kernel: {family: rbf, length_scale_m: 50}
  test_points: [{x_m: 200, y_m: 10}]
replanning: {stall_s: 120}
team:
  sample_mass_kg: 2.0
  service_time_s: 10.0
  clearance_s: 5.0
  robots:
    - {id: scout, start: hub, depots: [base], empty_mass_kg: 10, energy_budget_j: 10000,
       payload_capacity: 2, samples_per_node: 2, noise_variance: 0.1, energy_per_kg_m: 1.0, speed_m_s: 1.0}
    - {id: carrier, start: base, depots: [base], empty_mass_kg: 50, energy_budget_j: 50000,
       payload_capacity: 9, samples_per_node: 0, noise_variance: 1.0, energy_per_kg_m: 1.0, speed_m_s: 2.0}
"""


def relay_mission() -> Mission:
    return parse_mission(MISSION)


def relay_plan() -> Plan:
    """The scout takes two samples at far, drops one at hub for the carrier, brings the other home."""
    scout = RobotPlan(
        id="scout",
        route=(
            Stop(node="hub", depart_s=10.0, payload=0),
            Stop(
                node="far", path=("hub", "gate", "far"), arrive_s=110.0, depart_s=120.0, leg_energy_j=1000.0,
                collect=2, payload=2,
            ),
            Stop(
                node="base", path=("far", "gate", "hub", "base"), arrive_s=320.0, depart_s=330.0,
                leg_energy_j=2800.0, unload=2, payload=0,
            ),
        ),
    )  # fmt: skip
    carrier = RobotPlan(id="carrier", route=(Stop(node="base", depart_s=10.0, payload=0),))
    return Plan(
        mission="relay", method="by hand", status="feasible", solve_time_s=0.0, robots=(scout, carrier)
    )


def drop_plan() -> Plan:
    """The carrier samples nothing; the scout (from far, by a start at hub) leaves both samples on its way."""
    scout = RobotPlan(
        id="scout",
        route=(
            Stop(node="hub", depart_s=10.0, payload=0),
            Stop(
                node="far", path=("hub", "gate", "far"), arrive_s=110.0, depart_s=120.0, leg_energy_j=1000.0,
                collect=2, drop={"carrier": 1}, payload=1,
            ),
            Stop(
                node="base", path=("far", "gate", "hub", "base"), arrive_s=320.0, depart_s=330.0,
                leg_energy_j=2400.0, unload=1, payload=0,
            ),
        ),
    )  # fmt: skip
    carrier = RobotPlan(
        id="carrier",
        route=(
            Stop(node="base", depart_s=10.0, payload=0),
            Stop(
                node="far", path=("base", "hub", "gate", "far"), arrive_s=125.0, depart_s=135.0,
                leg_energy_j=10000.0, pick={"scout": 1}, payload=1,
            ),
            Stop(
                node="base", path=("far", "gate", "hub", "base"), arrive_s=235.0, depart_s=245.0,
                leg_energy_j=10400.0, unload=1, payload=0,
            ),
        ),
    )  # fmt: skip
    return Plan(
        mission="relay", method="by hand", status="feasible", solve_time_s=0.0, robots=(scout, carrier)
    )


def compiled(plan: Plan) -> tuple[dict[str, VehicleMission], CustodyLedger]:
    found = compile_plan(relay_mission(), plan)
    ledger = CustodyLedger()
    ledger.expect(found.samples.values())
    return found.missions, ledger


def confirm(robot: str, action: Action, tag: int, node: str, time_s: float = 1.0) -> Confirmation:
    return Confirmation(
        time_s=time_s, robot=robot, number=1, uid="u", action=action, node=node, tag=tag, ok=True, value=0.5
    )


def telemetry(
    robot: str,
    uid: str | None,
    time_s: float,
    x_m: float,
    used_j: float,
    mode: str = "AUTO",
    version: int = 1,
) -> Telemetry:
    origin = relay_mission().site.origin
    assert origin is not None
    lat_deg, lon_deg = to_globe(x_m, 0.0, origin)
    return Telemetry(
        time_s=time_s, robot=robot, lat_deg=lat_deg, lon_deg=lon_deg, heading_deg=90.0, speed_m_s=1.0,
        mode=mode, armed=True, ready_to_arm=True, energy_used_j=used_j, mission_version=version, step_uid=uid,
        finished=uid is None, link_ok=True,
    )  # fmt: skip
