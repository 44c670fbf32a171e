"""Energy budgets fixed by a reference tour, as the paper's study of sensing ratio and sample mass has them.

"Energy budgets use 50 % of the reference cost of visiting all informative nodes with weightless samples
(lambda = 0), divided by team size" (paper, Section "Interaction Between Sensing and Sample Mass"). What it
leaves open is chosen here:

- *Reference cost*: the energy of the cheapest closed tour of one robot from depot 0 through every candidate
  over cheapest paths, empty. Robots of the generator differ neither in mass nor in energy per kilogram and
  metre, so it does not matter which; neither mass, ratio nor test points change it. It is found exactly.
- *Division*: the mean budget of the team is that cost times 0.5 / R. Precise robots keep their share of a
  carrier's budget (`malipp_field.bench.instances`), so the team's budgets add up to half of the tour.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import shortest_path

from malipp_field.bench.instances import Specification, build
from malipp_field.field import FloatArray
from malipp_field.mission import Mission, passages

TOUR_SHARE = 0.5
_MOST_CANDIDATES = 18
"""Dynamic programming over sets takes 2^n n numbers."""


def tour_mission(specification: Specification) -> Mission:
    """Return the instance with budgets that follow from its reference tour.

    Raises
    ------
    ValueError
        When there are too many candidates for an exact tour.
    """
    if specification.candidates > _MOST_CANDIDATES:
        raise ValueError(f"an exact tour visits at most {_MOST_CANDIDATES} candidates")
    plain = build(specification, 1.0)
    mean_budget_j = TOUR_SHARE * reference_tour_j(plain) / specification.robots
    shares = [robot.energy_budget_j for robot in plain.team.robots]  # of a carrier's budget of 1 J
    return build(specification, float(f"{mean_budget_j / np.mean(shares):.6g}"))


def reference_tour_j(mission: Mission) -> float:
    """Return the energy in joules of the reference tour.

    It is the cheapest closed tour of the first robot, empty, from the first depot through all candidates.
    """
    robot = mission.team.robots[0]
    nodes = [node.id for node in mission.site.nodes]
    index = {node: i for i, node in enumerate(nodes)}
    ways = passages(mission, robot.id)
    ends = [index[way.tail] for way in ways], [index[way.head] for way in ways]
    costs = [way.energy_per_kg * robot.empty_mass_kg for way in ways]
    away = shortest_path(csr_array((costs, ends), shape=(len(nodes), len(nodes))))
    depot = next(index[node.id] for node in mission.site.nodes if node.role == "depot")
    visited = [index[node.id] for node in mission.site.nodes if node.role == "candidate"]
    order = [depot, *visited]
    return shortest_tour(away[np.ix_(order, order)])


def shortest_tour(away: FloatArray) -> float:
    """Return the length of the shortest closed tour through all places of a distance matrix, from place 0.

    Held and Karp's recursion: the least length of a way from place 0 through a set of places to one of them.
    """
    count = len(away) - 1
    members = np.arange(1 << count)
    size = sum((members >> k) & 1 for k in range(count))
    least = np.full((1 << count, count), np.inf)
    least[1 << np.arange(count), np.arange(count)] = away[0, 1:]
    for layer in range(1, count):
        before = members[size == layer]
        for k in range(count):
            without = before[(before >> k) & 1 == 0]
            least[without | 1 << k, k] = (least[without] + away[1:, k + 1]).min(axis=1)
    return float((least[-1] + away[1:, 0]).min())
