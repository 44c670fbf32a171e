"""A plan of old, followed stop by stop from a new state: what still stands of it, as a draft."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from malipp_field.plan import Plan, Stop
from malipp_field.planner.draft import COLLECTED, ON_BOARD, STOCK, Draft, Sample
from malipp_field.planner.problem import Problem


@dataclass
class _Robot:
    """One robot on its way along its old route: the nodes it stops at, and how many are behind it."""

    nodes: list[int]
    stops: list[Stop | None]
    held: list[Sample]
    done: int = 0

    @property
    def over(self) -> bool:
        """Whether it has made all its stops."""
        return self.done == len(self.nodes)

    def will_come(self, node: int) -> bool:
        """Tell whether it has still to stop at a node."""
        return node in self.nodes[self.done :]


def followed(problem: Problem, plan: Plan) -> tuple[Draft, list[Sample]]:
    """Return what still stands of ``plan`` as a draft, and the samples lying in drops that it leaves there.

    Robots, nodes and samples that are not there (any more) are passed over. Budgets and capacities are not
    looked at; drops never wait for each other in a circle.
    """
    play = _Play(problem, plan)
    routes = [[*robot.nodes, robot.nodes[0]] for robot in play.robots]
    draft = Draft(problem, routes, play.run())
    draft.tidy()
    left = [
        Sample(STOCK, stock.node, 0, (), s)
        for s, stock in enumerate(problem.stocks)
        for _ in range(play.left[s])
    ]
    return draft, left


class _Play:
    """All robots on their old routes, each going on as soon as what it is to pick is there."""

    def __init__(self, problem: Problem, plan: Plan) -> None:
        self.problem = problem
        self.index = {node: i for i, node in enumerate(problem.nodes)}
        self.team = {robot.id: r for r, robot in enumerate(problem.robots)}
        old = {robot.id: robot.route for robot in plan.robots}
        self.robots = [self._robot(r, old.get(robot.id, ())) for r, robot in enumerate(problem.robots)]
        self.left = [stock.count for stock in problem.stocks]
        self.lying: dict[tuple[int, int, int], list[Sample]] = {}
        """By node, sender and receiver."""
        self.home: list[Sample] = []

    def run(self) -> list[Sample]:
        """Follow all routes to their ends; return the samples with the ways they take."""
        while waiting := [r for r, robot in enumerate(self.robots) if not robot.over]:
            ready = [r for r in waiting if self._is_ready(r)]
            for r in ready or waiting[:1]:  # who waits in a circle goes without
                self._operate(r)
        for robot in self.robots:
            self.home += robot.held
        for samples in self.lying.values():  # not picked: their robots bring them home themselves
            self.home += samples
        return self.home

    def _robot(self, r: int, route: tuple[Stop, ...]) -> _Robot:
        """Return a robot at its start, with the stops ahead that it can make."""
        view = self.problem.robots[r]
        inner = list(route[:-1] if len(route) > 1 else route)
        here = inner.pop(0) if inner and self.index.get(inner[0].node) == view.start else None
        robot = _Robot([view.start], [here], [Sample(ON_BOARD, view.start, r)] * view.on_board)
        for stop in inner:
            node = self.index.get(stop.node, -1)
            if node in view.stops and node not in robot.nodes:
                robot.nodes.append(node)
                robot.stops.append(stop)
        return robot

    def _is_ready(self, r: int) -> bool:
        robot = self.robots[r]
        node, stop = robot.nodes[robot.done], robot.stops[robot.done]
        return stop is None or not any(self.robots[s].will_come(node) for s in self._known(stop.pick, r))

    def _known(self, ids: Iterable[str], r: int) -> list[int]:
        """Return which of these robots are there, robot ``r`` left out."""
        return [self.team[robot_id] for robot_id in ids if self.team.get(robot_id, r) != r]

    def _operate(self, r: int) -> None:
        """Do what is planned at a robot's next stop, as far as it can be done."""
        robot, view = self.robots[r], self.problem.robots[r]
        node, stop = robot.nodes[robot.done], robot.stops[robot.done]
        if stop is not None:
            most = min(int(view.limits[node]), view.capacity)
            robot.held += [Sample(COLLECTED, node, r)] * min(stop.collect, most)
            self._drop(r, node, stop)
        if node in view.depots:
            self.home += robot.held
            robot.held = []
        if stop is not None:
            self._pick(r, node, stop)
        robot.done += 1

    def _drop(self, r: int, node: int, stop: Stop) -> None:
        for o in self._known(stop.drop, r):
            if not self.robots[o].will_come(node) or node not in self.problem.shared(r, o):
                continue
            for _ in range(min(stop.drop[self.problem.robots[o].id], len(self.robots[r].held))):
                self.lying.setdefault((node, r, o), []).append(self.robots[r].held.pop())

    def _pick(self, r: int, node: int, stop: Stop) -> None:
        held = self.robots[r].held
        for sender, count in stop.pick.items():
            dropped = self.lying.pop((node, self.team.get(sender, r), r), [])
            held += [sample._replace(hops=(*sample.hops, (node, r))) for sample in dropped]
            wanted = count - len(dropped)
            for s, stock in enumerate(self.problem.stocks):
                if stock.node == node and stock.sender == sender:
                    fetched = max(0, min(wanted, self.left[s]))
                    held += [Sample(STOCK, node, r, (), s)] * fetched
                    self.left[s] -= fetched
                    wanted -= fetched
