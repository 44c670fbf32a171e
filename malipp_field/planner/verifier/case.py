"""What every rule of the verifier looks at: a mission, its state, and a plan read stop by stop."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

from malipp_field.mission import Mission, Robot, RobotState, TeamState
from malipp_field.plan import Plan, Stop

TOLERANCE = 1e-6
"""Rounding that is forgiven in joules, seconds and the objective, as a share of the figure or of one unit."""


@dataclass(frozen=True)
class Violation:
    """One rule that a plan breaks.

    Attributes
    ----------
    rule
        The paper's label (``eq:energy_budget``, ``subsec:routing``) or ``format:...`` for the plan format.
    robot, node
        Where it is broken; None where the rule is about the whole plan, or the whole route.
    text
        What is wrong and what would be right, in one line.
    """

    rule: str
    robot: str | None
    node: str | None
    text: str

    def __str__(self) -> str:
        where = " at ".join(part for part in (self.robot, self.node) if part is not None)
        return f"{self.rule}: {where}: {self.text}" if where else f"{self.rule}: {self.text}"


@dataclass(frozen=True)
class Visit:
    """One stop of a route, with the robot that makes it and the stop before it."""

    robot: Robot
    begin: RobotState
    stop: Stop
    before: Stop | None
    last: bool

    @property
    def terminal(self) -> bool:
        """Whether the stop is at a terminal copy; the only stop of a route counts as the start."""
        return self.last and self.before is not None

    @property
    def load_in(self) -> int:
        """Q_in: samples on board on arrival, by the plan's own word."""
        return self.begin.on_board if self.before is None else self.before.payload

    def breaks(self, rule: str, text: str) -> Violation:
        """Return the violation of ``rule`` at this stop."""
        return Violation(rule, self.robot.id, self.stop.node, text)


@dataclass(frozen=True)
class Case:
    """A plan under examination, for a mission from a state on."""

    mission: Mission
    plan: Plan
    state: TeamState

    @cached_property
    def roles(self) -> dict[str, str]:
        """Role of every node of the site."""
        return {node.id: node.role for node in self.mission.site.nodes}

    @cached_property
    def team(self) -> dict[str, Robot]:
        """Robots of the mission by id."""
        return {robot.id: robot for robot in self.mission.team.robots}

    @cached_property
    def routes(self) -> list[list[Visit]]:
        """The routes of the robots that the mission knows."""
        return [
            [
                Visit(
                    robot=self.team[entry.id],
                    begin=self.state.robot(entry.id),
                    stop=stop,
                    before=entry.route[i - 1] if i else None,
                    last=i == len(entry.route) - 1,
                )
                for i, stop in enumerate(entry.route)
            ]
            for entry in self.plan.robots
            if entry.id in self.team
        ]

    def visits(self) -> Iterator[Visit]:
        """Return every stop of every robot."""
        for route in self.routes:
            yield from route


def above(value: float, limit: float) -> bool:
    """Tell whether ``value`` exceeds ``limit`` by more than rounding."""
    return value > limit + TOLERANCE * max(1.0, abs(limit))


def differs(value: float, right: float) -> bool:
    """Tell whether two figures differ by more than rounding."""
    return above(value, right) or above(right, value)
