"""A small mission made by hand, and the two versions of its plan.

Two regions joined by a corridor, two scouts and a carrier. The eastern scout `kite` leaves two samples at
`e3` for the carrier `mule`. At `REPLAN_S` the second version gives the sample that `mule` should have taken
at `w5` to `lark` and lets `kite` skip `e6`. All figures follow from here by other code than the package's.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from itertools import pairwise

from malipp_field.field import candidate_ids, information_model
from malipp_field.mission import Mission, node_positions, parse_mission
from malipp_field.plan import Objective, Plan, RobotPlan, Stop

REPLAN_S = 65.0
SERVICE_S = 4.0

MISSION = """\
format: malipp-mission/1
name: twin-pits
site:
  origin: {lat_deg: 46.5102, lon_deg: 7.8421, alt_m: 910.0}
  nodes:
    - {id: base, x_m: 0, y_m: 0, role: depot}
    - {id: camp, x_m: 132, y_m: 34, role: depot}
    - {id: w1, x_m: 10, y_m: 28}
    - {id: w2, x_m: 27, y_m: 37}
    - {id: w3, x_m: 6, y_m: 53}
    - {id: w4, x_m: 30, y_m: 64}
    - {id: w5, x_m: 45, y_m: 48}
    - {id: w6, x_m: 38, y_m: 14}
    - {id: gate, x_m: 54, y_m: 30, role: via}
    - {id: pass, x_m: 80, y_m: 30, role: via}
    - {id: e1, x_m: 92, y_m: 12}
    - {id: e2, x_m: 112, y_m: 22}
    - {id: e3, x_m: 96, y_m: 42}
    - {id: e4, x_m: 117, y_m: 47}
    - {id: e5, x_m: 103, y_m: 64}
    - {id: e6, x_m: 126, y_m: 66}
  edges:
    - {from: base, to: w1}
    - {from: w1, to: w2}
    - {from: w1, to: w3}
    - {from: w2, to: w5}
    - {from: w3, to: w4}
    - {from: w4, to: w5}
    - {from: base, to: w6}
    - {from: w6, to: gate}
    - {from: w2, to: w6}
    - {from: w5, to: gate}
    - {from: gate, to: pass}
    - {from: pass, to: e1}
    - {from: pass, to: e3}
    - {from: e1, to: e2}
    - {from: e2, to: camp}
    - {from: e2, to: e3}
    - {from: e3, to: e4}
    - {from: e4, to: camp}
    - {from: e4, to: e5}
    - {from: e5, to: e6}
    - {from: e5, to: e3}
  keep_outs:
    - id: north-pit
      polygon: [{x_m: 57, y_m: 40}, {x_m: 77, y_m: 41}, {x_m: 80, y_m: 66}, {x_m: 64, y_m: 74},
                {x_m: 53, y_m: 62}]
    - id: south-pit
      polygon: [{x_m: 56, y_m: -4}, {x_m: 74, y_m: -6}, {x_m: 79, y_m: 14}, {x_m: 66, y_m: 22},
                {x_m: 54, y_m: 15}]
field:
  kernel: {family: matern52, length_scale_m: 26.0, variance: 1.0}
  test_points:
    - {x_m: 12, y_m: 40}
    - {x_m: 30, y_m: 50}
    - {x_m: 38, y_m: 22, weight: 2.0}
    - {x_m: 95, y_m: 28}
    - {x_m: 108, y_m: 52}
    - {x_m: 122, y_m: 58}
team:
  sample_mass_kg: 1.0
  service_time_s: 4.0
  clearance_s: 2.0
  robots:
    - {id: lark, start: base, depots: [base], empty_mass_kg: 4.0, energy_budget_j: 1400.0,
       payload_capacity: 4, samples_per_node: 1, noise_variance: 0.02, energy_per_kg_m: 1.0, speed_m_s: 1.6}
    - {id: kite, start: camp, depots: [camp], empty_mass_kg: 4.0, energy_budget_j: 1200.0,
       payload_capacity: 3, samples_per_node: 1, noise_variance: 0.02, energy_per_kg_m: 1.0, speed_m_s: 1.6}
    - {id: mule, start: base, depots: [base, camp], empty_mass_kg: 12.0, energy_budget_j: 6500.0,
       payload_capacity: 6, samples_per_node: 1, noise_variance: 0.2, energy_per_kg_m: 1.0, speed_m_s: 1.4}
"""


@dataclass(frozen=True)
class Do:
    """One stop as this file writes it: the way there, and what is done."""

    path: str
    collect: int = 0
    drop: dict[str, int] = field(default_factory=dict)
    pick: dict[str, int] = field(default_factory=dict)
    unload: int = 0
    not_before_s: float = 0.0


V1: dict[str, list[Do]] = {
    "lark": [
        Do("base w1", 1), Do("w1 w3", 1), Do("w3 w4", 1), Do("w4 w5 w2", 1), Do("w2 w1 base", unload=4),
    ],
    "kite": [
        Do("camp e2", 1), Do("e2 e3", 1, drop={"mule": 2}), Do("e3 e4", 1), Do("e4 e5", 1),
        Do("e5 e6", 1), Do("e6 e5 e4 camp", unload=3),
    ],
    "mule": [
        Do("base w6", 1), Do("w6 gate pass e1", 1), Do("e1 pass e3", pick={"kite": 2}),
        Do("e3 pass gate w5", 1), Do("w5 gate w6 base", unload=5),
    ],
}  # fmt: skip
"""The first plan."""

V2: dict[str, tuple[str, int, list[Do]]] = {
    "lark": ("w4", 3, [Do("w4 w5", 1), Do("w5 w2 w1 base", unload=4)]),
    "kite": ("e5", 2, [Do("e5 e4 camp", unload=2)]),
    "mule": ("e1", 2, [Do("e1 pass e3", pick={"kite": 2}), Do("e3 pass gate w6 base", unload=4)]),
}
"""The second: node where the free part begins, samples on board there, and the stops."""


def mission() -> Mission:
    """Return the mission of the recording."""
    return parse_mission(MISSION, "twin-pits.yaml")


def plan(version: int) -> Plan:
    """Return version 1 or 2."""
    here = mission()
    if version == 1:
        robots = tuple(_route(here, r.id, r.start, 0.0, 0, V1[r.id]) for r in here.team.robots)
    else:
        free_s = {"lark": 67.0, "kite": 78.0, "mule": 156.0}
        robots = tuple(
            _route(here, r.id, V2[r.id][0], free_s[r.id], V2[r.id][1], V2[r.id][2]) for r in here.team.robots
        )
    counts = PLANNED_SAMPLES[version]
    return Plan(
        mission=here.name,
        version=version,
        method="exact",
        status="feasible",
        objective=Objective(
            information=objective(here, counts),
            energy_j=sum(robot.energy_j for robot in robots),
            makespan_s=max(robot.route[-1].depart_s for robot in robots),
        ),
        solve_time_s=1.0,
        robots=robots,
    )


PLANNED_SAMPLES = {
    1: {"w1": "lark", "w3": "lark", "w4": "lark", "w2": "lark", "e2": "kite", "e3": "kite", "e4": "kite",
        "e5": "kite", "e6": "kite", "w6": "mule", "e1": "mule", "w5": "mule"},
    2: {"w1": "lark", "w3": "lark", "w4": "lark", "w5": "lark", "e2": "kite", "e3": "kite", "e4": "kite",
        "e5": "kite", "w6": "mule", "e1": "mule"},
}  # fmt: skip
"""Who samples where under each version, from the mission's beginning; one sample each."""


def objective(here: Mission, samplers: dict[str, str]) -> float:
    """Return J of one sample a node."""
    precision = information_model(here).k_vv[0] * 0.0
    for index, node in enumerate(candidate_ids(here)):
        if node in samplers:
            precision[index] = 1.0 / here.robot(samplers[node]).noise_variance
    return information_model(here).value(precision)


def _route(
    here: Mission, robot_id: str, start: str, start_s: float, payload: int, stops: list[Do]
) -> RobotPlan:
    robot, places = here.robot(robot_id), node_positions(here)
    now_s = max(start_s, SERVICE_S) if start_s == 0.0 else start_s
    route = [Stop(node=start, depart_s=now_s, payload=payload)]
    for do in stops:
        path = tuple(do.path.split())
        length_m = sum(math.dist(places[a], places[b]) for a, b in pairwise(path))
        arrive_s = now_s + length_m / robot.speed_m_s
        leg_j = robot.energy_per_kg_m * length_m * (robot.empty_mass_kg + payload * here.team.sample_mass_kg)
        payload += do.collect - sum(do.drop.values()) + sum(do.pick.values()) - do.unload
        now_s = max(arrive_s, do.not_before_s) + SERVICE_S
        route.append(
            Stop(
                node=path[-1], path=path, arrive_s=arrive_s, depart_s=now_s, leg_energy_j=leg_j,
                collect=do.collect, drop=do.drop, pick=do.pick, unload=do.unload, payload=payload,
            )
        )  # fmt: skip
    return RobotPlan(id=robot_id, route=tuple(route))
