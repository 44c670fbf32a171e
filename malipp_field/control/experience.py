"""What the vehicles found on their way: edges that take longer or drain more than the mission file says.

A new plan counts on what was measured. Sand that slowed one rover down is there for the next one, and for the
same one on its way back.
"""

from __future__ import annotations

from malipp_field.mission import Mission
from malipp_field.mission.schema import Edge

_WORTH_NOTING = 1.1  # measured over predicted; less is noise


class Experience:
    """Measured over predicted time and energy, by edge (either direction)."""

    def __init__(self) -> None:
        self._ratios: dict[frozenset[str], tuple[float, float]] = {}

    def note(self, tail: str, head: str, time_ratio: float, energy_ratio: float) -> bool:
        """Take in a measurement relative to the mission file; return whether it is worth noting.

        A later measurement of the same edge replaces an earlier one.
        """
        if tail == head or max(time_ratio, energy_ratio) < _WORTH_NOTING:
            return False
        self._ratios[frozenset((tail, head))] = (max(1.0, time_ratio), max(1.0, energy_ratio))
        return True

    def applied_to(self, mission: Mission) -> Mission:
        """Return the mission with the measured edges as they were found to be, for every robot."""
        if not self._ratios:
            return mission
        given = {frozenset((edge.from_, edge.to)) for edge in mission.site.edges}
        straight = [
            Edge(from_=tail, to=head)
            for tail, head in (sorted(pair) for pair in self._ratios.keys() - given)
            if mission.site.complete
        ]
        edges = tuple(self._found(edge, mission) for edge in (*mission.site.edges, *straight))
        return mission.model_copy(update={"site": mission.site.model_copy(update={"edges": edges})})

    def _found(self, edge: Edge, mission: Mission) -> Edge:
        ratios = self._ratios.get(frozenset((edge.from_, edge.to)))
        if ratios is None:
            return edge
        time_ratio, energy_ratio = ratios
        robots = [robot.id for robot in mission.team.robots]
        return edge.model_copy(
            update={
                "energy_factor": {r: edge.energy_factor.get(r, 1.0) * energy_ratio for r in robots},
                "speed_factor": {r: edge.speed_factor.get(r, 1.0) / time_ratio for r in robots},
            }
        )
