"""From a plan to the steps of each vehicle, with an identity for every container.

Plans count samples (`eq:conservation`); vehicles handle containers. Each sample to be taken gets a tag in the
order of collection, and its identity follows it through drops and picks: what was taken first is given away
first, on board as well as in a cache.

Within a stop the order is wait, unload, collect, drop, pick, which the paper's rows always allow. Unloading
happens at depots, where nothing is collected, so what is unloaded was on board on arrival
(`eq:source_feasibility`). The load then only falls below what `eq:cap_feasibility` admits, so what is
collected fits and covers the drops (`eq:source_feasibility` again). What is picked up fits because the load
on departure does (`eq:receiver_capacity`). The wait comes before all else because the receiver's whole
service window follows the sender's departure (`eq:deaddrop_sync`).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from itertools import pairwise

from malipp_field.errors import PlanError
from malipp_field.mission import ABSTRACT_ORIGIN, Mission, node_positions, to_globe
from malipp_field.plan import Plan, Stop
from malipp_field.vehicle.gate_times import gate_times
from malipp_field.vehicle.steps import MAX_TAG, Action, GeoPoint, Sample, Step, VehicleMission
from malipp_field.vehicle.stops import Handoff, Place, all_stops, in_order


@dataclass(frozen=True)
class Custody:
    """Containers that exist before a plan begins.

    Attributes
    ----------
    on_board
        Tags that each robot carries, the first taken first.
    caches
        Tags that lie at a node, by node and sender, the first dropped first.
    next_tag
        The first tag never used or promised.
    promised
        Tags of samples that an earlier plan wanted and that are not taken yet, by (robot, node): a plan that
        still wants such a sample keeps its tag, so that vehicles it does not change need not be told.
    """

    on_board: Mapping[str, tuple[int, ...]]
    caches: Mapping[tuple[str, str], tuple[int, ...]]
    next_tag: int = 1
    promised: Mapping[tuple[str, str], tuple[int, ...]] = field(default_factory=dict)

    @classmethod
    def none(cls) -> Custody:
        """Return the custody in which every mission begins: no container has been used."""
        return cls({}, {})


@dataclass(frozen=True)
class Compiled:
    """What each vehicle is to do, and the provenance of the containers this plan fills, by tag."""

    missions: dict[str, VehicleMission]
    samples: dict[int, Sample]


@dataclass
class _Handled:
    """Containers handled at one stop, in order; drops and picks with the other robot."""

    unload: list[int]
    collect: list[int]
    drop: list[tuple[int, str]] = field(default_factory=list)
    pick: list[tuple[int, str]] = field(default_factory=list)
    doubtful: frozenset[int] = frozenset()
    """Those that may not be there, after a pick that goes on without them."""


def compile_plan(
    mission: Mission,
    plan: Plan,
    custody: Custody | None = None,
    start_s: float | None = None,
    run: int = 0,
) -> Compiled:
    """Return the steps of every vehicle of a plan.

    Parameters
    ----------
    mission
        The mission planned for. An abstract site is laid at `ABSTRACT_ORIGIN`.
    plan
        A verified plan of that mission.
    custody
        Containers on board and in caches when the plan begins; by default none.
    start_s
        When mission time 0 is, in seconds since the Unix epoch. Without it no gate opens by time.
    run
        Number of this run of the mission, the same for all its plans; 0: none is told to the vehicles.

    Raises
    ------
    PlanError
        When the plan has no routes, belongs to another mission, gives away containers that are not there,
        waits in a circle, needs more tags than there are, or has a time gate that a vehicle would mistake
        for one of another day.
    """
    _check_fits(mission, plan)
    custody = custody or Custody.none()
    samples = _new_samples(mission, plan, custody)
    handled = _follow_containers(mission, plan, custody, samples)
    opens_s = (
        {}
        if start_s is None
        else {place: start_s + gate.opens_s for place, gate in gate_times(mission, plan).items()}
    )
    points = {node: _point(mission, place) for node, place in node_positions(mission).items()}
    missions = {
        robot.id: VehicleMission(
            robot=robot.id,
            version=plan.version,
            home=points[mission.robot(robot.id).start],
            steps=tuple(
                step
                for index, stop in enumerate(robot.route)
                for step in _steps(
                    f"v{plan.version}/{robot.id}",
                    index,
                    stop,
                    handled[robot.id, index],
                    points,
                    opens_s.get((robot.id, index)),
                )
            ),
            payload=mission.vehicle(robot.id).payload,
            run=run,
        )
        for robot in plan.robots
    }
    return Compiled(missions, {sample.tag: sample for found in samples.values() for sample in found})


def _check_fits(mission: Mission, plan: Plan) -> None:
    if not plan.robots:
        raise PlanError(f"the plan has no routes ({plan.reason or plan.status}): there is nothing to drive")
    if plan.mission != mission.name:
        raise PlanError(f"the plan is for mission '{plan.mission}', not for '{mission.name}'")
    robots = {robot.id for robot in mission.team.robots}
    nodes = {node.id for node in mission.site.nodes}
    for robot in plan.robots:
        if robot.id not in robots:
            raise PlanError(
                f"the plan has a route for '{robot.id}', which mission '{mission.name}' does not have"
            )
        for index, stop in enumerate(robot.route):
            if index and not stop.path:
                raise PlanError(f"{robot.id}, stop {index}: the leg to '{stop.node}' has no path")
            for node in (stop.node, *(stop.path or ())):
                if node not in nodes:
                    raise PlanError(
                        f"{robot.id}, stop {index}: mission '{mission.name}' has no node '{node}'"
                    )


def _new_samples(mission: Mission, plan: Plan, custody: Custody) -> dict[Place, list[Sample]]:
    """Tag every sample to be taken, in order of time and then of the robots in the mission file."""
    order = {robot.id: position for position, robot in enumerate(mission.team.robots)}
    stops = sorted(all_stops(plan), key=lambda found: (found[1].depart_s, order[found[0][0]], found[0][1]))
    promised = {key: deque(tags) for key, tags in custody.promised.items()}
    unused = iter(range(custody.next_tag, MAX_TAG + 1))

    def tag_for(robot: str, node: str) -> int:
        kept = promised.get((robot, node))
        if kept:
            return kept.popleft()
        for tag in unused:
            return tag
        raise PlanError(f"more containers are needed, but all tags up to {MAX_TAG} have been used")

    return {
        (robot, index): [
            Sample(tag=tag_for(robot, stop.node), node=stop.node, sampler=robot) for _ in range(stop.collect)
        ]
        for (robot, index), stop in stops
    }


def _follow_containers(
    mission: Mission, plan: Plan, custody: Custody, samples: Mapping[Place, list[Sample]]
) -> dict[Place, _Handled]:
    """Return which containers are handled where."""
    lenient = {robot.id for robot in plan.robots if mission.vehicle(robot.id).if_missing == "go_on"}
    containers = _Containers(plan, custody, lenient)
    stops = dict(all_stops(plan))
    return {
        place: containers.visit(place, stops[place], [sample.tag for sample in samples[place]])
        for place in in_order(plan)
    }


class _Containers:
    """Where every container is while the stops of a plan are gone through in order."""

    def __init__(self, plan: Plan, custody: Custody, lenient: set[str]) -> None:
        self._on_board = {robot.id: deque(custody.on_board.get(robot.id, ())) for robot in plan.robots}
        self._caches = {key: deque(tags) for key, tags in custody.caches.items()}
        self._dropped: dict[Handoff, deque[int]] = {}
        self._planned = _planned_drops(plan)
        self._lenient = lenient  # robots that go on where there is nothing to pick
        self._doubtful: set[int] = set()

    def visit(self, place: Place, stop: Stop, collected: list[int]) -> _Handled:
        """Carry out one stop; raises `PlanError` when something is not there."""
        robot, load = place[0], self._on_board[place[0]]
        unloaded = _take(load, stop.unload, place, stop, "on board")
        load.extend(collected)
        here = _Handled(unloaded, collected)
        for receiver, count in stop.drop.items():
            given = _take(load, count, place, stop, "on board")
            self._dropped.setdefault((stop.node, robot, receiver), deque()).extend(given)
            here.drop += [(tag, receiver) for tag in given]
        for sender, count in stop.pick.items():
            found = self._pick(place, stop, sender, count)
            load.extend(found)
            here.pick += [(tag, sender) for tag in found]
            if robot in self._lenient:
                self._doubtful.update(found)
            else:  # it does not go on before it has them
                self._doubtful.difference_update(found)
        here.doubtful = frozenset(self._doubtful)
        return here

    def _pick(self, place: Place, stop: Stop, sender: str, count: int) -> list[int]:
        """Take what this plan leaves for the robot, and before it the rest from the cache of old."""
        handoff = (stop.node, sender, place[0])
        new = self._planned.get(handoff, 0)
        cache = self._caches.get((stop.node, sender), deque())
        where = f"left by {sender}"
        old = _take(cache, count - new, place, stop, where)
        return old + _take(self._dropped.get(handoff, deque()), new, place, stop, where)


def _planned_drops(plan: Plan) -> dict[Handoff, int]:
    """Return how many containers the plan leaves for each handoff."""
    counts: dict[Handoff, int] = {}
    for (robot, _), stop in all_stops(plan):
        for receiver, count in stop.drop.items():
            key = (stop.node, robot, receiver)
            counts[key] = counts.get(key, 0) + count
    return counts


def _take(tags: deque[int], count: int, place: Place, stop: Stop, where: str) -> list[int]:
    """Return the first ``count`` of ``tags``, taken off."""
    if not 0 <= count <= len(tags):
        raise PlanError(
            f"{place[0]}, stop {place[1]} at '{stop.node}': the plan counts on {count} containers {where}, "
            f"there are {len(tags)}"
        )
    return [tags.popleft() for _ in range(count)]


def _steps(
    prefix: str,
    index: int,
    stop: Stop,
    handled: _Handled,
    points: Mapping[str, GeoPoint],
    gate_s: float | None,
) -> Iterator[Step]:
    """Yield the steps of one stop: the leg to it, then its actions, one container each."""
    for leg, (tail, head) in enumerate(pairwise(stop.path or ()), start=1):
        if tail != head:  # the leg from a depot to its own terminal copy goes nowhere
            uid = f"{prefix}/{index}.{leg}/drive/{head}"
            yield Step(uid=uid, action=Action.DRIVE, node=head, stop=index, place=points[head])
    here = f"{prefix}/{index}"
    if handled.pick:
        yield Step(
            uid=f"{here}/wait", action=Action.WAIT, node=stop.node, stop=index, place=points[stop.node],
            tags=tuple(tag for tag, _ in handled.pick), not_before_s=gate_s,
        )  # fmt: skip
    actions: list[tuple[Action, int, str | None]] = [
        *((Action.UNLOAD, tag, None) for tag in handled.unload),
        *((Action.COLLECT, tag, None) for tag in handled.collect),
        *((Action.DROP, tag, peer) for tag, peer in handled.drop),
        *((Action.PICK, tag, peer) for tag, peer in handled.pick),
    ]
    for action, tag, peer in actions:
        yield Step(
            uid=f"{here}/{action.value}/{tag}", action=action, node=stop.node, stop=index,
            place=points[stop.node], tags=(tag,), peer=peer,
            if_missing="go_on" if tag in handled.doubtful else "hold",
        )  # fmt: skip


def _point(mission: Mission, place_m: tuple[float, float]) -> GeoPoint:
    lat_deg, lon_deg = to_globe(*place_m, mission.site.origin or ABSTRACT_ORIGIN)
    return GeoPoint(lat_deg=lat_deg, lon_deg=lon_deg)
