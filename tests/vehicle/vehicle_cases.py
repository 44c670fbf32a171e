"""A small site, plans by hand, and random plans in which every container comes home."""

from __future__ import annotations

import random
from collections.abc import Mapping

from malipp_field.mission import Mission, parse_mission
from malipp_field.plan import Plan, RobotPlan, Stop

ROBOTS = ("scout", "scout2", "carrier")
CANDIDATES = ("a", "b", "c", "hub")

ORIGIN = "  origin: {lat_deg: 52.48, lon_deg: 13.785, alt_m: 40.0}\n"
MISSION = """\
format: malipp-mission/1
name: small
site:
{origin}  nodes:
    - {{id: base, x_m: 0.0, y_m: 0.0, role: depot}}
    - {{id: yard, x_m: 200.0, y_m: 0.0, role: depot}}
    - {{id: a, x_m: 30.0, y_m: 20.0}}
    - {{id: b, x_m: 60.0, y_m: -20.0}}
    - {{id: c, x_m: 90.0, y_m: 20.0}}
    - {{id: hub, x_m: 60.0, y_m: 40.0}}
    - {{id: gate, x_m: 45.0, y_m: 10.0, role: via}}
  complete: true
  keep_outs:
    - id: pit
      polygon: [{{x_m: 100.0, y_m: 60.0}}, {{x_m: 120.0, y_m: 60.0}}, {{x_m: 110.0, y_m: 80.0}}]
field:
  kernel: {{family: rbf, length_scale_m: 30.0}}
  test_points: [{{x_m: 50.0, y_m: 0.0}}]
team:
  sample_mass_kg: 1.0
  robots:
"""
ROBOT = """\
    - id: {id}
      start: base
      depots: [base, yard]
      empty_mass_kg: 20.0
      energy_budget_j: 10000.0
      payload_capacity: 3
      samples_per_node: 2
      noise_variance: 0.1
      energy_per_kg_m: 2.0
      speed_m_s: 1.5
"""


def small_mission(abstract: bool = False) -> Mission:
    robots = "".join(ROBOT.format(id=robot) for robot in ROBOTS)
    return parse_mission(MISSION.format(origin="" if abstract else ORIGIN) + robots)


def stop(
    node: str, at_s: float, payload: int = 0, path: tuple[str, ...] | None = None, collect: int = 0,
    drop: dict[str, int] | None = None, pick: dict[str, int] | None = None, unload: int = 0,
) -> Stop:  # fmt: skip
    return Stop(
        node=node, path=path, arrive_s=None if path is None else at_s, depart_s=at_s,
        leg_energy_j=None if path is None else 1.0, collect=collect, drop=drop or {}, pick=pick or {},
        unload=unload, payload=payload,
    )  # fmt: skip


def plan_of(routes: Mapping[str, list[Stop]], version: int = 1) -> Plan:
    return Plan(
        mission="small", version=version, method="exact", status="feasible", solve_time_s=0.0,
        robots=tuple(RobotPlan(id=robot, route=tuple(route)) for robot, route in routes.items()),
    )  # fmt: skip


def handoff_plan() -> Plan:
    """The scout leaves one sample from `a` and one from `hub` at `hub`; the carrier brings them home."""
    return plan_of(
        {
            "scout": [
                stop("base", 0.0),
                stop("a", 50.0, payload=2, path=("base", "gate", "a"), collect=2),
                stop("hub", 90.0, payload=1, path=("a", "hub"), collect=1, drop={"carrier": 2}),
                stop("base", 190.0, path=("hub", "gate", "base"), unload=1),
            ],
            "scout2": [stop("base", 0.0)],
            "carrier": [
                stop("base", 0.0),
                stop("hub", 130.0, payload=2, path=("base", "hub"), pick={"scout": 2}),
                stop("base", 210.0, path=("hub", "base"), unload=2),
            ],
        }
    )


def random_plan(seed: int) -> Plan:
    """Return a plan that keeps the custody rows of the paper (but for capacities), with ties in its times."""
    return _Walks(random.Random(seed)).plan()


class _Walks:
    """Routes under way, and the drops that still have to be fetched: (node, receiver) to sender to count."""

    def __init__(self, rng: random.Random) -> None:
        self.rng = rng
        self.now_s = 0.0
        self.routes = {robot: [stop("base", 0.0)] for robot in ROBOTS}
        self.owed: dict[tuple[str, str], dict[str, int]] = {}

    def plan(self) -> Plan:
        visits = [(robot, node) for robot in ROBOTS for node in (*CANDIDATES, "yard")]
        self.rng.shuffle(visits)
        for robot, node in visits[: self.rng.randrange(len(visits) + 1)]:
            self._visit(robot, node, may_drop=True)
        for node, robot in sorted(self.owed):
            self._visit(robot, node, may_drop=False)
        for robot, route in self.routes.items():
            self._append(robot, "base", unload=route[-1].payload)
        return plan_of(self.routes)

    def _visit(self, robot: str, node: str, may_drop: bool) -> None:
        pick = self.owed.pop((node, robot), {})
        load = self.routes[robot][-1].payload
        unload = self.rng.randint(0, load) if node == "yard" else 0
        collect = self.rng.randint(0, 2) if node in CANDIDATES else 0
        load += collect - unload
        drop: dict[str, int] = {}
        for receiver in ROBOTS:
            visited = any(known.node == node for known in self.routes[receiver])
            count = self.rng.randint(0, load)
            if may_drop and receiver != robot and receiver not in pick and not visited and count:
                drop[receiver] = count
                self.owed.setdefault((node, receiver), {})[robot] = count
                load -= count
        self._append(
            robot,
            node,
            payload=load + sum(pick.values()),
            collect=collect,
            drop=drop,
            pick=pick,
            unload=unload,
        )

    def _append(
        self, robot: str, node: str, payload: int = 0, collect: int = 0, drop: dict[str, int] | None = None,
        pick: dict[str, int] | None = None, unload: int = 0,
    ) -> None:  # fmt: skip
        self.now_s += self.rng.choice([0.0, 0.0, 10.0])
        path = (self.routes[robot][-1].node, node)
        self.routes[robot].append(stop(node, self.now_s, payload, path, collect, drop, pick, unload))
