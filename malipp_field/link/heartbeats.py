"""When our heartbeats must stop, so that a vehicle holds by its own failsafe; no I/O."""

from __future__ import annotations

import math

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from malipp_field.link.exchange import MavMessage
from malipp_field.link.vehicle import Vehicle

RIVAL_GONE_S = 10.0
"""How long another ground station of our own system id counts after its last heartbeat."""


class Heartbeats:
    """Whether we may send one.

    While a mission is replaced under way, heartbeats are a pledge: beyond the deadline they stop, and only
    begin again when the vehicle has been heard in another mode than AUTO.

    Parameters
    ----------
    vehicle
        Which vehicle hears them.
    own_system
        System id as whom we speak.
    alone
        Whether nobody else of ours sends heartbeats on this link.
    """

    def __init__(self, vehicle: Vehicle, own_system: int, *, alone: bool) -> None:
        self._vehicle, self._own_system, self._alone = vehicle, own_system, alone
        self._until_s = math.inf
        self._rival_s = -math.inf

    def overhear(self, message: MavMessage, now_s: float) -> None:
        """Take in any message of the link: others may speak with our system id, and then count as we do.

        QGroundControl is 255/190 of its own accord, as we are; our own heartbeats do not come back to us.
        """
        beat = message.get_msgId() == mavlink.MAVLINK_MSG_ID_HEARTBEAT
        if beat and message.get_srcSystem() == self._own_system:
            self._rival_s = now_s

    def are_all_it_hears(self, now_s: float) -> bool:
        """Return whether the vehicle hears no heartbeats of our system id but these, as far as is known."""
        return self._alone and now_s >= self._rival_s + RIVAL_GONE_S

    def allowed(self, now_s: float) -> bool:
        """Return whether one may be sent now."""
        if self._vehicle.mode != "AUTO":
            self._until_s = math.inf
        return now_s < self._until_s

    def only_until(self, deadline_s: float) -> None:
        """Stop at that time."""
        self._until_s = deadline_s

    def go_on(self) -> None:
        """Take the deadline back: all is well."""
        self._until_s = math.inf

    def stop(self) -> None:
        """Stop now."""
        self._until_s = -math.inf
