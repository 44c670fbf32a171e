"""The plan file `malipp-plan/1` as frozen records; the contract is in ``docs/formats.md``."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from malipp_field.documents import StrictModel

Count = Annotated[int, Field(ge=0)]
Transfers = dict[str, Annotated[int, Field(ge=1)]]
Status = Literal["optimal", "feasible", "infeasible", "no_plan"]


class Stop(StrictModel):
    """One stop of a route: where, when, what is done there, and the leg that led to it.

    The first stop of a route is the start: it has no `path`, `arrive_s` or `leg_energy_j`.
    """

    node: str
    path: tuple[str, ...] | None = Field(default=None, strict=False)
    """Physical nodes of the leg, from the previous stop to this one, both included."""
    arrive_s: float | None = None
    depart_s: float
    """The paper's t_v^r: service takes the `service_time_s` before it."""
    leg_energy_j: float | None = None
    collect: Count = 0
    drop: Transfers = Field(default={})
    pick: Transfers = Field(default={})
    unload: Count = 0
    payload: Count
    """Samples on board on departure."""


class RobotPlan(StrictModel):
    """The route of one robot."""

    id: str
    route: Annotated[tuple[Stop, ...], Field(min_length=1, strict=False)]

    @property
    def energy_j(self) -> float:
        """Energy of all legs, in joules."""
        return sum(stop.leg_energy_j or 0.0 for stop in self.route)

    @property
    def collected(self) -> int:
        """Samples taken along the route."""
        return sum(stop.collect for stop in self.route)


class Objective(StrictModel):
    """The lexicographic objective: J, E^tot, T^end."""

    information: float
    energy_j: float
    makespan_s: float


class Bound(StrictModel):
    """Proven bounds; null where the method has none."""

    information: float | None = None


class Plan(StrictModel):
    """A plan file. ``version`` counts the plans of one mission: 1 before it starts, more after replans."""

    format: Literal["malipp-plan/1"] = "malipp-plan/1"
    mission: str
    version: Annotated[int, Field(ge=1)] = 1
    method: str
    status: Status
    reason: str | None = None
    """In words, why there is no plan; null when there is one."""
    objective: Objective | None = None
    bound: Bound = Bound()
    gap: float | None = None
    solve_time_s: float
    seed: int = 0
    robots: tuple[RobotPlan, ...] = Field(default=(), strict=False)

    def robot(self, robot_id: str) -> RobotPlan:
        """Return the route of that robot; raises `KeyError` where there is none."""
        for robot in self.robots:
            if robot.id == robot_id:
                return robot
        raise KeyError(robot_id)

    @property
    def handoffs(self) -> int:
        """Number of dead drops (sender, receiver and node), whatever they hold."""
        return sum(len(stop.drop) for robot in self.robots for stop in robot.route)
