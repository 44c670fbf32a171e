"""The truth the team works in: ground, containers and the field, whatever anybody plans or believes."""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from malipp_field.field import candidate_ids, covariance
from malipp_field.mission import (
    ABSTRACT_ORIGIN,
    Mission,
    Passage,
    Robot,
    locate,
    node_positions,
    passages,
    to_globe,
    to_local,
)
from malipp_field.sim.motion import Disc, Leg, Position, Rates, distance_to_segment_m, stretches
from malipp_field.vehicle.payload_protocol import Result
from malipp_field.vehicle.steps import Action

ON_THE_SPOT_M = 0.1
"""A place within this of a node or an edge is on it: positions travel in units of 1e-7 degree (1.1 cm)."""
REACH_M = 3.0
"""How far a payload mechanism reaches from where the rover stands."""


@dataclass(frozen=True)
class Outcome:
    """What came of a payload action."""

    result: Result
    value: float | None = None


@dataclass(frozen=True)
class Container:
    """One container as it really is.

    Attributes
    ----------
    node, sampler
        Where its sample was taken, and by which robot.
    holder, place, delivered_to
        On which robot it is, where it lies, or at which depot; all `None` when it is gone.
    left_by
        Who put it where it lies.
    """

    node: str
    sampler: str
    holder: str | None = None
    place: Position | None = None
    delivered_to: str | None = None
    left_by: str | None = None


class World:
    """Ground, containers and the true field of one mission.

    Everything random follows from ``mission.simulation.seed``; a reading also from its container's tag, so
    it does not depend on the order in which the team works.

    Parameters
    ----------
    mission
        Nodes, edges and robots as planned with, and ``simulation``, which no planner looks at.
    """

    def __init__(self, mission: Mission) -> None:
        self.mission = mission
        self.origin = mission.site.origin or ABSTRACT_ORIGIN
        self.places = node_positions(mission)
        self.true_values = _draw_field(mission, self.places)
        self._discs = [
            Disc(locate(patch, mission.site.origin), patch.radius_m, patch.speed_factor, patch.energy_factor)
            for patch in mission.simulation.terrain
        ]
        # Straight connections of a `complete` site have factor 1, which is what lies off any edge as well.
        given = mission.model_copy(update={"site": mission.site.model_copy(update={"complete": False})})
        self._passages = {robot.id: passages(given, robot.id) for robot in mission.team.robots}
        # By tag, or by a negative number while nobody has labelled it; the one moved last is the last.
        self._containers: dict[int, Container] = {}
        self._done: dict[tuple[str, Action, int], tuple[Position, Outcome]] = {}
        self._run: int | None = None
        self._reach_m = _reach_m(list(self.places.values()))
        # The conversion costs more than all else in telemetry; a rover that stands asks the same again.
        self._to_globe = functools.lru_cache(maxsize=1024)(to_globe)

    def globe(self, place: Position) -> tuple[float, float]:
        """Return (latitude, longitude) in degrees."""
        return self._to_globe(*place, self.origin)

    def local(self, lat_deg: float, lon_deg: float) -> Position:
        """Return (east, north) in metres; the exact position of a node where there is one on the spot."""
        place = to_local(lat_deg, lon_deg, self.origin)
        node = self._node_near(place, ON_THE_SPOT_M)
        return place if node is None else self.places[node]

    def leg(self, robot_id: str, start: Position, end: Position) -> Leg:
        """Return the straight leg between two places as that robot finds it.

        On an edge it may drive, its length and factors hold (also for a part of the edge, such as after a
        stop on the way); elsewhere the straight line with factor 1. Terrain comes on top of either.
        """
        rates = self._rates(self.mission.robot(robot_id), start, end)
        return Leg(start, end, stretches(start, end, rates, self._discs))

    def mass_kg(self, robot_id: str) -> float:
        """Return m_r^0 + m^s times the samples on board."""
        robot = self.mission.robot(robot_id)
        return robot.empty_mass_kg + self.mission.team.sample_mass_kg * len(self.on_board(robot_id))

    @property
    def containers(self) -> Mapping[int, Container]:
        """All containers there have been, by tag; those without a label by a negative number."""
        return MappingProxyType(self._containers)

    def on_board(self, robot_id: str) -> list[int]:
        """Return the tags of the containers that robot carries, in the order in which they came."""
        return [tag for tag, container in self._containers.items() if container.holder == robot_id]

    def caches(self) -> dict[int, Position]:
        """Return where each container lies that waits to be fetched."""
        return {tag: c.place for tag, c in self._containers.items() if c.place is not None}

    def delivered(self) -> dict[int, str]:
        """Return the depot each delivered container is at."""
        return {tag: c.delivered_to for tag, c in self._containers.items() if c.delivered_to is not None}

    def remove(self, tag: int) -> None:
        """Take a lying container away, as a passer-by might."""
        self._containers[tag] = replace(self._containers[tag], place=None)

    def begin_run(self, run: int) -> None:
        """Note which run of a mission is carried out: in another one tags are given anew.

        What there is from before stays where it is, and its labels mean nothing any more.
        """
        if self._run not in (None, run):
            self._done.clear()
            self._containers = {-n: old for n, old in enumerate(self._containers.values(), start=1)}
        self._run = run

    def act(self, robot_id: str, action: Action, tag: int, place: Position) -> Outcome:
        """Carry out a payload action on the container of that tag, or say why it cannot be done.

        Where there is none with that label, the first without any is taken for it and labelled. What the
        robot did already at this place is confirmed again and not done twice: a vehicle may be told to begin
        a step anew after a restart, a hold or a replan.
        """
        outcome = self._try(self.mission.robot(robot_id), action, tag, place)
        key = (robot_id, action, tag)
        if outcome.result == "ok":
            self._done[key] = place, outcome
        elif key in self._done and math.dist(self._done[key][0], place) <= self._reach_m:
            return self._done[key][1]
        return outcome

    def work(self, robot_id: str, actions: Collection[Action], place: Position) -> Outcome:
        """Have hardware that knows no tags do whichever of ``actions`` there is something to do for.

        It takes what came first: on board, or among what others left. At a depot what is put down is
        delivered; where a container lies and a sample could be taken, the container is. It cannot tell what
        it did, so its outcome is for whoever looks at it.
        """
        robot = self.mission.robot(robot_id)
        on_board, here = self.on_board(robot_id), self._lying(place)
        left_by_others = [tag for tag in here if self._containers[tag].left_by != robot_id]
        node = self._node_near(place, self._reach_m)
        if Action.UNLOAD in actions and node in robot.depots and on_board:
            return self._put_down(robot, Action.UNLOAD, on_board[0], place)
        if Action.PICK in actions and left_by_others:
            return self._pick(robot, left_by_others[0], left_by_others[0])
        if Action.COLLECT in actions and node in self.true_values:
            return replace(self._collect(robot, min([0, *self._containers]) - 1, place), value=None)
        if Action.DROP in actions and on_board:
            return self._put_down(robot, Action.DROP, on_board[0], place)
        return Outcome("missing")

    def _try(self, robot: Robot, action: Action, tag: int, place: Position) -> Outcome:
        if tag <= 0 or action in (Action.DRIVE, Action.WAIT):
            return Outcome("unknown")
        if action is Action.COLLECT:
            return self._collect(robot, tag, place)
        meant = self._meant(tag, self._lying(place) if action is Action.PICK else self.on_board(robot.id))
        if meant is None:
            return Outcome("missing")
        if action is Action.PICK:
            return self._pick(robot, meant, tag)
        return self._put_down(robot, action, meant, place, tag)

    def _lying(self, place: Position) -> list[int]:
        """Return what lies within reach, the first left first."""
        return [tag for tag, lying in self.caches().items() if math.dist(lying, place) <= self._reach_m]

    def _meant(self, tag: int, among: list[int]) -> int | None:
        """Return which container is taken for the one of that tag."""
        if tag in self._containers:
            return tag if tag in among else None
        return next((found for found in among if found < 0), None)

    def _move(self, known: int, tag: int, *, holder: str | None = None, place: Position | None = None,
              delivered_to: str | None = None, left_by: str | None = None) -> Outcome:  # fmt: skip
        """Put a container somewhere else, and the label ``tag`` on it."""
        self._containers[tag] = replace(
            self._containers.pop(known), holder=holder, place=place, delivered_to=delivered_to,
            left_by=left_by,
        )  # fmt: skip
        return Outcome("ok")

    def _collect(self, robot: Robot, tag: int, place: Position) -> Outcome:
        node = self._node_near(place, self._reach_m)
        if node is None or node not in self.true_values or tag in self._containers:
            return Outcome("unknown")
        if len(self.on_board(robot.id)) >= robot.payload_capacity:
            return Outcome("full")
        self._containers[tag] = Container(node, robot.id, holder=robot.id)
        noise = np.random.default_rng([self.mission.simulation.seed, abs(tag)]).normal()
        return Outcome("ok", self.true_values[node] + math.sqrt(robot.noise_variance) * noise)

    def _pick(self, robot: Robot, known: int, tag: int) -> Outcome:
        if len(self.on_board(robot.id)) >= robot.payload_capacity:
            return Outcome("full")
        return self._move(known, tag, holder=robot.id)

    def _put_down(
        self, robot: Robot, action: Action, known: int, place: Position, tag: int | None = None
    ) -> Outcome:
        label = known if tag is None else tag
        if action is Action.DROP:
            return self._move(known, label, place=place, left_by=robot.id)
        depot = self._node_near(place, self._reach_m)
        if depot not in robot.depots:
            return Outcome("unknown")
        return self._move(known, label, delivered_to=depot)

    def _rates(self, robot: Robot, start: Position, end: Position) -> Rates:
        fitting = [(rank, p) for p in self._passages[robot.id] if (rank := self._rank(p, start, end))]
        if not fitting:
            return Rates(robot.speed_m_s, robot.energy_per_kg_m)
        passage = min(fitting, key=lambda pair: pair[0])[1]
        straight_m = math.dist(self.places[passage.tail], self.places[passage.head])
        return Rates(straight_m / passage.time_s, passage.energy_per_kg / straight_m)

    def _rank(self, passage: Passage, start: Position, end: Position) -> tuple[bool, float] | None:
        """Return how well an edge fits a straight piece (the least is the best), `None` when it does not."""
        tail, head = self.places[passage.tail], self.places[passage.head]
        off_start_m, from_m = distance_to_segment_m(start, tail, head)
        off_end_m, to_m = distance_to_segment_m(end, tail, head)
        if max(off_start_m, off_end_m) > ON_THE_SPOT_M or to_m <= from_m:
            return None
        whole = math.dist(start, tail) <= ON_THE_SPOT_M and math.dist(end, head) <= ON_THE_SPOT_M
        return not whole, math.dist(tail, head)

    def _node_near(self, place: Position, within_m: float) -> str | None:
        node = min(self.places, key=lambda n: math.dist(self.places[n], place))
        return node if math.dist(self.places[node], place) <= within_m else None


def _draw_field(mission: Mission, places: dict[str, Position]) -> dict[str, float]:
    """Return one draw of the field f ~ GP(0, k) at every candidate."""
    nodes = candidate_ids(mission)
    if not nodes:
        return {}
    at = np.array([places[node] for node in nodes])
    variances, axes = np.linalg.eigh(covariance(mission.field.kernel, at, at))
    # A smooth kernel is singular to rounding: the square root by eigenvalues takes no harm from it.
    root = axes * np.sqrt(np.maximum(variances, 0.0))
    draw = np.random.default_rng(mission.simulation.seed).normal(size=len(nodes))
    return dict(zip(nodes, (root @ draw).tolist(), strict=True))


def _reach_m(places: list[Position]) -> float:
    """Return how far a rover reaches: on a small site never as far as to a neighbouring node."""
    gaps = [gap for a, b in itertools.combinations(places, 2) if (gap := math.dist(a, b)) > 0.0]
    return min([REACH_M, *(gap / 2 for gap in gaps)])
