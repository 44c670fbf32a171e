"""ArduPilot Rover's ground station failsafe (`failsafe.cpp`): what it does when heartbeats stay away.

Off by default (FS_GCS_ENABLE 0). It counts the heartbeats of one system id, and only once it has heard one
since it was switched on. Of the actions this rover knows Hold (FS_ACTION 2); any other does nothing.
"""

from __future__ import annotations

from malipp_field.sim.params import Parameters

_CONTINUE_IN_AUTO = 2  # of FS_GCS_ENABLE
_HOLD = 2  # of FS_ACTION


class GcsFailsafe:
    """Watches for heartbeats.

    Parameters
    ----------
    parameters
        FS_GCS_ENABLE, FS_GCS_TIMEOUT, FS_TIMEOUT, FS_ACTION and MAV_GCS_SYSID are heeded as they are now.

    Attributes
    ----------
    triggered : bool
        It has acted, and no heartbeat has come since.
    """

    def __init__(self, parameters: Parameters) -> None:
        self._parameters = parameters
        self.forget()

    def forget(self) -> None:
        """Begin anew, as a restart does."""
        self._heard_s: float | None = None
        self.triggered = False

    def heard(self, system_id: int, now_s: float) -> bool:
        """Note a heartbeat; return whether it ends a failsafe."""
        if system_id != self._parameters["MAV_GCS_SYSID"]:
            return False
        self._heard_s = now_s
        ended, self.triggered = self.triggered, False
        return ended

    def due_s(self) -> float | None:
        """Return when it acts if nothing is heard until then; `None` when it does not."""
        value = self._parameters
        if not value["FS_GCS_ENABLE"] or self._heard_s is None or self.triggered:
            return None
        return self._heard_s + value["FS_GCS_TIMEOUT"] + value["FS_TIMEOUT"]

    def holds(self, in_auto: bool) -> bool:
        """Return whether acting now means to enter HOLD."""
        goes_on = in_auto and self._parameters["FS_GCS_ENABLE"] == _CONTINUE_IN_AUTO
        return self._parameters["FS_ACTION"] == _HOLD and not goes_on
