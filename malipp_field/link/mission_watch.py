"""Whether somebody else has changed the mission on a vehicle, as far as the link lets one know; no I/O."""

from __future__ import annotations

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from malipp_field.link.exchange import MavMessage
from malipp_field.vehicle.layout import lay_out
from malipp_field.vehicle.steps import VehicleMission

REPORTS = 3
"""So many reports in a row of another number of items: one may have been under way since before ours."""
OWN_ECHO_S = 10.0
"""For so long after an upload of ours requests to our address may be late ones."""

_REQUESTS = (mavlink.MAVLINK_MSG_ID_MISSION_REQUEST, mavlink.MAVLINK_MSG_ID_MISSION_REQUEST_INT)
_NO_TOTAL = 0xFFFF


class MissionWatch:
    """Looks at what a vehicle says for signs of a mission that is not the verified one.

    Its requests for items show that somebody uploads, and MISSION_CURRENT tells how many items there are.
    Another mission of as many items, over a link that is not ours, can only be found by reading it.

    Parameters
    ----------
    own
        System and component id as whom we speak; another ground station may use the same.
    """

    def __init__(self, own: tuple[int, int]) -> None:
        self._own = own
        self._mission: VehicleMission | None = None
        self._items, self._since_s = 0, 0.0
        self._tells_total = False
        self._odd = 0

    @property
    def doubts(self) -> bool:
        """Whether the last report was of a mission of another length: its item is none of ours."""
        return self._odd > 0

    def suspicion(self, message: MavMessage, mission: VehicleMission | None, now_s: float) -> str | None:
        """Take in a message of the vehicle; return why ``mission`` may not be on board any more, in words.

        Parameters
        ----------
        mission
            The verified mission on board; None while there is none, and nothing to be lost.
        """
        if mission is not self._mission:
            self._mission, self._since_s, self._odd = mission, now_s, 0
            self._items = 0 if mission is None else len(lay_out(mission).items) - 1
        kind = message.get_msgId()
        if kind == mavlink.MAVLINK_MSG_ID_MISSION_CURRENT:
            return self._counted(message.total)
        if mission is None or getattr(message, "mission_type", -1) != mavlink.MAV_MISSION_TYPE_MISSION:
            return None
        for_others = (message.target_system, message.target_component) != self._own
        if kind in _REQUESTS and (for_others or now_s > self._since_s + OWN_ECHO_S):
            return "it is being given another"
        accepted = kind == mavlink.MAVLINK_MSG_ID_MISSION_ACK and message.type == mavlink.MAV_MISSION_ACCEPTED
        return "it has taken another" if accepted and for_others else None

    def _counted(self, total: int) -> str | None:
        """Compare the number of items after home; 0 says nothing where a firmware never tells it."""
        self._tells_total = self._tells_total or 0 < total < _NO_TOTAL
        if self._mission is None or not self._tells_total or total in (self._items, _NO_TOTAL):
            self._odd = 0
            return None
        self._odd += 1
        return f"{total} items are on board, not {self._items}" if self._odd >= REPORTS else None
