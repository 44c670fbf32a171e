"""One agent a vehicle: the MAVLink mission protocol on one side, the bus on the other."""

from malipp_field.link.agent import Agent
from malipp_field.link.channels import Channel, VehicleLink, vehicle_link
from malipp_field.link.keys import KeyRing
from malipp_field.link.links import Links
from malipp_field.link.signing import SigningKey

__all__ = ["Agent", "Channel", "KeyRing", "Links", "SigningKey", "VehicleLink", "vehicle_link"]
