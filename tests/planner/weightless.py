"""Classical informative path planning for teams: samples weigh nothing, and everybody can carry them all.

Handing over is of no use then, and what a robot samples is what lies on its tour: every set of nodes that
some tour within the budget joins, for every robot, and all their combinations.
"""

from __future__ import annotations

import itertools

from missions_strategy import posterior

from malipp_field.mission import Mission, Robot, passages


def optimum(mission: Mission) -> tuple[float, float] | None:
    """Return the least J and, for it, the least energy; None where somebody cannot get home."""
    tours = [list(_tours(mission, robot).items()) for robot in mission.team.robots]
    ranks = (
        (
            posterior(
                mission,
                {
                    robot.id: dict.fromkeys(nodes, robot.samples_per_node)
                    for robot, (nodes, _) in zip(mission.team.robots, team, strict=True)
                },
            ),
            sum(energy_j for _, energy_j in team),
        )
        for team in itertools.product(*tours)
    )
    best: tuple[float, float] | None = None
    for information, energy_j in ranks:
        if best is None or information < best[0] * (1 - 1e-9):
            best = (information, energy_j)
        elif information < best[0] * (1 + 1e-9):
            best = (best[0], min(best[1], energy_j))
    return best


def _tours(mission: Mission, robot: Robot) -> dict[tuple[str, ...], float]:
    """Return the energy of the cheapest tour through every set of nodes that one within the budget joins."""
    way = _cheapest_ways(mission, robot.id)
    candidates = [node.id for node in mission.site.nodes if node.role == "candidate"]
    found = {}
    for size in range(len(candidates) * (robot.samples_per_node > 0) + 1):
        for nodes in itertools.combinations(candidates, size):
            energy_j = robot.empty_mass_kg * min(
                sum(way[leg] for leg in itertools.pairwise([robot.start, *order, depot]))
                for order in itertools.permutations(nodes)
                for depot in robot.depots
            )
            if energy_j <= robot.energy_budget_j * (1 + 1e-9):
                found[nodes] = energy_j
    return found


def _cheapest_ways(mission: Mission, robot_id: str) -> dict[tuple[str, str], float]:
    """Return energy per kilogram of the cheapest way between any two nodes (Floyd and Warshall)."""
    nodes = [node.id for node in mission.site.nodes]
    way = {(u, v): 0.0 if u == v else float("inf") for u in nodes for v in nodes}
    for edge in passages(mission, robot_id):
        way[edge.tail, edge.head] = min(way[edge.tail, edge.head], edge.energy_per_kg)
    for k, u, v in itertools.product(nodes, nodes, nodes):
        way[u, v] = min(way[u, v], way[u, k] + way[k, v])
    return way
