"""The vehicle when there is none: ArduPilot-like rovers on UDP, in a world the planner does not know."""

from malipp_field.sim.autopilot import RoverConfig
from malipp_field.sim.fleet import Fleet
from malipp_field.sim.rover import Rover
from malipp_field.sim.world import World

__all__ = ["Fleet", "Rover", "RoverConfig", "World"]
