"""Where the team will be when a new plan can take effect: the committed part, and the state after it.

While the planner thinks and the vehicles agree, the team drives on. Each vehicle's committed part is what it
will have done or begun by then: the leg or action in progress, and whatever follows within the horizon, up to
the first gate that is still shut. A new plan begins where the committed parts end.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, field

from malipp_field.control.ledger import CustodyLedger
from malipp_field.mission import Cache, Mission, Passage, RobotState, TeamState, node_positions, passages
from malipp_field.vehicle.steps import Action, Step, VehicleMission


@dataclass(frozen=True)
class Whereabouts:
    """What is known of one vehicle at one moment."""

    mission: VehicleMission
    current: int
    """Index of the step being carried out; the number of steps when all are done."""
    last_node: str
    """The node it was at last."""
    x_m: float
    y_m: float
    energy_used_j: float
    time_ratio: float = 1.0
    """Measured over predicted driving time on the leg in progress."""
    energy_ratio: float = 1.0
    """Measured over predicted drain on the leg in progress."""


@dataclass(frozen=True)
class Outlook:
    """The state from which a new plan starts, and what each vehicle does before.

    Attributes
    ----------
    state
        Where each robot's free part begins.
    committed
        Steps of the missions in force, from the one being carried out, that every new mission begins with.
    diverges_at
        The first step of each mission in force that is not committed.
    on_board, caches
        Tags on board each robot and lying at (node, sender) when the committed parts are over.
    """

    state: TeamState
    committed: dict[str, tuple[Step, ...]]
    diverges_at: dict[str, str | None]
    on_board: dict[str, tuple[int, ...]]
    caches: dict[tuple[str, str], tuple[int, ...]]


class Roads:
    """Predicted time and energy of single edges, and of what is left of one."""

    def __init__(self, mission: Mission) -> None:
        self._mission = mission
        self._places = node_positions(mission)
        self._edges: dict[str, dict[tuple[str, str], Passage]] = {}
        for robot in mission.team.robots:
            best: dict[tuple[str, str], Passage] = {}
            for passage in passages(mission, robot.id):
                key = (passage.tail, passage.head)
                if key not in best or passage.energy_per_kg < best[key].energy_per_kg:
                    best[key] = passage
            self._edges[robot.id] = best

    def mass_kg(self, robot_id: str, load: int) -> float:
        """Return the mass of a robot with ``load`` samples on board."""
        return self._mission.robot(robot_id).empty_mass_kg + self._mission.team.sample_mass_kg * load

    def drive(
        self, robot_id: str, tail: str, head: str, load: int, at: tuple[float, float] | None = None
    ) -> tuple[float, float]:
        """Return (time in s, energy in J) from ``tail``, or from ``at`` (m) on the way, to ``head``.

        A vehicle that is on no edge (it was carried, or put down elsewhere) is taken to drive straight.
        """
        if tail == head and at is None:
            return 0.0, 0.0
        robot = self._mission.robot(robot_id)
        edge = self._edges[robot_id].get((tail, head))
        whole_m = math.dist(self._places[tail], self._places[head])
        left_m = whole_m if at is None else math.dist(at, self._places[head])
        if edge is None or whole_m <= 0.0:
            time_s, energy_per_kg = left_m / robot.speed_m_s, robot.energy_per_kg_m * left_m
        else:
            share = left_m / whole_m
            time_s, energy_per_kg = edge.time_s * share, edge.energy_per_kg * share
        return time_s, energy_per_kg * self.mass_kg(robot_id, load)


@dataclass
class _Robot:
    """One vehicle while its near future is played through."""

    robot_id: str
    node: str
    time_s: float
    energy_left_j: float
    on_board: list[int]
    collected: dict[str, int]
    committed: list[Step] = field(default_factory=list)
    diverges_at: str | None = None


class LookAhead:
    """Play the near future of a team through; see the module's docstring.

    Parameters
    ----------
    horizon_s
        How long it takes, at most, until a new plan is in force.
    """

    def __init__(self, mission: Mission, roads: Roads, horizon_s: float) -> None:
        self._mission, self._roads, self._horizon_s = mission, roads, horizon_s

    def outlook(self, now_s: float, vehicles: Mapping[str, Whereabouts], ledger: CustodyLedger) -> Outlook:
        """Return the outlook at mission time ``now_s``."""
        self._caches = {place: list(tags) for place, tags in ledger.caches().items()}
        self._available_s: dict[tuple[str, str], float] = defaultdict(float)
        robots = [
            self._play(robot.id, vehicles[robot.id], now_s, ledger) for robot in self._mission.team.robots
        ]
        caches = {place: tuple(tags) for place, tags in self._caches.items() if tags}
        state = TeamState(
            time_s=now_s,
            robots=tuple(
                RobotState(
                    id=r.robot_id,
                    node=r.node,
                    ready_s=r.time_s,
                    energy_left_j=max(0.0, r.energy_left_j),
                    on_board=len(r.on_board),
                    collected=r.collected,
                )
                for r in robots
            ),
            caches=tuple(
                Cache(node=node, sender=sender, count=len(tags), available_s=self._available_s[node, sender])
                for (node, sender), tags in caches.items()
            ),
        )
        return Outlook(
            state,
            committed={r.robot_id: tuple(r.committed) for r in robots},
            diverges_at={r.robot_id: r.diverges_at for r in robots},
            on_board={r.robot_id: tuple(r.on_board) for r in robots},
            caches=caches,
        )

    def _play(self, robot_id: str, now: Whereabouts, now_s: float, ledger: CustodyLedger) -> _Robot:
        robot = _Robot(
            robot_id,
            now.last_node,
            now_s,
            self._mission.robot(robot_id).energy_budget_j - now.energy_used_j,
            list(ledger.on_board(robot_id)),
            ledger.collected_by(robot_id),
        )
        remaining = now.mission.steps[now.current :]
        for position, step in enumerate(remaining):
            if self._is_free(robot, step, first=position == 0, now_s=now_s):
                robot.diverges_at = step.uid
                break
            if step.action is Action.DRIVE:
                self._drive(robot, step, now if position == 0 else None)
            else:
                self._handle(robot, step)
            robot.committed.append(step)
        return robot

    def _is_free(self, robot: _Robot, step: Step, *, first: bool, now_s: float) -> bool:
        """Whether the committed part ends before ``step``."""
        if step.action is Action.WAIT:
            lying = {tag for tags in self._caches.values() for tag in tags}
            if not set(step.tags) <= lying | set(robot.on_board):
                return True
        due = not first and robot.time_s >= now_s + self._horizon_s
        return due and not _same_service(robot.committed[-1], step)

    def _drive(self, robot: _Robot, step: Step, under_way: Whereabouts | None) -> None:
        at = None if under_way is None else (under_way.x_m, under_way.y_m)
        time_s, energy_j = self._roads.drive(robot.robot_id, robot.node, step.node, len(robot.on_board), at)
        robot.time_s += time_s * (under_way.time_ratio if under_way else 1.0)
        robot.energy_left_j -= energy_j * (under_way.energy_ratio if under_way else 1.0)
        robot.node = step.node

    def _handle(self, robot: _Robot, step: Step) -> None:
        """Do one payload action; the first at a stop is charged the service time of all of them."""
        if step.action is Action.WAIT:
            return
        (tag,) = step.tags
        if not robot.committed or not _same_service(robot.committed[-1], step):
            robot.time_s += self._mission.team.service_time_s
        if step.action is Action.COLLECT:
            robot.on_board.append(tag)
            robot.collected[step.node] = robot.collected.get(step.node, 0) + 1
        elif step.action is Action.PICK:
            for tags in self._caches.values():
                if tag in tags:
                    tags.remove(tag)
            robot.on_board.append(tag)
        elif tag in robot.on_board:
            robot.on_board.remove(tag)
            if step.action is Action.DROP:
                place = (step.node, robot.robot_id)
                self._caches.setdefault(place, []).append(tag)
                self._available_s[place] = max(
                    self._available_s[place], robot.time_s + self._mission.team.clearance_s
                )


def _same_service(before: Step, step: Step) -> bool:
    """Whether two steps are payload actions of one service window."""
    idle = (Action.DRIVE, Action.WAIT)
    return before.stop == step.stop and before.action not in idle and step.action not in idle
