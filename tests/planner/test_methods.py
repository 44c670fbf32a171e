"""What every method keeps to: its name in the plan, no drops where none are allowed, a limit on work."""

from __future__ import annotations

from typing import Any

import pytest
from random_missions import tiny_mission

from malipp_field.mission.schema import Method
from malipp_field.plan import Plan
from malipp_field.planner import Progress, solve
from malipp_field.planner.extract import Visit, tidy


def information(plan: Plan) -> float:
    assert plan.objective is not None
    return plan.objective.information


@pytest.mark.parametrize(
    ("method", "handoffs", "name"),
    [
        ("exact", True, "exact"),
        ("exact", False, "no-handoffs"),
        ("auto", True, "exact"),
        ("no-handoffs", True, "no-handoffs"),
        ("arcs", True, "arcs"),
        ("arcs", False, "arcs"),
        ("seq", True, "seq"),
        ("lns", True, "lns"),
        ("lns", False, "lns"),
    ],
)
def test_a_plan_says_which_method_made_it(method: Method, handoffs: bool, name: str) -> None:
    plan = solve(tiny_mission(133, candidates=3), method=method, handoffs=handoffs)
    assert plan.method == name
    assert (plan.handoffs > 0) == (handoffs and method in {"exact", "auto", "arcs", "lns"})


def test_the_literal_model_is_reached_and_agrees() -> None:
    mission = tiny_mission(133, candidates=2)
    literal, arcs = solve(mission, method="miqp"), solve(mission, method="arcs")
    assert (literal.method, literal.status) == ("miqp", "optimal")
    assert information(literal) == pytest.approx(information(arcs), rel=2e-4)


def test_a_limit_on_work_ends_the_rounds() -> None:
    heard: list[Progress] = []

    def rounds(**options: Any) -> int:
        heard.clear()
        plan = solve(
            tiny_mission(108, candidates=4), method="arcs", mip_gap=1e-7, on_progress=heard.append, **options
        )
        assert plan.robots
        return max(progress.rounds for progress in heard)

    assert rounds() > 1
    assert rounds(work_limit=1) == 1


def test_drops_of_a_warm_start_do_not_come_into_a_plan_without() -> None:
    mission = tiny_mission(133, candidates=3)
    free = solve(mission, method="arcs")
    assert free.handoffs
    alone = solve(mission, method="arcs", handoffs=False, warm_start=free)
    assert alone.handoffs == 0
    assert information(alone) > information(free)


@pytest.mark.parametrize("method", ["exact", "arcs", "miqp", "lns"])
def test_every_method_keeps_to_closed_nodes(method: Method) -> None:
    mission = tiny_mission(103, candidates=2)
    closed = {node.id for node in mission.site.nodes}
    everywhere = solve(mission, method=method, closed=closed)
    assert everywhere.handoffs == 0
    alone = solve(mission, method="arcs", handoffs=False)
    assert information(everywhere) == pytest.approx(information(alone), rel=2e-4)
    assert information(solve(mission, method=method)) < information(alone) - 0.1


def test_an_idle_stop_between_a_depot_and_its_terminal_is_no_reason_to_break_a_rule() -> None:
    assert solve(tiny_mission(133, candidates=2), method="arcs", handoffs=False).status == "optimal"


def test_leaving_out_idle_stops_makes_no_leg_from_a_depot_to_itself() -> None:
    start, idle, end = Visit(0, collect=1), Visit(1), Visit(2)
    assert tidy((start, Visit(2, unload=1), idle, end)) == (start, Visit(2, unload=1))
    busy = Visit(2, pick={1: 1}, unload=1)
    last = Visit(2, unload=1)
    assert tidy((start, busy, idle, last)) == (start, busy, idle, last)
    assert tidy((start, idle, end)) == (start, end)
