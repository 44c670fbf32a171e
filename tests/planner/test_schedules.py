"""One robot's schedules: the cheapest order, listed against priced, and who is like whom."""

from __future__ import annotations

import copy

import numpy as np
import pytest
from numpy.typing import NDArray
from random_missions import part_way, tiny_mission
from schedule_cases import FloatArray, every_schedule, master_gain, random_actor, value_of

from malipp_field.planner.exact.labels import Actor
from malipp_field.planner.exact.schedules import Robot, robots_of
from malipp_field.planner.problem import build_problem, in_units

_ALL = -1e300
_NO_PAIRS = (np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64), np.zeros((0, 1, 1)))


def robot_of(actor: Actor) -> Robot:
    return Robot(actor, tuple(range(len(actor.cost))), 1.0, actor.capacity, 1)


def energy_of(actor: Actor, codes: NDArray[np.int16], route: list[int]) -> float:
    """Return the energy of the cheapest route with these stops in this order."""
    width, load, spent = 2 * actor.capacity + 1, actor.on_board, 0.0
    for here, following in zip(route, [*route[1:], None], strict=True):
        taken, exchange = divmod(int(codes[here]) + actor.capacity, width)
        load = (0 if actor.depot[here] else load + taken) + exchange - actor.capacity
        mass = actor.empty_mass + actor.sample_mass * load
        if following is not None:
            spent += actor.cost[here, following] * mass
            continue
        ways = [actor.cost[here, d] for d in np.flatnonzero(actor.depot) if d != here or here == 0]
        if here and actor.depot[here]:
            ways += [
                actor.cost[here, v] + actor.cost[v, here] for v in range(1, len(actor.cost)) if v not in route
            ]
        spent += min(ways) * mass
    return spent


@pytest.mark.parametrize("seed", range(20))
def test_the_order_is_the_cheapest(seed: int) -> None:
    actor = random_actor(seed, ties=seed % 3 == 0)
    robot = robot_of(actor)
    for vector, least in list(every_schedule(actor).items())[::5]:
        codes = np.array(vector, dtype=np.int16)
        route, energy = robot.order(codes)
        assert energy == pytest.approx(least)
        assert energy_of(actor, codes, route) == pytest.approx(least)
        assert set(np.flatnonzero(codes)) <= set(route)


@pytest.mark.parametrize("seed", range(24))
def test_listed_and_priced_schedules_are_worth_the_same(seed: int) -> None:
    actor, rng = random_actor(seed), np.random.default_rng(seed)
    priced, listed = robot_of(actor), robot_of(actor)
    assert listed.list_all(np.zeros((4, listed.width)), _ALL)
    for _ in range(5):
        gain = master_gain(rng, actor, samples_pay=True)
        best = max(value_of(actor, gain, vector) for vector in every_schedule(actor))
        for robot in (priced, listed):
            most, found = robot.price(gain, _NO_PAIRS, -1e-6, exact_load=False)
            assert most == pytest.approx(max(best, -1e-6), abs=1e-8)
            values = [value_of(actor, gain, tuple(codes.tolist())) for codes in found]
            assert max(values, default=-1e-6) == pytest.approx(max(best, -1e-6), abs=1e-8)
            assert all(value > -1e-6 for value in values)


def test_the_value_of_pairs_counts_for_listed_schedules() -> None:
    robot = robot_of(next(a for a in map(random_actor, range(99)) if a.limits.sum() >= 2 and not a.depot[0]))
    assert robot.list_all(np.zeros((4, robot.width)), _ALL)
    assert robot.pool is not None
    taken = robot.taken_of[robot.pool.codes + robot.capacity]
    u, v = np.flatnonzero(robot.actor.limits)[:2]
    gain = robot.taken_of * np.ones((4, 1))
    expected = (taken.sum(axis=1) - 5.0 * taken[:, u] * taken[:, v]).max()
    worth: FloatArray = -5.0 * np.outer(robot.taken_of, robot.taken_of).astype(np.float64)[None]
    most, _ = robot.price(gain, (np.array([u]), np.array([v]), worth), -100.0, exact_load=False)
    assert most == expected


def test_too_many_schedules_are_not_listed() -> None:
    robot = robot_of(random_actor(6))
    assert not robot.list_all(np.zeros((4, robot.width)), _ALL, room=5)
    assert robot.pool is None


def test_what_is_kept_is_what_was_worth_it() -> None:
    robot = robot_of(random_actor(6))
    robot.list_all(np.zeros((4, robot.width)), _ALL)
    assert robot.pool is not None
    gain: FloatArray = master_gain(np.random.default_rng(1), robot.actor)
    values = np.array([value_of(robot.actor, gain, tuple(codes.tolist())) for codes in robot.pool.codes])
    least = float(np.median(values))
    expected = robot.pool.codes[values >= least]
    robot.price(gain, _NO_PAIRS, 0.0, exact_load=False)
    robot.keep(least)
    assert 0 < len(expected) < len(values)
    np.testing.assert_array_equal(robot.pool.codes, expected)


def test_robots_that_could_stand_in_for_each_other_are_twins() -> None:
    base = tiny_mission(7, robots=3).model_dump(mode="json", by_alias=True, exclude_none=True)
    first = base["team"]["robots"][0]

    def twins(**changes: float) -> list[tuple[int, ...]]:
        record = copy.deepcopy(base)
        record["site"]["edges"] = []
        record["team"]["robots"] = [first | {"id": f"r{r}"} | (changes if r == 2 else {}) for r in range(3)]
        mission = type(tiny_mission(7)).model_validate(record)
        return [robot.twins for robot in robots_of(build_problem(mission))]

    assert twins() == [(0, 1, 2)] * 3
    apart = [(0, 1), (0, 1), (2,)]
    assert twins(energy_budget_j=first["energy_budget_j"] + 1) == apart
    assert twins(noise_variance=7.0) == apart
    assert twins(payload_capacity=4) == apart
    assert twins(empty_mass_kg=1.25) == apart


def test_a_robot_part_way_brings_what_it_has_on_board() -> None:
    mission = tiny_mission(61, candidates=2)
    state = part_way(mission, 61)
    robots = robots_of(in_units(build_problem(mission, state))[0])
    assert [robot.actor.on_board for robot in robots] == [robot.on_board for robot in state.robots]
    assert any(robot.actor.on_board for robot in robots)
