"""Rules of sampling, payload and dead drops: what a robot does at a stop, and what two of them do at a node.

Incoming and outgoing counts Q are the `payload` that the plan states, so each stop is judged by itself.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator

from malipp_field.planner.verifier.case import Case, Violation, Visit, above

Handoff = tuple[str, str, str]
"""Node, sender, receiver."""


def visit_rules(case: Case, visit: Visit) -> Iterator[Violation]:
    """Yield the rules of one stop: sampling, unloading, custody and capacity."""
    yield from _sampling(case, visit)
    yield from _unloading(visit)
    yield from _balance(visit)
    yield from _capacity(visit)


def handoff_rules(case: Case) -> Iterator[Violation]:
    """Yield the rules between robots: who may hand over, pairing, caches and timing."""
    for visit in case.visits():
        yield from _partners(case, visit)
    drops, picks = _transfers(case)
    for handoff in sorted({*drops, *picks}):
        yield from _pairing(case, handoff, drops.get(handoff, []), picks.get(handoff, []))
        yield from _handoff(case, handoff, drops.get(handoff, []), picks.get(handoff, []))
        node, sender, receiver = handoff
        if sender < receiver and handoff in drops and (node, receiver, sender) in drops:
            yield Violation("eq:no_mutual", sender, node, f"hands over to {receiver} and is handed over to")
    yield from _caches(case, drops, picks)


def _sampling(case: Case, visit: Visit) -> Iterator[Violation]:
    stop, robot = visit.stop, visit.robot
    if not stop.collect:
        return
    if case.roles.get(stop.node) != "candidate":
        yield visit.breaks("eq:sampling_visit", "samples are taken at candidates only")
    if stop.node in case.state.barren:
        yield visit.breaks("eq:sampling_visit", "nothing can be taken here, as was found out on the spot")
    total = stop.collect + visit.begin.collected.get(stop.node, 0)
    if total > robot.samples_per_node:
        yield visit.breaks(
            "eq:sampling_visit", f"takes {total} here in all, samples_per_node is {robot.samples_per_node}"
        )


def _unloading(visit: Visit) -> Iterator[Violation]:
    stop, robot = visit.stop, visit.robot
    if stop.unload and stop.node not in robot.depots:
        yield visit.breaks("eq:unload_bound", f"may unload only at {', '.join(robot.depots)}")
    elif stop.unload > robot.payload_capacity:
        yield visit.breaks(
            "eq:unload_bound", f"unloads {stop.unload}, carries {robot.payload_capacity} at most"
        )


def _balance(visit: Visit) -> Iterator[Violation]:
    stop = visit.stop
    dropped, picked = sum(stop.drop.values()), sum(stop.pick.values())
    on_board = visit.load_in + stop.collect
    if on_board + picked != stop.payload + dropped + stop.unload:
        yield visit.breaks(
            "eq:conservation",
            f"{visit.load_in} + {stop.collect} collected + {picked} picked is not "
            f"{stop.payload} + {dropped} dropped + {stop.unload} unloaded",
        )
    if visit.last and stop.payload:
        yield visit.breaks("eq:conservation", f"the route ends with {stop.payload} samples on board")
    if stop.unload + dropped > on_board:
        yield visit.breaks(
            "eq:source_feasibility",
            f"gives away {stop.unload + dropped} of {on_board} that it brought or took",
        )


def _capacity(visit: Visit) -> Iterator[Violation]:
    stop, capacity = visit.stop, visit.robot.payload_capacity
    dropped, picked = sum(stop.drop.values()), sum(stop.pick.values())
    kept = visit.load_in + stop.collect - stop.unload
    if kept > capacity:
        yield visit.breaks("eq:cap_feasibility", f"holds {kept} after unloading, capacity is {capacity}")
    if dropped > capacity:
        yield visit.breaks("eq:handoff_capacity", f"drops {dropped}, capacity is {capacity}")
    if picked and picked > capacity - (kept - dropped):
        yield visit.breaks(
            "eq:receiver_capacity", f"picks {picked}, has room for {capacity - (kept - dropped)}"
        )
    if stop.payload > capacity and not visit.last:
        yield visit.breaks("eq:payload", f"departs with {stop.payload}, capacity is {capacity}")


def _partners(case: Case, visit: Visit) -> Iterator[Violation]:
    stop = visit.stop
    for other in sorted({*stop.drop, *stop.pick} - set(case.team)):
        yield visit.breaks("format:names", f"the mission has no robot {other}")
    if visit.robot.id in stop.drop:
        yield visit.breaks("subsec:custody", "a robot hands over to another, not to itself")
    if visit.terminal and (stop.drop or stop.pick):
        yield visit.breaks("subsec:custody", "nothing is handed over at a terminal")


def _transfers(case: Case) -> tuple[dict[Handoff, list[Visit]], dict[Handoff, list[Visit]]]:
    """Return the stops that drop and that pick, by handoff; names that mean nobody are left out."""
    drops: dict[Handoff, list[Visit]] = defaultdict(list)
    picks: dict[Handoff, list[Visit]] = defaultdict(list)
    for visit in case.visits():
        here, me = visit.stop.node, visit.robot.id
        for receiver in case.team.keys() & visit.stop.drop.keys() - {me}:
            drops[here, me, receiver].append(visit)
        for sender in case.team.keys() & visit.stop.pick.keys():
            picks[here, sender, me].append(visit)
    return drops, picks


def _dropped(handoff: Handoff, drops: list[Visit]) -> int:
    return sum(visit.stop.drop[handoff[2]] for visit in drops)


def _picked(handoff: Handoff, picks: list[Visit]) -> int:
    return sum(visit.stop.pick[handoff[1]] for visit in picks)


def _pairing(case: Case, handoff: Handoff, drops: list[Visit], picks: list[Visit]) -> Iterator[Violation]:
    """Yield drops that are not picked whole; picks beyond the drops are judged with the caches."""
    node, sender, receiver = handoff
    dropped, picked = _dropped(handoff, drops), _picked(handoff, picks)
    if not _visits(case, receiver, node):
        yield Violation(
            "eq:delta_visits", sender, node, f"drops {dropped} for {receiver}, which does not stop here"
        )
    elif picked < dropped:
        yield Violation("format:pairs", sender, node, f"drops {dropped} for {receiver}, which picks {picked}")


def _handoff(case: Case, handoff: Handoff, drops: list[Visit], picks: list[Visit]) -> Iterator[Violation]:
    node, sender, receiver = handoff
    most = min(case.team[sender].payload_capacity, case.team[receiver].payload_capacity)
    if _dropped(handoff, drops) > most:
        yield Violation(
            "eq:delta_amount", sender, node, f"hands {_dropped(handoff, drops)} to {receiver}, {most} at most"
        )
    if not drops or not picks:
        return
    free_s = max(visit.stop.depart_s for visit in drops) + case.mission.team.clearance_s
    begins_s = min(_window_s(case, visit) for visit in picks)
    if above(free_s, begins_s):
        yield Violation(
            "eq:deaddrop_sync", receiver, node,
            f"service begins at {begins_s:.6g} s, the drop of {sender} may be fetched from {free_s:.6g} s on",
        )  # fmt: skip


def _caches(
    case: Case, drops: dict[Handoff, list[Visit]], picks: dict[Handoff, list[Visit]]
) -> Iterator[Violation]:
    """Yield what is fetched without having been left, left without being fetched, or fetched too early."""
    fetched: dict[tuple[str, str], list[tuple[float, int]]] = defaultdict(list)
    for handoff, visits in picks.items():
        count = _picked(handoff, visits) - _dropped(handoff, drops.get(handoff, []))
        if count > 0:
            fetched[handoff[:2]].append((min(_window_s(case, visit) for visit in visits), count))
    stored: dict[tuple[str, str], list[tuple[float, int]]] = defaultdict(list)
    for cache in case.state.caches:
        stored[cache.node, cache.sender].append((cache.available_s, cache.count))
    for node, sender in sorted({*fetched, *stored}):
        yield from _cache(case, node, sender, stored[node, sender], fetched[node, sender])


def _cache(
    case: Case, node: str, sender: str, stored: list[tuple[float, int]], fetched: list[tuple[float, int]]
) -> Iterator[Violation]:
    """Yield the faults of what one robot left at one node; both lists hold (time in seconds, count)."""
    left, taken = sum(count for _, count in stored), sum(count for _, count in fetched)
    if taken > left and not left and not _visits(case, sender, node):
        yield Violation("eq:delta_visits", sender, node, f"{taken} are picked here, where it does not stop")
    elif taken > left:
        yield Violation("format:pairs", sender, node, f"{taken - left} are picked that it does not drop")
    elif taken < left:
        yield Violation("format:caches", sender, node, f"{left - taken} of its samples lie here and stay")
    for begins_s, _ in fetched if taken <= left else []:
        by_then = sum(count for time_s, count in fetched if time_s <= begins_s)
        ready = sum(count for time_s, count in stored if not above(time_s, begins_s))
        if by_then > ready:
            yield Violation(
                "format:available", sender, node,
                f"{by_then} are fetched by {begins_s:.6g} s, when {ready} may be",
            )  # fmt: skip


def _visits(case: Case, robot_id: str, node: str) -> bool:
    return any(visit.robot.id == robot_id and visit.stop.node == node for visit in case.visits())


def _window_s(case: Case, visit: Visit) -> float:
    """Return when the service window of a stop begins."""
    return visit.stop.depart_s - case.mission.team.service_time_s
