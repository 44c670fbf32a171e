"""Reading one parameter of an autopilot, as a machine without I/O.

Source: https://mavlink.io/en/services/parameter.html. A name that the vehicle does not have gets no answer.
"""

from __future__ import annotations

from collections.abc import Sequence

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from malipp_field.link.exchange import (
    AUTOPILOT_COMPONENT,
    GROUND_COMPONENT,
    GROUND_SYSTEM,
    Exchange,
    MavMessage,
)

_BY_NAME = -1


class ParameterRead(Exchange):
    """Ask for the value of one parameter; `value` holds it when `done`.

    Parameters
    ----------
    names
        All the names that firmwares have given it; the first answer counts.
    """

    def __init__(
        self,
        names: Sequence[str],
        target_system: int,
        target_component: int = AUTOPILOT_COMPONENT,
        own_system: int = GROUND_SYSTEM,
        own_component: int = GROUND_COMPONENT,
    ) -> None:
        super().__init__(target_system, target_component, own_system, own_component)
        self._names = tuple(names)
        self.value = float("nan")

    def start(self, now_s: float) -> list[MavMessage]:
        """Ask for it."""
        return self._ask(now_s)

    def _question(self) -> list[MavMessage]:
        return [
            mavlink.MAVLink_param_request_read_message(*self._target, name.encode(), _BY_NAME)
            for name in self._names
        ]

    def _unanswered(self) -> list[MavMessage]:
        return self._fail(f"vehicle {self._target[0]} does not tell its parameter {' or '.join(self._names)}")

    def receive(self, message: MavMessage, _now_s: float) -> list[MavMessage]:
        """Take in a message of the link; PARAM_VALUE says nothing of who asked."""
        if self.ended or message.get_msgId() != mavlink.MAVLINK_MSG_ID_PARAM_VALUE:
            return []
        if not self._sent_by_target(message) or message.param_id not in self._names:
            return []
        self.value = float(message.param_value)
        return self._finish()
