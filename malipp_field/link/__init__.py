"""One agent a vehicle: the MAVLink mission protocol on one side, the bus on the other."""

from malipp_field.link.agent import Agent

__all__ = ["Agent"]
