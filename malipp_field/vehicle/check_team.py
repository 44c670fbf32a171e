"""Whether the vehicles of a team can be told apart and reached."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator

from malipp_field.mission import Mission
from malipp_field.mission.vehicles import VehicleSettings
from malipp_field.vehicle.finding import Finding, Spot

_LAST_SYSTEM_ID = 255
_HERE = ("127.", "localhost", "[::1]")


def team_findings(mission: Mission) -> Iterator[Finding]:
    """Yield ids that are taken twice, vehicles without a link, and links without signing."""
    vehicles = {robot.id: mission.vehicle(robot.id) for robot in mission.team.robots}
    yield from _system_ids(mission, vehicles)
    without = [robot for robot, settings in vehicles.items() if settings.link is None]
    if without:
        yield Spot(None, None, ", ".join(without)).warning(
            "no-link",
            "no link: nothing can be sent there",
            "under vehicles, give a link (udpin, udpout, tcp or serial)",
        )
    unsigned = [
        robot
        for robot, settings in vehicles.items()
        if settings.signing_key is None and _abroad(settings.link)
    ]
    if unsigned:
        yield Spot(None, None, ", ".join(unsigned)).warning(
            "unsigned",
            "no signing key: whoever is on the radio can command it",
            "under vehicles, give a signing_key, and the vehicle the same key",
        )


def _system_ids(mission: Mission, vehicles: dict[str, VehicleSettings]) -> Iterator[Finding]:
    owners: dict[int, list[str]] = defaultdict(list)
    for robot, settings in vehicles.items():
        owners[settings.system_id or 0].append(robot)
    for system_id, robots in owners.items():
        if system_id > _LAST_SYSTEM_ID:
            yield Spot(robots[0]).error(
                "system-id",
                f"MAVLink has no system id {system_id}",
                "under vehicles, give it a system_id from 1 to 255",
            )
        shared = [*robots, *(["the ground station"] if system_id == mission.ground_station.system_id else [])]
        if len(shared) > 1:
            yield Spot(robots[0]).error(
                "system-id",
                f"system id {system_id} is that of {' and '.join(shared)}",
                "under vehicles, give each its own system_id, and on the vehicle (MAV_SYSID) the same",
            )


def _abroad(link: str | None) -> bool:
    """Tell whether a link leaves this machine."""
    return link is not None and not link.partition(":")[2].startswith(_HERE)
