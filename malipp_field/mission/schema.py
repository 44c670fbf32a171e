"""The mission file `malipp-mission/1` as frozen records.

Field by field the contract of ``docs/formats.md``: SI units with the unit in the name. What goes beyond it
(`keep_outs`, `fence`, `vehicles`, `ground_station`, `replanning`, `simulation`) is optional; a mission
without it plans all the same.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from malipp_field.documents import StrictModel
from malipp_field.mission.vehicles import GroundStation, VehicleSettings

Identifier = Annotated[str, Field(pattern=r"^[A-Za-z0-9_][A-Za-z0-9_.-]*$", max_length=64)]
Positive = Annotated[float, Field(gt=0)]
NonNegative = Annotated[float, Field(ge=0)]
Method = Literal["auto", "exact", "no-handoffs", "seq", "miqp", "arcs", "lns", "fast"]


class Origin(StrictModel):
    """Where the local east-north-up frame touches the earth (WGS 84)."""

    lat_deg: Annotated[float, Field(ge=-90, le=90)]
    lon_deg: Annotated[float, Field(ge=-180, le=180)]
    alt_m: float = 0.0


class Place(StrictModel):
    """A place given in local metres (east, north) or in degrees, never both."""

    x_m: float | None = None
    y_m: float | None = None
    lat_deg: Annotated[float, Field(ge=-90, le=90)] | None = None
    lon_deg: Annotated[float, Field(ge=-180, le=180)] | None = None

    @model_validator(mode="after")
    def _one_way_of_saying_where(self) -> Place:
        local = (self.x_m is not None, self.y_m is not None)
        globe = (self.lat_deg is not None, self.lon_deg is not None)
        if not ((all(local) and not any(globe)) or (all(globe) and not any(local))):
            raise ValueError("a place needs either x_m and y_m, or lat_deg and lon_deg")
        return self


class Node(Place):
    """A node of the site graph. Only candidates may be sampled, only depots unloaded at."""

    id: Identifier
    role: Literal["candidate", "depot", "start", "via"] = "candidate"


class Edge(StrictModel):
    """A drivable connection; both ways unless `one_way`. Factors and closures are per robot."""

    from_: Annotated[Identifier, Field(alias="from")]
    to: Identifier
    length_m: Positive | None = None
    one_way: bool = False
    energy_factor: dict[Identifier, Positive] = Field(default={})
    speed_factor: dict[Identifier, Positive] = Field(default={})
    closed_to: tuple[Identifier, ...] = Field(default=(), strict=False)


class KeepOut(StrictModel):
    """A polygon no edge may cross."""

    id: Identifier
    polygon: Annotated[tuple[Place, ...], Field(min_length=3, strict=False)]


class Site(StrictModel):
    """The place: nodes, the physical motion graph, and what is in the way."""

    origin: Origin | None = None
    nodes: Annotated[tuple[Node, ...], Field(min_length=1, strict=False)]
    edges: tuple[Edge, ...] = Field(default=(), strict=False)
    complete: bool = False
    keep_outs: tuple[KeepOut, ...] = Field(default=(), strict=False)
    fence: Annotated[tuple[Place, ...], Field(min_length=3, strict=False)] | None = None
    """Outline of the area no vehicle may leave."""


class Kernel(StrictModel):
    """Stationary covariance function of the field."""

    family: Literal["rbf", "matern32", "matern52"]
    length_scale_m: Positive
    variance: Positive = 1.0


class TestPoint(Place):
    """A place where the prediction error counts, with its weight W_jj."""

    __test__ = False  # not a test class, whatever pytest thinks of the name

    weight: NonNegative = 1.0


class FieldModel(StrictModel):
    """The unknown field f ~ GP(0, k) and where it is to be known."""

    kernel: Kernel
    test_points: Annotated[tuple[TestPoint, ...], Field(min_length=1, strict=False)]


class Robot(StrictModel):
    """One robot, with the paper's symbols in its comments."""

    id: Identifier
    start: Identifier  # s_r
    depots: Annotated[tuple[Identifier, ...], Field(min_length=1, strict=False)]  # D_r
    empty_mass_kg: Positive  # m_r^0
    energy_budget_j: NonNegative  # B_r
    payload_capacity: Annotated[int, Field(ge=0, le=1000)]  # K_r
    samples_per_node: Annotated[int, Field(ge=0, le=1000)]  # S_r^max
    noise_variance: Positive  # sigma_r^2
    energy_per_kg_m: Positive  # alpha_e = energy_per_kg_m * length * energy_factor
    speed_m_s: Positive


class Team(StrictModel):
    """The robots and what one sample weighs."""

    sample_mass_kg: NonNegative  # m^s
    service_time_s: NonNegative = 0.0  # beta
    clearance_s: NonNegative = 0.0  # Delta^H
    robots: Annotated[tuple[Robot, ...], Field(min_length=1, strict=False)]


class PlannerOptions(StrictModel):
    """How to plan, unless the command line says otherwise."""

    method: Method = "auto"
    handoffs: bool = True
    time_limit_s: Positive = 60.0
    mip_gap: NonNegative = 1.0e-4
    seed: Annotated[int, Field(ge=0)] = 0
    energy_reserve: Annotated[float, Field(ge=0, lt=1)] = 0.0
    """Share of every energy budget (or of what is left of it) that no plan may count on."""


class Replanning(StrictModel):
    """When the coordinator plans anew during a mission."""

    slip_s: Positive = 30.0
    """A stop later than planned by more than this asks for a new plan."""
    energy_overdraw: Positive = 0.05
    """Energy used beyond the plan, as a share of the budget, that asks for a new plan."""
    time_limit_s: Positive = 5.0
    """Seconds the planner may think while the team drives on."""
    energy_reserve: Annotated[float, Field(ge=0, lt=1)] = 0.05
    """Share of the energy left that a new plan does not count on, if there is one that can do without."""
    stall_s: Positive = 900.0
    """A mission in which no vehicle gets any further for this long is over."""


class TerrainPatch(Place):
    """A disc of ground that the planner does not know of."""

    radius_m: Positive
    speed_factor: Positive = 1.0
    energy_factor: Positive = 1.0


class Simulation(StrictModel):
    """The simulated world: what is true but not planned for."""

    seed: Annotated[int, Field(ge=0)] = 0
    speed: Positive = 20.0
    """Simulated seconds for each wall second."""
    person_s: NonNegative | None = 20.0
    """Seconds from when a vehicle waits for a person to when the simulated one has done the work and says so;
    null: the work is done at once, and `malipp confirm` is left to you."""
    parameters: dict[str, float] = Field(default={})
    """Parameters of the simulated autopilots that differ from ArduPilot's defaults, as ``FS_GCS_ENABLE``."""
    terrain: tuple[TerrainPatch, ...] = Field(default=(), strict=False)


class Mission(StrictModel):
    """A whole mission file. Use `malipp_field.mission.read_mission` to get one that also makes sense."""

    format: Literal["malipp-mission/1"]
    name: Identifier
    site: Site
    field: FieldModel
    team: Team
    planner: PlannerOptions = PlannerOptions()
    replanning: Replanning = Replanning()
    simulation: Simulation = Simulation()
    vehicles: dict[Identifier, VehicleSettings] = Field(default={})
    ground_station: GroundStation = GroundStation()

    def vehicle(self, robot_id: str) -> VehicleSettings:
        """Return the settings of a robot's vehicle, with its system id; raises `KeyError` for none such."""
        position = [robot.id for robot in self.team.robots].index(self.robot(robot_id).id) + 1
        settings = self.vehicles.get(robot_id, VehicleSettings())
        return settings.model_copy(update={"system_id": settings.system_id or position})

    def robot(self, robot_id: str) -> Robot:
        """Return the robot of that id; raises `KeyError` where there is none."""
        for robot in self.team.robots:
            if robot.id == robot_id:
                return robot
        raise KeyError(robot_id)
