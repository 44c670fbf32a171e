"""Giving a vehicle its signing key, and seeing that it has taken it on."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from malipp_field.clock import Clock
from malipp_field.errors import LinkError
from malipp_field.link.channels import OnMessage, VehicleLink
from malipp_field.link.links import Links
from malipp_field.link.vehicle import Vehicle

ANSWER_LIMIT_S = 10.0
"""How long to wait for a heartbeat, and then for one that is signed."""
_BEAT_S = 1.0
_STEP_S = 0.05


async def give_key(links: Links, where: VehicleLink, clock: Clock) -> bool:
    """Have a vehicle sign, and accept nothing else, with its key; return whether it had it already.

    The key crosses the link in clear.

    Parameters
    ----------
    where
        The vehicle, with the key.

    Raises
    ------
    LinkError
        When the vehicle is not heard, is armed, or does not take the key on.
    """
    assert where.key is not None
    vehicle = Vehicle(where.system_id, where.component_id)
    signed = Vehicle(where.system_id, where.component_id)

    def hear(state: Vehicle) -> OnMessage:
        return lambda message: state.receive(message, clock.now_s())

    def ignore(_severity: str, _text: str) -> None:
        """Frames of another key, or none, are what is expected at first."""

    plain = await links.open(dataclasses.replace(where, key=None), hear(vehicle), ignore)
    sealed = await links.open(where, hear(signed), ignore)
    beat = mavlink.MAVLink_heartbeat_message(
        mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, mavlink.MAV_STATE_ACTIVE, 3
    )

    async def wait_for(state: Vehicle, say: Callable[[], None]) -> bool:
        end_s = clock.now_s() + ANSWER_LIMIT_S
        due_s = clock.now_s()
        while not state.heartbeats and clock.now_s() < end_s:
            if clock.now_s() >= due_s:
                say()
                due_s += _BEAT_S
            await clock.sleep(_STEP_S)
        return state.heartbeats > 0

    def beat_both() -> None:
        plain.send(beat)
        sealed.send(beat)

    def set_up() -> None:
        assert where.key is not None
        plain.send(where.key.setup(where.system_id, where.component_id, clock.now_s()))
        beat_both()

    if not await wait_for(vehicle, beat_both):
        raise LinkError(f"{where.url}: vehicle {where.system_id} is not heard")
    if await _signs_already(signed, clock):
        return True
    if vehicle.armed:
        raise LinkError(f"vehicle {where.system_id} is armed: it takes no signing key; disarm it first")
    if not await wait_for(signed, set_up):
        raise LinkError(
            f"vehicle {where.system_id} does not sign with the key; one that has another takes it by USB only"
        )
    return False


async def _signs_already(signed: Vehicle, clock: Clock) -> bool:
    """Wait for two heartbeats' time whether any of them is signed."""
    await clock.sleep(2.0 * _BEAT_S)
    return signed.heartbeats > 0
