"""Plans become steps: every container is taken once, handed on in order, and comes home."""

from __future__ import annotations

from collections import Counter, deque

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from vehicle_cases import ROBOTS, handoff_plan, plan_of, random_plan, small_mission, stop

from malipp_field.errors import PlanError
from malipp_field.mission import ABSTRACT_ORIGIN, to_globe
from malipp_field.plan import Plan
from malipp_field.vehicle.compile import Compiled, Custody, compile_plan
from malipp_field.vehicle.steps import MAX_TAG, Action, Step

MISSION = small_mission()
ORDER = [Action.WAIT, Action.UNLOAD, Action.COLLECT, Action.DROP, Action.PICK]

UNHURRIED = settings(deadline=None)
"""The machine may be busy with other things."""


class Team:
    """Drives the steps of all vehicles as the world would: gates open only for what is really there."""

    def __init__(self, compiled: Compiled, custody: Custody | None = None) -> None:
        custody = custody or Custody.none()
        self.samples = compiled.samples
        self.on_board = {robot: list(custody.on_board.get(robot, ())) for robot in compiled.missions}
        self.lying: dict[int, tuple[str, str, str | None]] = {
            tag: (node, sender, None) for (node, sender), tags in custody.caches.items() for tag in tags
        }
        self.delivered: list[int] = []
        self.peak = Counter[tuple[str, int]]()
        self.queues = {robot: deque(mission.steps) for robot, mission in compiled.missions.items()}

    def drive(self) -> None:
        while any(self.queues.values()):
            ready = [robot for robot, steps in self.queues.items() if steps and self._open(steps[0])]
            assert ready, "every vehicle waits at a gate that nobody can open"
            for robot in ready:
                self._do(robot, self.queues[robot].popleft())

    def _open(self, step: Step) -> bool:
        return step.action is not Action.WAIT or all(
            tag in self.lying and self.lying[tag][0] == step.node for tag in step.tags
        )

    def _do(self, robot: str, step: Step) -> None:
        load = self.on_board[robot]
        if step.action in {Action.DRIVE, Action.WAIT}:
            return
        (tag,) = step.tags
        if step.action is Action.COLLECT:
            sample = self.samples[tag]
            assert (sample.node, sample.sampler) == (step.node, robot)
            assert tag not in load + self.delivered + list(self.lying)
            load.append(tag)
        elif step.action is Action.PICK:
            node, sender, receiver = self.lying.pop(tag)
            assert (node, sender) == (step.node, step.peer)
            assert receiver in {robot, None}
            load.append(tag)
        else:
            load.remove(tag)
            if step.action is Action.DROP:
                self.lying[tag] = (step.node, robot, step.peer)
            else:
                self.delivered.append(tag)
        self.peak[robot, step.stop] = max(self.peak[robot, step.stop], len(load))


def actions(compiled: Compiled, robot: str) -> list[str]:
    return [
        f"{step.action.value} {step.node if step.action is Action.DRIVE else ','.join(map(str, step.tags))}"
        for step in compiled.missions[robot].steps
    ]


def test_a_handoff_in_steps() -> None:
    compiled = compile_plan(MISSION, handoff_plan())
    assert actions(compiled, "scout") == [
        "drive gate", "drive a", "collect 1", "collect 2", "drive hub", "collect 3", "drop 1", "drop 2",
        "drive gate", "drive base", "unload 3",
    ]  # fmt: skip
    assert actions(compiled, "carrier") == [
        "drive hub", "wait 1,2", "pick 1", "pick 2", "drive base", "unload 1", "unload 2",
    ]  # fmt: skip
    assert actions(compiled, "scout2") == []
    assert {tag: (s.node, s.sampler) for tag, s in compiled.samples.items()} == {
        1: ("a", "scout"), 2: ("a", "scout"), 3: ("hub", "scout"),
    }  # fmt: skip


def test_uids_places_and_peers() -> None:
    compiled = compile_plan(MISSION, handoff_plan())
    scout, carrier = compiled.missions["scout"], compiled.missions["carrier"]
    assert [step.uid for step in scout.steps[:4]] == [
        "v1/scout/1.1/drive/gate", "v1/scout/1.2/drive/a", "v1/scout/1/collect/1", "v1/scout/1/collect/2",
    ]  # fmt: skip
    assert carrier.steps[1].uid == "v1/carrier/1/wait"
    assert (carrier.steps[2].peer, scout.steps[6].peer) == ("scout", "carrier")
    origin = MISSION.site.origin
    assert origin is not None
    assert (scout.steps[0].place.lat_deg, scout.steps[0].place.lon_deg) == to_globe(45.0, 10.0, origin)
    assert (scout.home.lat_deg, scout.home.lon_deg) == pytest.approx((52.48, 13.785), abs=1e-9)
    assert (scout.version, scout.steps[0].stop) == (1, 1)


def test_an_abstract_site_lies_at_a_place_of_its_own() -> None:
    compiled = compile_plan(small_mission(abstract=True), handoff_plan())
    home, first = compiled.missions["scout"].home, compiled.missions["scout"].steps[0].place
    assert (home.lat_deg, home.lon_deg) == to_globe(0.0, 0.0, ABSTRACT_ORIGIN)
    assert (first.lat_deg, first.lon_deg) == to_globe(45.0, 10.0, ABSTRACT_ORIGIN)


@UNHURRIED
@given(st.integers(0, 10**6))
def test_every_container_comes_home(seed: int) -> None:
    plan = random_plan(seed)
    compiled = compile_plan(MISSION, plan)
    team = Team(compiled)
    team.drive()
    assert sorted(team.delivered) == sorted(compiled.samples) == list(range(1, len(compiled.samples) + 1))
    assert not any(team.on_board.values())
    assert not team.lying


@UNHURRIED
@given(st.integers(0, 10**6))
def test_steps_do_what_the_stops_say(seed: int) -> None:
    plan = random_plan(seed)
    compiled = compile_plan(MISSION, plan)
    for robot in plan.robots:
        steps = compiled.missions[robot.id].steps
        for index, planned in enumerate(robot.route):
            mine = [step for step in steps if step.stop == index and step.action is not Action.DRIVE]
            counts = Counter(step.action for step in mine)
            assert counts[Action.COLLECT] == planned.collect
            assert counts[Action.UNLOAD] == planned.unload
            drops = Counter(step.peer for step in mine if step.action is Action.DROP)
            picks = Counter(step.peer for step in mine if step.action is Action.PICK)
            assert (dict(drops), dict(picks)) == (planned.drop, planned.pick)
            picked = tuple(step.tags[0] for step in mine if step.action is Action.PICK)
            assert [step.tags for step in mine if step.action is Action.WAIT] == ([picked] if picked else [])
            assert [step.action for step in mine] == sorted(counts.elements(), key=ORDER.index)
            assert {step.node for step in mine} <= {planned.node}


@UNHURRIED
@given(st.integers(0, 10**6))
def test_the_load_within_a_stop_stays_below_what_the_capacity_rows_bound(seed: int) -> None:
    plan = random_plan(seed)
    team = Team(compile_plan(MISSION, plan))
    team.drive()
    for robot in plan.robots:
        arrival = 0
        for index, planned in enumerate(robot.route):
            bound = max(arrival, arrival + planned.collect - planned.unload, planned.payload)
            assert team.peak[robot.id, index] <= bound
            arrival = planned.payload


@UNHURRIED
@given(st.integers(0, 10**6))
def test_tags_follow_time_and_uids_are_unique_and_stable(seed: int) -> None:
    plan = random_plan(seed)
    compiled = compile_plan(MISSION, plan)
    assert compiled == compile_plan(MISSION, plan)
    uids = [step.uid for mission in compiled.missions.values() for step in mission.steps]
    assert len(uids) == len(set(uids))
    times = {
        step.tags[0]: (plan.robot(robot).route[step.stop].depart_s, ROBOTS.index(robot))
        for robot, mission in compiled.missions.items()
        for step in mission.steps
        if step.action is Action.COLLECT
    }
    assert [times[tag] for tag in sorted(times)] == sorted(times.values())


def residual_plan() -> Plan:
    """Part-way: two samples on board the scout, two of its own at the hub; it leaves one more there."""
    return plan_of(
        {
            "scout": [
                stop("a", 100.0, payload=3, collect=1),
                stop("hub", 130.0, payload=2, path=("a", "hub"), drop={"carrier": 1}),
                stop("base", 200.0, path=("hub", "base"), unload=2),
            ],
            "scout2": [
                stop("b", 100.0),
                stop("hub", 160.0, payload=1, path=("b", "hub"), pick={"scout": 1}),
                stop("base", 260.0, path=("hub", "base"), unload=1),
            ],
            "carrier": [
                stop("base", 100.0),
                stop("hub", 160.0, payload=2, path=("base", "hub"), pick={"scout": 2}),
                stop("base", 260.0, path=("hub", "base"), unload=2),
            ],
        },
        version=2,
    )


def test_containers_of_old_are_handed_on_first() -> None:
    custody = Custody(on_board={"scout": (3, 4)}, caches={("hub", "scout"): (1, 2)}, next_tag=5)
    compiled = compile_plan(MISSION, residual_plan(), custody)
    assert actions(compiled, "scout")[-5:] == ["drive hub", "drop 3", "drive base", "unload 4", "unload 5"]
    assert actions(compiled, "scout")[0] == "collect 5"
    old = [action for robot in ("scout2", "carrier") for action in actions(compiled, robot)]
    assert sorted(a for a in old if a.startswith("pick")) == ["pick 1", "pick 2", "pick 3"]
    assert "wait 1,3" in old or "wait 2,3" in old
    assert list(compiled.samples) == [5]
    assert compiled.missions["scout"].steps[0].uid == "v2/scout/0/collect/5"
    team = Team(compiled, custody)
    team.drive()
    assert sorted(team.delivered) == [1, 2, 3, 4, 5]


def test_times_that_tie_do_not_decide_who_hands_to_whom() -> None:
    plan = plan_of(
        {
            "carrier": [
                stop("base", 0.0),
                stop("hub", 0.0, payload=1, path=("base", "hub"), pick={"scout": 1}),
                stop("base", 0.0, path=("hub", "base"), unload=1),
            ],
            "scout": [
                stop("base", 0.0),
                stop("hub", 0.0, path=("base", "hub"), collect=1, drop={"carrier": 1}),
                stop("base", 0.0, path=("hub", "base")),
            ],
        }
    )
    assert actions(compile_plan(MISSION, plan), "carrier") == [
        "drive hub",
        "wait 1",
        "pick 1",
        "drive base",
        "unload 1",
    ]


def test_a_leg_from_a_depot_to_itself_is_not_driven() -> None:
    plan = plan_of({"scout": [stop("base", 0.0), stop("base", 0.0, path=("base", "base"))]})
    assert compile_plan(MISSION, plan).missions["scout"].steps == ()


def test_tags_run_out() -> None:
    plan = handoff_plan()
    assert list(compile_plan(MISSION, plan, Custody({}, {}, MAX_TAG - 2)).samples)[-1] == MAX_TAG
    with pytest.raises(PlanError, match="all tags up to 32767 have been used"):
        compile_plan(MISSION, plan, Custody({}, {}, MAX_TAG - 1))


@pytest.mark.parametrize(
    ("plan", "words"),
    [
        (plan_of({}), r"the plan has no routes \(feasible\)"),
        (plan_of({}).model_copy(update={"reason": "too far"}), r"no routes \(too far\)"),
        (handoff_plan().model_copy(update={"mission": "other"}), "is for mission 'other', not for 'small'"),
        (plan_of({"rover9": [stop("base", 0.0)]}), "a route for 'rover9'"),
        (plan_of({"scout": [stop("base", 0.0), stop("moon", 9.0, path=("base", "moon"))]}), "no node 'moon'"),
        (plan_of({"scout": [stop("base", 0.0), stop("hub", 9.0)]}), "stop 1: the leg to 'hub' has no path"),
        (plan_of({"scout": [stop("base", 0.0, unload=1)]}), "counts on 1 containers on board, there are 0"),
        (
            plan_of({"scout": [stop("base", 0.0)], "carrier": [stop("base", 0.0, pick={"scout": 1})]}),
            "carrier, stop 0 at 'base': the plan counts on 1 containers left by scout, there are 0",
        ),
    ],
)  # fmt: skip
def test_plans_that_cannot_be_carried_out(plan: Plan, words: str) -> None:
    with pytest.raises(PlanError, match=words):
        compile_plan(MISSION, plan)


def test_a_circle_of_handoffs_is_refused() -> None:
    plan = plan_of(
        {
            "scout": [
                stop("base", 0.0),
                stop("a", 1.0, path=("base", "a"), collect=1, pick={"carrier": 1}),
                stop("b", 2.0, path=("a", "b"), drop={"carrier": 1}),
            ],
            "carrier": [
                stop("base", 0.0),
                stop("b", 1.0, path=("base", "b"), pick={"scout": 1}),
                stop("a", 2.0, path=("b", "a"), collect=1, drop={"scout": 1}),
            ],
        }
    )
    with pytest.raises(PlanError, match=r"wait for each other in a circle: .*scout stop 1"):
        compile_plan(MISSION, plan)


def test_samples_still_wanted_keep_the_tags_they_were_promised() -> None:
    promised = {("scout", "a"): (5, 6), ("scout", "hub"): (8,), ("scout2", "hub"): (4,)}
    compiled = compile_plan(MISSION, handoff_plan(), Custody({}, {}, next_tag=9, promised=promised))
    assert {tag: sample.node for tag, sample in compiled.samples.items()} == {5: "a", 6: "a", 8: "hub"}
    fewer = Custody({}, {}, next_tag=9, promised={("scout", "a"): (6,)})
    assert sorted(compile_plan(MISSION, handoff_plan(), fewer).samples) == [6, 9, 10]
