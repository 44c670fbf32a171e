"""The vehicle when there is none: ArduPilot-like rovers on UDP, in a world the planner does not know."""
