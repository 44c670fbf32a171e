"""The mission file: what it may say, how it is read, and the site graph and frame that follow from it."""

from malipp_field.mission.geo import ABSTRACT_ORIGIN, locate, to_globe, to_local
from malipp_field.mission.graph import (
    Passage,
    drives_alike,
    fence_polygon,
    keep_out_polygons,
    node_positions,
    passages,
)
from malipp_field.mission.load import parse_mission, read_mission
from malipp_field.mission.schema import Mission, Robot
from malipp_field.mission.state import Cache, RobotState, TeamState, initial_state

__all__ = [
    "ABSTRACT_ORIGIN",
    "Cache",
    "Mission",
    "Passage",
    "Robot",
    "RobotState",
    "TeamState",
    "drives_alike",
    "fence_polygon",
    "initial_state",
    "keep_out_polygons",
    "locate",
    "node_positions",
    "parse_mission",
    "passages",
    "read_mission",
    "to_globe",
    "to_local",
]
