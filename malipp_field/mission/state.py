"""A mission part-way: what has been spent, gained and left lying, for planning the rest of it.

The planner and the verifier take a `TeamState` beside the mission; without one a mission starts from its
beginning.
"""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from malipp_field.documents import StrictModel
from malipp_field.mission.schema import Identifier, Mission, NonNegative


class RobotState(StrictModel):
    """Where one robot's free part begins. What lies before it (a leg, an action) is committed."""

    id: Identifier
    node: Identifier
    """The node at which the robot is, or will be when its committed part ends; its start s_r from now on."""
    ready_s: NonNegative = 0.0
    """Mission time from which it is free there; its service window at the node begins no earlier."""
    energy_left_j: NonNegative
    on_board: Annotated[int, Field(ge=0)] = 0
    """Samples on board; all of them are to be delivered."""
    collected: dict[Identifier, Annotated[int, Field(ge=1)]] = Field(default={})
    """Samples it has taken so far by node: S_r^max and the precision gained count them."""


class Cache(StrictModel):
    """Samples lying at a node after a dead drop; all of them are to be fetched."""

    node: Identifier
    sender: Identifier
    count: Annotated[int, Field(ge=1)]
    available_s: NonNegative = 0.0
    """Mission time from which a receiver's service window may begin (drop and clearance are over)."""


class TeamState(StrictModel):
    """The whole team part-way through a mission. Every robot of the mission has one entry."""

    time_s: NonNegative = 0.0
    robots: Annotated[tuple[RobotState, ...], Field(strict=False)]
    caches: tuple[Cache, ...] = Field(default=(), strict=False)
    barren: tuple[Identifier, ...] = Field(default=(), strict=False)
    """Candidates where no sample can be taken any more, as was found on the spot; what was taken counts."""

    def robot(self, robot_id: str) -> RobotState:
        """Return the state of that robot; raises `KeyError` where there is none."""
        for robot in self.robots:
            if robot.id == robot_id:
                return robot
        raise KeyError(robot_id)


def initial_state(mission: Mission) -> TeamState:
    """Return the state in which every mission begins: at the starts, empty, with full budgets."""
    return TeamState(
        robots=tuple(
            RobotState(id=r.id, node=r.start, energy_left_j=r.energy_budget_j) for r in mission.team.robots
        )
    )
