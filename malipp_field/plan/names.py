"""Whether the names in a plan file are those of its mission."""

from __future__ import annotations

from collections.abc import Iterator

from malipp_field.documents import ContentError, Location, suggest
from malipp_field.mission import Mission
from malipp_field.plan.schema import Plan, Stop


def check_names(plan: Plan, mission: Mission) -> None:
    """Refuse a plan of another mission, and any robot or node that its mission does not have.

    Raises
    ------
    ContentError
        With the place in the file and what would be right, for the first one.
    """
    if plan.mission != mission.name:
        raise ContentError(
            ("mission",), f"a plan of mission '{plan.mission}'; the mission is '{mission.name}'"
        )
    nodes = [node.id for node in mission.site.nodes]
    robots = [robot.id for robot in mission.team.robots]
    for index, robot in enumerate(plan.robots):
        here: Location = ("robots", index)
        _known(robot.id, robots, (*here, "id"), "robot")
        for number, stop in enumerate(robot.route):
            for location, name, is_node in _named(stop):
                known, what = (nodes, "node") if is_node else (robots, "robot")
                _known(name, known, (*here, "route", number, *location), what)


def _named(stop: Stop) -> Iterator[tuple[Location, str, bool]]:
    """Yield where a stop names something, the name, and whether it is that of a node."""
    yield ("node",), stop.node, True
    for position, node in enumerate(stop.path or ()):
        yield ("path", position), node, True
    for key, transfers in (("drop", stop.drop), ("pick", stop.pick)):
        for robot in transfers:
            yield (key, robot), robot, False


def _known(name: str, known: list[str], location: Location, what: str) -> None:
    if name not in known:
        raise ContentError(location, f"the mission has no {what} '{name}'" + suggest(name, known))
