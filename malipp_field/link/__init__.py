"""One agent a vehicle: the MAVLink mission protocol on one side, the bus on the other."""
