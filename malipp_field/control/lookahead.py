"""Where the team will be when a new plan can take effect: the committed part, and the state after it.

While the planner thinks and the vehicles agree, the team drives on. Each vehicle's committed part is what it
will have done or begun by then: the leg or action in progress, and whatever follows within the horizon, up to
the first gate (no gate is opened while a new plan is made). A new plan begins where the committed parts end.
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
    """Driving time on the leg in progress, over what the mission file says."""
    energy_ratio: float = 1.0
    """Drain on the leg in progress, over what the mission file says."""


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
    promised
        Tags still to be collected after them, by (robot, node): as of the outlook, not of when the plan is
        there, or a vehicle that went on meanwhile as it was told would seem to need new ones.
    """

    state: TeamState
    committed: dict[str, tuple[Step, ...]]
    diverges_at: dict[str, str | None]
    on_board: dict[str, tuple[int, ...]]
    caches: dict[tuple[str, str], tuple[int, ...]]
    promised: dict[tuple[str, str], tuple[int, ...]]


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
    """One vehicle while its near future is played through.

    `soonest_s` is when it gets there if nothing delays it: what it may have begun by then is committed, or it
    would have left the committed part when its new mission comes. `time_s` and energy are as expected.
    """

    robot_id: str
    node: str
    time_s: float
    soonest_s: float
    energy_left_j: float
    on_board: list[int]
    collected: dict[str, int]
    committed: list[Step] = field(default_factory=list)
    diverges_at: str | None = None


class LookAhead:
    """Play the near future of a team through; see the module's docstring.

    Parameters
    ----------
    roads
        As the mission file has them.
    known
        As they were found to be; the leg in progress is judged by its own ratios instead.
    horizon_s
        How long it takes, at most, until a new plan is in force.
    """

    def __init__(self, mission: Mission, roads: Roads, known: Roads, horizon_s: float) -> None:
        self._mission, self._roads, self._known, self._horizon_s = mission, roads, known, horizon_s

    def outlook(self, now_s: float, vehicles: Mapping[str, Whereabouts], ledger: CustodyLedger) -> Outlook:
        """Return the outlook at mission time ``now_s``."""
        self._caches = {place: list(tags) for place, tags in ledger.caches().items()}
        clear_s = now_s + self._mission.team.clearance_s  # at the latest, for what lies there now
        self._available_s = defaultdict(float, dict.fromkeys(self._caches, clear_s))
        self._in_force_s = now_s + self._horizon_s
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
                    ready_s=max(r.time_s, self._in_force_s),
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
            barren=ledger.barren,
        )
        committed_tags = {tag for robot in robots for step in robot.committed for tag in step.tags}
        return Outlook(
            state,
            committed={r.robot_id: tuple(r.committed) for r in robots},
            diverges_at={r.robot_id: r.diverges_at for r in robots},
            on_board={r.robot_id: tuple(r.on_board) for r in robots},
            caches=caches,
            promised={
                (r.robot_id, node): tuple(tag for tag in tags if tag not in committed_tags)
                for r in robots
                for node, tags in ledger.promised_to(r.robot_id).items()
            },
        )

    def _play(self, robot_id: str, now: Whereabouts, now_s: float, ledger: CustodyLedger) -> _Robot:
        robot = _Robot(
            robot_id,
            now.last_node,
            now_s,
            now_s,
            self._mission.robot(robot_id).energy_budget_j - now.energy_used_j,
            list(ledger.on_board(robot_id)),
            ledger.collected_by(robot_id),
        )
        for position, step in enumerate(now.mission.steps[now.current :]):
            if self._is_free(robot, step):
                robot.diverges_at = step.uid
                break
            if step.action is Action.DRIVE:
                self._drive(robot, step, now if position == 0 else None)
            else:
                self._handle(robot, step)
            robot.committed.append(step)
        return robot

    def _is_free(self, robot: _Robot, step: Step) -> bool:
        """Whether the committed part ends before ``step``."""
        if step.action is Action.WAIT or not robot.committed:
            return step.action is Action.WAIT
        return robot.soonest_s >= self._in_force_s and not _same_service(robot.committed[-1], step)

    def _drive(self, robot: _Robot, step: Step, under_way: Whereabouts | None) -> None:
        at = None if under_way is None else (under_way.x_m, under_way.y_m)
        edge = (robot.robot_id, robot.node, step.node, len(robot.on_board), at)
        soonest_s, given_j = self._roads.drive(*edge)
        if under_way is None:
            time_s, energy_j = self._known.drive(*edge)
        else:
            time_s, energy_j = soonest_s * under_way.time_ratio, given_j * under_way.energy_ratio
        robot.soonest_s += soonest_s
        robot.time_s += time_s
        robot.energy_left_j -= energy_j
        robot.node = step.node

    def _handle(self, robot: _Robot, step: Step) -> None:
        """Do one payload action; the first at a stop is charged the service time of all of them."""
        (tag,) = step.tags
        if not robot.committed or not _same_service(robot.committed[-1], step):
            robot.time_s += self._mission.team.service_time_s
            robot.soonest_s += self._mission.team.service_time_s
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
