"""Whether a site's fence and its robots' rally points fit where ArduPilot stores them."""

from __future__ import annotations

from collections.abc import Iterator

from malipp_field.mission import Mission
from malipp_field.vehicle.fence import MAX_CORNERS, MAX_FENCE_ITEMS, MAX_RALLY_POINTS, fence_polygons
from malipp_field.vehicle.finding import Finding, Spot

OF_FENCE = frozenset({"fence-too-large", "rally-too-many"})
"""Rules about what `malipp upload --no-fence` does not send."""


def fence_findings(mission: Mission) -> Iterator[Finding]:
    """Yield polygons, or a sum of them, with more corners than are stored, and depots beyond the last place.

    An abstract site has no degrees and is never sent: nothing is found.
    """
    if mission.site.origin is None:
        return
    corners = {polygon.name: len(polygon.corners) for polygon in fence_polygons(mission)}
    for name, number in corners.items():
        if number > MAX_CORNERS:
            yield Spot(where=name).error(
                "fence-too-large",
                f"{number} corners; ArduPilot stores at most {MAX_CORNERS} of one polygon",
                f"leave out {number - MAX_CORNERS} of them, or upload with --no-fence",
            )
    surplus = sum(corners.values()) - MAX_FENCE_ITEMS
    if surplus > 0 and max(corners.values()) <= MAX_CORNERS:
        largest = max(corners, key=corners.__getitem__)
        yield Spot(where=", ".join(corners)).error(
            "fence-too-large",
            f"{sum(corners.values())} corners in all; ArduPilot stores at most {MAX_FENCE_ITEMS}",
            f"leave out {surplus}, first of {largest} ({corners[largest]}), or upload with --no-fence",
        )
    for robot in mission.team.robots:
        beyond = robot.depots[MAX_RALLY_POINTS:]
        if beyond:
            yield Spot(robot.id).error(
                "rally-too-many",
                f"{len(robot.depots)} depots as rally points; ArduPilot stores at most {MAX_RALLY_POINTS}",
                f"leave out {len(beyond)} of its depots (such as {beyond[0]}), or upload with --no-fence",
            )
