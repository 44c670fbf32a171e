"""From a schedule for each robot to routes: who drops what for whom, in an order without circular waits."""

from __future__ import annotations

from dataclasses import dataclass, field

from malipp_field.planner.exact.schedules import Codes, Robot
from malipp_field.planner.extract import Route, TeamPlan, Visit, team_plan, tidy
from malipp_field.planner.problem import Problem


@dataclass
class _Stop:
    """A stop while it is being worked out; exchange is what the schedule is capable of."""

    place: int
    node: int
    collect: int
    exchange: int
    unload: bool
    done: bool = False
    drop: dict[int, int] = field(default_factory=dict)
    pick: dict[int, int] = field(default_factory=dict)
    fetch: dict[int, int] = field(default_factory=dict)
    unloaded: int = 0


def realise(problem: Problem, robots: list[Robot], schedules: list[Codes]) -> TeamPlan | None:
    """Return a plan that takes these samples, or None where the cheapest orders wait for each other.

    Robots go on as far as they can: a pick waits until all that is to be dropped at its node has been, and
    takes no more than lies there. None does not prove that there is no other order.
    """
    orders = [robot.order(codes)[0] for robot, codes in zip(robots, schedules, strict=True)]
    stops = [
        [_stop(robot, codes, place) for place in order]
        for robot, codes, order in zip(robots, schedules, orders, strict=True)
    ]
    if not _run(problem, stops):
        return None
    routes = tuple(_route(problem, robots[r], r, own) for r, own in enumerate(stops))
    return team_plan(problem, routes)


def _stop(robot: Robot, codes: Codes, place: int) -> _Stop:
    code = int(codes[place]) + robot.capacity
    return _Stop(
        place=place,
        node=robot.places[place],
        collect=int(robot.taken_of[code]),
        exchange=int(robot.exchange_of[code]),
        unload=bool(robot.actor.depot[place]),
    )


def _run(problem: Problem, stops: list[list[_Stop]]) -> bool:
    """Play all routes through; return False where they come to a standstill or leave something lying."""
    lying: dict[int, list[tuple[str, int]]] = {}
    for s, stock in enumerate(problem.stocks):
        lying.setdefault(stock.node, []).extend([("stock", s)] * stock.count)
    at = [0] * len(stops)
    load = [robot.on_board for robot in problem.robots]
    moving = True
    while moving:
        moving = False
        for r, own in enumerate(stops):
            while at[r] < len(own) and _ready(stops, r, own[at[r]]):
                load[r] = _operate(stops, r, own[at[r]], load[r], lying)
                at[r] += 1
                moving = True
    arrived = all(at[r] == len(own) for r, own in enumerate(stops))
    return arrived and not any(lying.values())


def _ready(stops: list[list[_Stop]], r: int, stop: _Stop) -> bool:
    """Tell whether all that others drop here has been dropped, where this stop picks."""
    if stop.exchange <= 0:
        return True
    return all(
        other.done or other.exchange >= 0 or other.node != stop.node
        for o, own in enumerate(stops) if o != r for other in own
    )  # fmt: skip


def _operate(
    stops: list[list[_Stop]], r: int, stop: _Stop, load: int, lying: dict[int, list[tuple[str, int]]]
) -> int:
    stop.done = True
    load += stop.collect
    if stop.unload:
        stop.unloaded, load = load, 0
    if stop.exchange < 0:
        count = min(-stop.exchange, load)
        lying.setdefault(stop.node, []).extend([("robot", r)] * count)
        load -= count
    here = lying.get(stop.node, [])
    here.sort(key=lambda item: item[0] == "robot")
    for kind, k in here[: max(0, stop.exchange)]:
        load += 1
        if kind == "stock":
            stop.fetch[k] = stop.fetch.get(k, 0) + 1
            continue
        stop.pick[k] = stop.pick.get(k, 0) + 1
        sender = next(other for other in stops[k] if other.node == stop.node)
        sender.drop[r] = sender.drop.get(r, 0) + 1
    del here[: max(0, stop.exchange)]
    return load


def _route(problem: Problem, robot: Robot, r: int, stops: list[_Stop]) -> Route:
    """Return the visits, with the terminal and, where the last stop is at a depot, a way back to one."""
    visits = [
        Visit(stop.node, stop.collect, stop.drop, stop.pick, stop.fetch, stop.unloaded) for stop in stops
    ]
    load = problem.robots[r].on_board + sum(visit.change for visit in visits)
    cost = problem.robots[r].closure.energy_per_kg
    last, depots = visits[-1].node, problem.robots[r].depots
    ways = [(float(cost[last, d]), [d]) for d in depots if d != last or len(visits) == 1]
    if len(visits) > 1 and last in depots:
        visited = {visit.node for visit in visits}
        ways += [(float(cost[last, v] + cost[v, last]), [v, last]) for v in robot.places if v not in visited]
    way = min(ways, key=lambda option: option[0])[1]
    if len(visits) == 1 and visits[0].node in depots:
        way = [visits[0].node]
    visits += [Visit(v) for v in way[:-1]]
    visits.append(Visit(way[-1], unload=load))
    return tidy(tuple(visits))
