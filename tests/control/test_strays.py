"""Who has lost the mission in force, and what the coordinator does about it."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from typing import Any, cast

from control_cases import compiled, drop_plan, relay_mission, telemetry

from malipp_field.bus import Load, Order
from malipp_field.clock import SimClock
from malipp_field.control.dispatch import Dispatch
from malipp_field.control.lookahead import Roads
from malipp_field.control.tracks import Track
from malipp_field.vehicle.steps import Action

BOTH = {"scout", "carrier"}


class Post:
    """Takes orders and does what the test says with them."""

    def __init__(self) -> None:
        self.given: list[tuple[str, Order]] = []
        self.refusals: dict[str, str] = {}

    async def give_all(self, orders: Mapping[str, Order]) -> dict[str, str]:
        self.given += orders.items()
        return {robot: text for robot, text in self.refusals.items() if robot in orders}

    def take(self) -> list[tuple[str, str]]:
        given, self.given = self.given, []
        return [(robot, order.do) for robot, order in given]


class Table:
    """Two vehicles on their first missions, both under way, and their dispatch."""

    def __init__(self) -> None:
        mission, self.roads = relay_mission(), Roads(relay_mission())
        missions, _ = compiled(drop_plan())
        self.tracks = {r: Track(mission, drop_plan().robot(r), missions[r]) for r in ("scout", "carrier")}
        self.clock, self.post = SimClock(100.0), Post()
        self.said: list[tuple[str, str | None]] = []
        self.dispatch = Dispatch(cast(Any, self.post), self.clock, self._say, self.tracks)
        self._first = {
            robot: telemetry(robot, track.mission.steps[0].uid, 0.0, 0.0, 0.0)
            for robot, track in self.tracks.items()
        }
        for robot in self.tracks:
            self.report(robot)

    def _say(self, severity: str, text: str, robot: str | None = None) -> None:
        self.said.append((text, robot))

    def report(self, robot: str, mode: str = "AUTO", **changes: Any) -> None:
        changes = {"time_s": self.clock.now_s(), "mode": mode, **changes}
        self.tracks[robot].update(self._first[robot].model_copy(update=changes), self.roads, 0)

    def lose(self, robot: str, mode: str = "AUTO", **changes: Any) -> None:
        self.report(robot, mode, mission_version=None, step_uid=None, **changes)

    def look(self, duration_s: float, lost: str, mode: str = "AUTO", **changes: Any) -> list[tuple[str, str]]:
        """Let some time pass in which an agent says that it knows no mission; return the orders."""
        for _ in range(round(2 * duration_s)):
            self.clock.advance(0.5)
            self.lose(lost, mode, **changes)
            asyncio.run(self.dispatch.restore(BOTH))
        return self.post.take()


def test_a_mission_that_is_lost_is_put_back_once_that_is_certain() -> None:
    table = Table()
    assert table.look(5.0, "scout") == []
    assert table.dispatch.restoring(BOTH)
    assert table.look(1.0, "scout") == [("scout", "load"), ("scout", "start")]
    assert table.look(5.0, "scout") == [], "what it said before it was given the mission does not count"
    table.report("scout")
    assert not table.dispatch.restoring(BOTH)


def test_a_vehicle_that_was_started_counts_as_under_way_before_its_agent_has_said_so() -> None:
    table = Table()
    for track in table.tracks.values():
        track._driven = None
    asyncio.run(table.dispatch.start({"scout": table.tracks["scout"].mission}))
    assert table.post.take() == [("scout", "start")]
    assert table.look(6.0, "scout") == [("scout", "load"), ("scout", "start")]


def test_a_load_says_what_is_done_and_whether_it_was_begun() -> None:
    table = Table()
    steps = table.tracks["scout"].mission.steps
    taken = next(i for i, step in enumerate(steps) if step.action is Action.COLLECT)
    table.report("scout", step_uid=steps[taken].uid)
    table.tracks["scout"].confirm("an earlier step")
    table.look(6.0, "scout")
    asyncio.run(table.dispatch.load({"scout": table.tracks["scout"].mission}))
    again: list[Load] = []
    proposed: list[Load] = []
    table.post.given.clear()
    table.clock.advance(30.0)
    for orders, act in (
        (again, table.dispatch.put_back(["scout"], BOTH)),
        (proposed, table.dispatch.load({"scout": table.tracks["scout"].mission})),
    ):
        asyncio.run(act)
        orders += [order for _, order in table.post.given if isinstance(order, Load)]
        table.post.given.clear()
    done = {"an earlier step", *(step.uid for step in steps[:taken])}
    assert [(set(order.done), order.begun) for order in again] == [(done, True)]
    assert [(set(order.done), order.begun) for order in proposed] == [(done, False)]


def test_who_has_not_driven_is_finished_or_is_not_heard_has_lost_nothing() -> None:
    for prepare in (
        lambda track: [track.confirm(step.uid) for step in track.mission.steps],
        lambda track: setattr(track, "_driven", None),
    ):
        table = Table()
        prepare(table.tracks["scout"])
        assert table.look(20.0, "scout", link_ok=True) == []
    assert Table().look(20.0, "scout", link_ok=False) == []


def test_a_vehicle_left_to_a_person_takes_no_part_in_a_new_plan_and_nobody_is_stopped_for_it() -> None:
    for changes in ({"mode": "MANUAL"}, {"mode": "HOLD", "armed": False}):
        table = Table()
        assert table.look(20.0, "scout", **changes) == []
        assert [robot for text, robot in table.said if "left to a person" in text] == ["scout"]
        assert not table.dispatch.restoring(BOTH), "the others may be given a new plan"
        missions = {robot: track.mission for robot, track in table.tracks.items()}
        refusals = asyncio.run(table.dispatch.load(missions))
        assert refusals == {"scout": "its mission was changed by somebody else, and it is left alone"}
        asyncio.run(table.dispatch.put_back(missions, BOTH))
        assert table.post.take() == []
        assert table.look(5.0, "scout", "HOLD") == [], "a moment to step aside"
        assert table.look(1.0, "scout", "HOLD") == [("scout", "load"), ("scout", "start")]


def test_what_stood_before_is_given_its_mission_and_still_stands() -> None:
    table = Table()
    table.report("scout", "HOLD")
    assert table.look(6.0, "scout", "HOLD") == [("scout", "load")]
    table.post.refusals = {"scout": "the radio is silent"}
    assert table.look(6.0, "scout", "HOLD") == [("scout", "load")]
    assert table.look(30.0, "scout", "HOLD")[:2] == [("scout", "load")] * 2


def test_after_three_times_without_a_step_forward_it_is_held_and_left() -> None:
    table = Table()
    for _ in range(3):
        assert table.look(6.0, "scout") == [("scout", "load"), ("scout", "start")]
        table.report("scout")
    assert table.look(6.0, "scout") == [("scout", "hold")]
    assert table.look(60.0, "scout", "HOLD") == []
    table.report("scout")  # somebody has found out why
    table.report("scout", step_uid=table.tracks["scout"].mission.steps[1].uid)
    asyncio.run(table.dispatch.restore(BOTH))
    assert table.look(6.0, "scout") == [("scout", "load"), ("scout", "start")]


def test_a_restoration_that_fails_is_tried_again_unless_a_person_has_the_vehicle() -> None:
    table = Table()
    table.post.refusals = {"scout": "the radio is silent"}
    assert table.look(6.0, "scout") == [("scout", "load")]
    assert table.look(30.0, "scout") == [("scout", "load")] * 2
    assert table.look(30.0, "scout", "MANUAL") == []
