"""What the vehicles found on their way: edges that take longer or drain more than the mission file says.

A new plan counts on what was measured. Sand that slowed one rover down is there for the next one, and for the
same one on its way back.
"""

from __future__ import annotations

from malipp_field.control.tracks import Measured
from malipp_field.mission import Mission
from malipp_field.mission.schema import Edge

_WORTH_NOTING = 1.1  # measured over predicted; less is noise


class Experience:
    """Measured over predicted time and energy, by edge (either direction)."""

    def __init__(self) -> None:
        self._ratios: dict[frozenset[str], tuple[float, float]] = {}

    def note(self, measured: Measured, *, whole: bool) -> bool:
        """Take in a measurement relative to the mission file; return whether it is worth noting.

        That of a whole edge replaces what was known, also when all is well again; that of a part of one is
        only taken for the whole when it is worse.
        """
        edge = frozenset((measured.tail, measured.head))
        ratios = (measured.time_ratio, measured.energy_ratio)
        worth = len(edge) == 2 and max(ratios) >= _WORTH_NOTING
        if whole and not worth:
            self._ratios.pop(edge, None)
        elif worth and (whole or max(ratios) > max(self._ratios.get(edge, (1.0, 1.0)))):
            self._ratios[edge] = ratios
        return worth

    def of(self, tail: str, head: str) -> tuple[float, float]:
        """Return what an edge takes in time and in energy, over what the mission file says."""
        return self._ratios.get(frozenset((tail, head)), (1.0, 1.0))

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
        time_ratio, energy_ratio = self.of(edge.from_, edge.to)
        if max(time_ratio, energy_ratio) <= 1.0:
            return edge
        robots = [robot.id for robot in mission.team.robots]
        return edge.model_copy(
            update={
                "energy_factor": {r: edge.energy_factor.get(r, 1.0) * energy_ratio for r in robots},
                "speed_factor": {r: edge.speed_factor.get(r, 1.0) / time_ratio for r in robots},
            }
        )
