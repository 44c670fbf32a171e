"""Between plans and values of the literal model's variables, both ways."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import networkx as nx
import numpy as np

from malipp_field.field import FloatArray
from malipp_field.planner.extract import Route, TeamPlan, Visit, payloads, tidy
from malipp_field.planner.paper.literal_model import LiteralModel
from malipp_field.planner.paper.literal_sets import Family


def read_routes(model: LiteralModel) -> tuple[Route, ...]:
    """Return the routes that the present values of the variables stand for, idle stops left out.

    With beta = Delta^H = 0 the model lets robots at one node hand samples round in a circle, all at the same
    time. Nobody gains or loses by that, so circles are taken out.
    """
    counts = {name: _counts(model.families[name]) for name in ("x", "a", "H", "F", "g")}
    counts["H"] = _without_circles(counts["H"])
    return tuple(_without_idle(_read_route(model, counts, r)) for r in range(model.sets.size))


def _counts(family: Family) -> dict[Any, int]:
    """Return the entries that are not zero."""
    values = family.variable.value if family.keys else ()
    return {key: round(float(v)) for key, v in zip(family.keys, values, strict=True) if round(float(v))}


def _without_circles(transfers: dict[Any, int]) -> dict[Any, int]:
    kept = dict(transfers)
    for node in sorted({v for _, _, v in transfers}):
        while True:
            graph = nx.DiGraph((r, o) for r, o, v in kept if v == node)
            try:
                circle = [(r, o, node) for r, o in nx.find_cycle(graph)]
            except nx.NetworkXNoCycle:
                break
            least = min(kept[key] for key in circle)
            kept |= {key: kept[key] - least for key in circle}
            kept = {key: count for key, count in kept.items() if count}
    return kept


def _without_idle(route: Route) -> Route:
    """Leave out idle stops, but for one that a robot needs to get from a depot to the depot's own copy."""
    kept = tidy(route)
    if len(kept) > 2 and kept[-2].node == kept[-1].node:
        return (*kept[:-1], route[-2], kept[-1])
    return kept


def _read_route(model: LiteralModel, counts: dict[str, dict[Any, int]], r: int) -> Route:
    following = {u: v for q, u, v in counts["x"] if q == r}
    visits, slot = [], model.problem.robots[r].start
    while True:
        visits.append(_read_visit(model, counts, r, slot))
        if slot not in following:
            return tuple(visits)
        slot = following[slot]


def _read_visit(model: LiteralModel, counts: dict[str, dict[Any, int]], r: int, slot: int) -> Visit:
    stocks = model.problem.stocks
    return Visit(
        node=slot % len(model.problem.nodes),
        collect=counts["a"].get((r, slot), 0),
        drop={o: n for (q, o, v), n in counts["H"].items() if (q, v) == (r, slot)},
        pick={q: n for (q, o, v), n in counts["H"].items() if (o, v) == (r, slot)},
        fetch={s: n for (q, s), n in counts["F"].items() if q == r and stocks[s].node == slot},
        unload=counts["g"].get((r, slot), 0),
    )


def assign(model: LiteralModel, team: TeamPlan) -> bool:
    """Set all variables to what a plan means; return False, and set none, where it uses what was left out."""
    values: dict[str, FloatArray] = {name: np.zeros(len(f.keys)) for name, f in model.families.items()}
    try:
        for r, route in enumerate(team.routes):
            _assign_route(model, values, r, route, team.depart_s[r])
        _assign_levels(model, values, team)
    except KeyError:
        return False
    for name, family in model.families.items():
        family.variable.save_value(values[name])
    copies = [model.t.position[copy] for copy in model.sets.copies]
    model.T_end.save_value(np.array(max(values["t"][copies])))
    model.one.save_value(np.array(1.0))
    _assign_coefficients(model)
    return True


def _assign_route(
    model: LiteralModel, values: dict[str, FloatArray], r: int, route: Route, depart_s: tuple[float, ...]
) -> None:
    def put(name: str, key: Any, value: float) -> None:
        values[name][model.families[name].position[key]] = value

    problem = model.problem
    if len(route) == 1:  # a robot that stays goes to the copy of the depot it stands at
        route = (*route, Visit(route[0].node))
        depart_s = (*depart_s, depart_s[0] + problem.service_time_s)
    slots = [*(visit.node for visit in route[:-1]), len(problem.nodes) + route[-1].node]
    for slot, visit, time_s in zip(slots, route, depart_s, strict=True):
        put("y", (r, slot), 1.0)
        put("t", (r, slot), time_s)
        if visit.collect:
            put("a", (r, slot), visit.collect)
        if visit.unload:
            put("g", (r, slot), visit.unload)
        for o, count in visit.drop.items():
            put("H", (r, o, slot), count)
            put("delta", (r, o, slot), 1.0)
        for s, count in visit.fetch.items():
            put("F", (r, s), count)
            put("f", (r, s), 1.0)
    loads = payloads(problem.robots[r], route)
    for k, arc in enumerate(pairwise(slots)):
        put("x", (r, *arc), 1.0)
        put("phi", (r, *arc), len(slots) - 1 - k)
        put("Q", (r, *arc), loads[k])


def _assign_levels(model: LiteralModel, values: dict[str, FloatArray], team: TeamPlan) -> None:
    values["p"][:] = team.precision
    for i, p in enumerate(team.precision):
        levels = [(abs(level - p), column) for column, (v, level) in enumerate(model.z.keys) if v == i]
        if p > 0:
            nearest, column = min(levels)
            if nearest > 1e-6 * p:
                raise KeyError(p)
            values["z"][column] = 1.0


def _assign_coefficients(model: LiteralModel) -> None:
    """Set A to the best estimator for the levels selected: K_TS (K_SS + N)^-1 over the sampled nodes."""
    known, chosen = model.problem.information, model.z.variable.value
    coefficients, by_level = np.zeros(model.A.shape), np.zeros(model.A_jvi.shape)
    columns = np.flatnonzero(chosen > 0.5)
    nodes = [model.z.keys[column][0] for column in columns]
    noise = np.diag([1.0 / model.z.keys[column][1] for column in columns])
    best = np.linalg.solve(known.k_vv[np.ix_(nodes, nodes)] + noise, known.k_tv[:, nodes].T).T
    coefficients[:, nodes] = best
    by_level[:, columns] = best
    model.A.save_value(coefficients)
    model.A_jvi.save_value(by_level)
