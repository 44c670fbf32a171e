"""A believable recording of a small mission: what the team would have said on the bus.

Terrain that the plan does not know slows `mule` all the way, so there is a replan: see `synthetic_plan`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from synthetic_plan import MISSION, REPLAN_S, SERVICE_S, mission, plan

from malipp_field.bus.messages import (
    Confirmation,
    CustodyEvent,
    Event,
    Ledger,
    Message,
    MissionText,
    PlanAdopted,
    SampleRecord,
    Telemetry,
    root,
    vehicle_key,
)
from malipp_field.mission import Mission, node_positions, to_globe
from malipp_field.plan import Plan
from malipp_field.record import RunWriter
from malipp_field.vehicle.compile import Custody, compile_plan
from malipp_field.vehicle.steps import Action, Sample, Step, VehicleMission

START_S = 1_780_000_000.0
TELEMETRY_STEP_S = 0.5
SLOW, HUNGRY = 0.55, 1.25
"""Terrain on the whole way of `mule`: share of its speed, and how much more energy it takes."""
REASON = "mule will be 65 s late at e1, more than 30 s"
END_S = 380.0
IDLE_J = 7.0
"""Used by every vehicle between power-up and the start."""


def truth(x_m: float, y_m: float) -> float:
    """Return the field as it is."""
    return math.sin(x_m / 22.0) + 0.8 * math.cos(y_m / 17.0)


@dataclass
class Vehicle:
    """One robot while the recording is made up."""

    robot_id: str
    steps: tuple[Step, ...]
    x_m: float
    y_m: float
    now_s: float = 0.0
    energy_j: float = IDLE_J
    distance_m: float = 0.0
    on_board: int = 0
    confirmations: int = 0


def messages() -> list[tuple[str, Message]]:
    """Return everything that was said, with its key, in the order of time."""
    here = mission()
    first, second = plan(1), plan(2)
    v1 = compile_plan(here, first)
    v2 = compile_plan(here, second, _custody({(s.sampler, s.node): tag for tag, s in v1.samples.items()}))
    keep = {"lark": "w4", "kite": "e5", "mule": "e1"}
    missions = {robot: _joined(v1.missions[robot], v2.missions[robot], keep[robot]) for robot in v1.missions}
    samples = {**v1.samples, **v2.samples}
    said: list[tuple[str, Message]] = []
    base = root(here.name)
    said.append((f"{base}/mission", MissionText(time_s=START_S - 20.0, text=MISSION)))
    said.append((f"{base}/plan", _adopted(-1.0, first, v1.missions, v1.samples, "first plan")))
    said.append(
        (
            f"{base}/plan",
            _adopted(REPLAN_S, second, missions, samples, REASON),
        )
    )
    drops: dict[int, float] = {}
    for robot_id in ("lark", "kite", "mule"):
        said += _drive(here, robot_id, missions[robot_id], samples, drops)
    said += [(f"{base}/event", event) for event in _events()]
    said.sort(key=lambda pair: pair[1].time_s)
    said += _ledgers(said, base)
    return sorted(said, key=lambda pair: pair[1].time_s)


def _custody(tags: dict[tuple[str, str], int]) -> Custody:
    """Return where the containers are when the free parts of version 2 begin."""
    return Custody(
        on_board={
            "lark": tuple(tags["lark", node] for node in ("w1", "w3", "w4")),
            "kite": tuple(tags["kite", node] for node in ("e4", "e5")),
            "mule": tuple(tags["mule", node] for node in ("w6", "e1")),
        },
        caches={("e3", "kite"): (tags["kite", "e2"], tags["kite", "e3"])},
        next_tag=max(tags.values()) + 1,
    )


def _joined(old: VehicleMission, new: VehicleMission, node: str) -> VehicleMission:
    """Return the committed steps (all up to the last at ``node``'s first stop), then the free ones."""
    stop = next(s.stop for s in old.steps if s.node == node and s.action is Action.COLLECT)
    committed = tuple(step for step in old.steps if step.stop <= stop)
    return VehicleMission(robot=new.robot, version=2, home=new.home, steps=(*committed, *new.steps))


def _adopted(
    time_s: float, new: Plan, missions: dict[str, VehicleMission], samples: dict[int, Sample], reason: str
) -> PlanAdopted:
    return PlanAdopted(
        time_s=START_S + time_s,
        start_s=START_S,
        plan=new,
        missions=tuple(missions.values()),
        samples=tuple(samples.values()),
        reason=reason,
    )


def _events() -> Iterator[Event]:
    for time_s, severity, text, robot in (
        (-15.0, "info", "mission twin-pits read: 12 candidates, 3 robots", None),
        (-1.0, "info", "plan 1 is on every vehicle", None),
        (REPLAN_S - 4.0, "warning", "24 s late at w6", "mule"),
        (REPLAN_S, "warning", f"plan 2 in force: {REASON}", None),
        (365.0, "info", "all samples are home", None),
    ):
        yield Event.model_validate(
            {
                "time_s": START_S + time_s, "source": "coordinator", "severity": severity, "text": text,
                "robot": robot,
            }
        )  # fmt: skip


def _drive(
    here: Mission, robot_id: str, orders: VehicleMission, samples: dict[int, Sample], drops: dict[int, float]
) -> list[tuple[str, Message]]:
    """Return telemetry and confirmations of one vehicle that carries out its steps."""
    places = node_positions(here)
    robot = here.robot(robot_id)
    vehicle = Vehicle(robot_id, orders.steps, *places[robot.start])
    slow, hungry = (SLOW, HUNGRY) if robot_id == "mule" else (1.0, 1.0)
    said: list[tuple[str, Message]] = [
        (_key(here, robot_id, "telemetry"), _telemetry(here, vehicle, None, 0.0))
    ]
    _wait(here, vehicle, orders.steps[0], SERVICE_S, said)
    for step in orders.steps:
        if step.action is Action.DRIVE:
            goal = places[step.node]
            length_m = math.dist((vehicle.x_m, vehicle.y_m), goal)
            origin = (vehicle.x_m, vehicle.y_m)
            speed = robot.speed_m_s * slow
            per_m = (
                robot.energy_per_kg_m
                * hungry
                * (robot.empty_mass_kg + vehicle.on_board * here.team.sample_mass_kg)
            )
            ticks = max(1, math.ceil(length_m / speed / TELEMETRY_STEP_S))
            for tick in range(1, ticks + 1):
                share = tick / ticks
                vehicle.x_m = origin[0] + share * (goal[0] - origin[0])
                vehicle.y_m = origin[1] + share * (goal[1] - origin[1])
                vehicle.now_s += length_m / speed / ticks
                vehicle.energy_j += per_m * length_m / ticks
                said.append((_key(here, robot_id, "telemetry"), _telemetry(here, vehicle, step, speed)))
            vehicle.distance_m += length_m
        elif step.action is Action.WAIT:
            ready_s = max(drops[tag] for tag in step.tags) + here.team.clearance_s
            _wait(here, vehicle, step, max(0.0, ready_s - vehicle.now_s), said)
        else:
            _wait(here, vehicle, step, SERVICE_S / max(1, _handled(orders.steps, step)), said)
            said.append((_key(here, robot_id, "confirmation"), _confirm(here, vehicle, step, samples, drops)))
    said.append((_key(here, robot_id, "telemetry"), _telemetry(here, vehicle, None, 0.0, finished=True)))
    vehicle.now_s = END_S
    said.append((_key(here, robot_id, "telemetry"), _telemetry(here, vehicle, None, 0.0, finished=True)))
    return said


def _handled(steps: tuple[Step, ...], step: Step) -> int:
    plain = (Action.DRIVE, Action.WAIT)
    return sum(s.node == step.node and s.stop == step.stop and s.action not in plain for s in steps)


def _wait(
    here: Mission, vehicle: Vehicle, step: Step, duration_s: float, said: list[tuple[str, Message]]
) -> None:
    ticks = math.ceil(duration_s / TELEMETRY_STEP_S)
    for _ in range(ticks):
        vehicle.now_s += duration_s / ticks
        said.append((_key(here, vehicle.robot_id, "telemetry"), _telemetry(here, vehicle, step, 0.0)))


def _confirm(
    here: Mission, vehicle: Vehicle, step: Step, samples: dict[int, Sample], drops: dict[int, float]
) -> Confirmation:
    vehicle.confirmations += 1
    vehicle.on_board += 1 if step.action in (Action.COLLECT, Action.PICK) else -1
    if step.action is Action.DROP:
        drops[step.tags[0]] = vehicle.now_s
    value = None
    if step.action is Action.COLLECT:
        noise = math.sqrt(here.robot(vehicle.robot_id).noise_variance) * math.sin(7.0 * step.tags[0])
        value = truth(*node_positions(here)[step.node]) + noise
    return Confirmation(
        time_s=START_S + vehicle.now_s,
        robot=vehicle.robot_id,
        number=vehicle.confirmations,
        uid=step.uid,
        action=step.action,
        node=step.node,
        tag=step.tags[0],
        ok=True,
        value=value,
    )


def _telemetry(
    here: Mission, vehicle: Vehicle, step: Step | None, speed_m_s: float, finished: bool = False
) -> Telemetry:
    assert here.site.origin is not None
    lat_deg, lon_deg = to_globe(vehicle.x_m, vehicle.y_m, here.site.origin)
    return Telemetry(
        time_s=START_S + vehicle.now_s,
        robot=vehicle.robot_id,
        lat_deg=lat_deg,
        lon_deg=lon_deg,
        heading_deg=90.0,
        speed_m_s=speed_m_s,
        mode="AUTO",
        armed=True,
        ready_to_arm=True,
        energy_used_j=vehicle.energy_j,
        mission_version=1 if vehicle.now_s < REPLAN_S else 2,
        step_uid=None if step is None else step.uid,
        finished=finished,
        link_ok=True,
    )


def _key(here: Mission, robot_id: str, what: str) -> str:
    return vehicle_key(here.name, robot_id, what)


def _ledgers(said: list[tuple[str, Message]], base: str) -> Iterator[tuple[str, Message]]:
    """Yield the ledger after every plan and every confirmation."""
    records: dict[int, SampleRecord] = {}
    for _, message in said:
        if isinstance(message, PlanAdopted):
            for sample in message.samples:
                records.setdefault(sample.tag, SampleRecord(sample=sample, state="planned", holder=None))
        elif isinstance(message, Confirmation):
            records[message.tag] = _handed(records[message.tag], message)
        else:
            continue
        yield f"{base}/ledger", Ledger(time_s=message.time_s, samples=tuple(records.values()))


def _handed(record: SampleRecord, said: Confirmation) -> SampleRecord:
    state = {
        Action.COLLECT: "on_board", Action.DROP: "cached", Action.PICK: "on_board",
        Action.UNLOAD: "delivered",
    }[said.action]  # fmt: skip
    event = CustodyEvent(time_s=said.time_s, action=said.action, robot=said.robot, node=said.node)
    return record.model_copy(
        update={
            "state": state,
            "holder": said.robot if state == "on_board" else said.node,
            "value": record.value if said.value is None else said.value,
            "history": (*record.history, event),
        }
    )


def record(path: Path) -> Path:
    """Write the recording and return its path."""
    with RunWriter(path) as writer:
        for key, message in messages():
            writer.write(key, message)
    return path
