"""Random teams and plans on a small site, with every kind of payload hardware, and what must hold of them."""

from __future__ import annotations

import math
import random
from typing import Any

from team_on_a_table import Team

from malipp_field.bus import Confirmation
from malipp_field.mission import Mission, node_positions, parse_mission
from malipp_field.plan import Plan, RobotPlan, Stop
from malipp_field.vehicle.layout import lay_out
from malipp_field.vehicle.steps import Action

ROBOTS = ("r1", "r2", "r3")
SERVICE_S, CLEARANCE_S, SPEED_M_S = 4.0, 3.0, 5.0
SITE = """
format: malipp-mission/1
name: yard
site:
  origin: {{lat_deg: 52.48, lon_deg: 13.785}}
  nodes:
    - {{id: base, x_m: 0.0, y_m: 0.0, role: depot}}
    - {{id: a, x_m: 30.0, y_m: 20.0}}
    - {{id: b, x_m: 60.0, y_m: -20.0}}
    - {{id: c, x_m: 60.0, y_m: 30.0}}
  complete: true
field:
  kernel: {{family: rbf, length_scale_m: 30.0}}
  test_points: [{{x_m: 50.0, y_m: 0.0}}]
replanning: {{slip_s: 9999.0, stall_s: 90.0}}
simulation: {{person_s: 6.0, terrain: {terrain}}}
team:
  sample_mass_kg: 1.0
  service_time_s: 4.0
  clearance_s: 3.0
  robots:
{robots}
vehicles:
{vehicles}
"""
ROBOT = (
    "    - {{id: {id}, start: base, depots: [base], empty_mass_kg: 10.0, energy_budget_j: 1.0e+7, "
    "payload_capacity: 9, samples_per_node: 2, noise_variance: 0.1, energy_per_kg_m: 1.0, speed_m_s: 5.0}}"
)
PROFILES = (
    "script",
    "manual",
    "{collect: {by: servo, channel: 9, pwm_us: 1900, rest_us: 1100, duration_s: 4.0}, "
    "drop: {by: gripper, move: release, duration_s: 2.0}, pick: {by: gripper, move: grab, duration_s: 2.0}, "
    "unload: {by: gripper, move: release, duration_s: 2.0}}",
    "{collect: {by: relay, relay: 1, duration_s: 4.0, confirm: operator}, drop: {by: manual}, "
    "pick: {by: servo, channel: 7, pwm_us: 1500, duration_s: 2.0}, "
    "unload: {by: relay, relay: 2, duration_s: 1.0}}",
)


def random_mission(
    rng: random.Random, *, gates: tuple[str, ...], sand: bool, profiles: Any = PROFILES
) -> Mission:
    vehicles = "\n".join(
        f"  {robot}: {{payload: {rng.choice(profiles)}, gate: {rng.choice(gates)}, gate_margin_s: 10.0, "
        f"if_missing: {rng.choice(('hold', 'go_on'))}}}"
        for robot in ROBOTS
    )
    slow = "{x_m: 45.0, y_m: 0.0, radius_m: 12.0, speed_factor: 0.15}"
    return parse_mission(
        SITE.format(
            terrain=f"[{slow}]" if sand else "[]",
            robots="\n".join(ROBOT.format(id=robot) for robot in ROBOTS),
            vehicles=vehicles,
        )
    )


class _Walk:
    """One robot's route under way."""

    def __init__(self) -> None:
        self.route = [Stop(node="base", depart_s=SERVICE_S, payload=0)]

    def reach(self, mission: Mission, node: str, not_before_s: float, load: int, **work: Any) -> float:
        """Add a stop; return when it is left."""
        places, last = node_positions(mission), self.route[-1]
        arrive_s = last.depart_s + math.dist(places[last.node], places[node]) / SPEED_M_S
        depart_s = max(arrive_s, not_before_s) + SERVICE_S
        self.route.append(
            Stop(
                node=node, path=(last.node, node), arrive_s=arrive_s, depart_s=depart_s, leg_energy_j=1.0,
                payload=load, **work,
            )
        )  # fmt: skip
        return depart_s


def random_plan(rng: random.Random, mission: Mission) -> Plan:
    """Return a plan with handoffs whose times are those of an undisturbed run."""
    walks = {robot: _Walk() for robot in ROBOTS}
    first, second, third = rng.sample(ROBOTS, 3)
    nodes = rng.sample(["a", "b", "c"], 3)
    count = rng.randint(1, 2)
    ready_s = walks[first].reach(
        mission, nodes[0], 0.0, 0, collect=count, drop={second: count}
    ) + CLEARANCE_S  # fmt: skip
    load = count + rng.randint(0, 1)
    walks[second].reach(mission, nodes[0], ready_s, load, collect=load - count, pick={first: count})
    given = rng.randint(1, load)
    ready_s = walks[second].reach(mission, nodes[1], 0.0, load - given, drop={third: given}) + CLEARANCE_S
    own = rng.randint(0, 1)
    walks[third].reach(mission, nodes[2], 0.0, own, collect=own)
    walks[third].reach(mission, nodes[1], ready_s, own + given, pick={second: given})
    walks[second].reach(mission, "base", 0.0, 0, unload=load - given)
    walks[third].reach(mission, "base", 0.0, 0, unload=own + given)
    walks[first].reach(mission, "base", 0.0, 0)
    return Plan(
        mission="yard", method="by chance", status="feasible", solve_time_s=0.0,
        robots=tuple(RobotPlan(id=robot, route=tuple(walks[robot].route)) for robot in ROBOTS),
    )  # fmt: skip


class GateWatch:
    """Looks at every rover itself, whatever anybody reports: is it at a pick, and might it be?

    A pick may begin when its drop is confirmed and the clearance over, or when its time gate has passed.
    """

    def __init__(self) -> None:
        self.seen: set[str] = set()
        self.early: set[str] = set()  # picks that a time gate allowed before the drop was confirmed

    def __call__(self, team: Team) -> None:
        now_s = team.clock.now_s()
        for robot, rover in team.fleet.rovers.items():
            pilot, mission = rover.autopilot, team.coordinator.tracks[robot].mission
            if not (pilot.mode == 10 and pilot.armed and pilot.run.seq):  # AUTO
                continue
            layout = lay_out(mission)
            step = mission.steps[layout.steps[min(pilot.run.seq, len(layout.steps) - 1)]]
            if step.action is Action.PICK and step.uid not in self.seen:
                self.seen.add(step.uid)
                gate = next(s for s in mission.steps if s.action is Action.WAIT and s.stop == step.stop)
                dropped = self._dropped_s(team, step.tags[0], step.node)
                confirmed = dropped is not None and now_s >= dropped + CLEARANCE_S
                passed = gate.not_before_s is not None and now_s >= gate.not_before_s
                assert confirmed or passed, f"{step.uid} begins too early"
                if not confirmed:
                    self.early.add(step.uid)

    @staticmethod
    def _dropped_s(team: Team, tag: int, node: str) -> float | None:
        times = [
            c.time_s
            for c in team.bus.of(Confirmation)
            if c.ok and (c.tag, c.node) == (tag, node) and c.action is Action.DROP
        ]
        return times[-1] if times else None


def truth_and_ledger(team: Team) -> tuple[list[tuple[str, ...]], list[tuple[str, ...]]]:
    """Return where each sample (by node and sampler) really is, and where the ledger has it."""
    places = {place: node for node, place in team.world.places.items()}
    truth = [
        (
            c.node, c.sampler,
            c.holder or c.delivered_to or (places.get(c.place, "?") if c.place is not None else "gone"),
        )
        for c in team.world.containers.values()
    ]  # fmt: skip
    ledger = [(r.sample.node, r.sample.sampler, r.holder or "?") for r in team.ledger.samples if r.history]
    return sorted(truth), sorted(ledger)
