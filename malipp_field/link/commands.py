"""One COMMAND_LONG and its acknowledgement, as a machine without I/O.

Source: https://mavlink.io/en/services/command.html.
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

REFUSAL_LIMIT_S = 10.0
"""How long a command that is rejected for the moment is tried again."""

_PARAMS = 7


class CommandExchange(Exchange):
    """Have one command carried out; `done` means that the vehicle accepted it.

    An accepted command is not yet an effect: whoever needs one looks for it in what the vehicle reports.

    Parameters
    ----------
    command
        MAV_CMD.
    params
        Up to seven; the rest is 0.
    """

    def __init__(
        self,
        command: int,
        params: Sequence[float],
        target_system: int,
        target_component: int = AUTOPILOT_COMPONENT,
        own_system: int = GROUND_SYSTEM,
        own_component: int = GROUND_COMPONENT,
    ) -> None:
        super().__init__(target_system, target_component, own_system, own_component)
        self._command = command
        self._params = [*params, *(0.0,) * (_PARAMS - len(params))]
        self._began_s = 0.0

    def start(self, now_s: float) -> list[MavMessage]:
        """Send the command."""
        self._began_s = now_s
        return self._ask(now_s)

    def _question(self) -> list[MavMessage]:
        """Return the command; the confirmation counter tells the vehicle which sending it is."""
        confirmation = min(self._repeats, 255)
        return [
            mavlink.MAVLink_command_long_message(*self._target, self._command, confirmation, *self._params)
        ]

    def _unanswered(self) -> list[MavMessage]:
        return self._fail(f"vehicle {self._target[0]} does not answer {self._name}")

    def receive(self, message: MavMessage, now_s: float) -> list[MavMessage]:
        """Take in a message of the link; only the acknowledgement of this command counts."""
        if self.ended or message.get_msgId() != mavlink.MAVLINK_MSG_ID_COMMAND_ACK:
            return []
        # Autopilots that speak MAVLink 1 cannot say whom they answer.
        for_us = message.target_system in (0, self._own[0]) and message.target_component in (0, self._own[1])
        if not self._sent_by_target(message) or not for_us or message.command != self._command:
            return []
        return self._acknowledged(message.result, now_s)

    def _acknowledged(self, result: int, now_s: float) -> list[MavMessage]:
        if result == mavlink.MAV_RESULT_ACCEPTED:
            return self._finish()
        if result == mavlink.MAV_RESULT_IN_PROGRESS:
            self._asked_s = self._heard_s = now_s
            self._repeats = 0
            return []
        if result == mavlink.MAV_RESULT_TEMPORARILY_REJECTED and now_s < self._began_s + REFUSAL_LIMIT_S:
            self._heard_s = now_s
            return []
        return self._fail(f"{self._name} was refused ({_result_name(result)})")

    @property
    def _name(self) -> str:
        return command_name(self._command)


def command_name(command: int) -> str:
    """Return the name of a MAV_CMD, without its prefix."""
    entry = mavlink.enums["MAV_CMD"].get(command)
    return f"command {command}" if entry is None else str(entry.name).removeprefix("MAV_CMD_")


def _result_name(result: int) -> str:
    entry = mavlink.enums["MAV_RESULT"].get(result)
    return f"result {result}" if entry is None else str(entry.name)
