"""The compiled labelling against plain recursion over every order and every operation."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from schedule_cases import (
    FloatArray,
    Vector,
    best_completion,
    codes_wide,
    every_schedule,
    exchange_of,
    free_gain,
    master_gain,
    random_actor,
    taken_of,
    value_of,
)

from malipp_field.planner.exact.labels import (
    Actor,
    complete_schedules,
    completion,
    enumerate_labels,
    price_labels,
    without_dominated,
)

_ALL = -1e300
_ROOM = 100_000


def listed(actor: Actor, gain: FloatArray, least: float) -> dict[Vector, float]:
    count, codes, mask, place, load, energy, _ = enumerate_labels(actor, gain, least, _ROOM)
    assert count >= 0
    label, spent = complete_schedules(actor, count, codes, mask, place, load, energy)
    found = {tuple(codes[k].tolist()): float(e) for k, e in zip(label, spent, strict=True)}
    assert len(found) == len(label)
    return found


def idle(actor: Actor) -> FloatArray:
    return np.zeros((len(actor.cost), codes_wide(actor)))


def forbid(rng: np.random.Generator, actor: Actor, gain: FloatArray) -> bool:
    """Forbid codes here and there as branching does; return whether a drop may be asked for."""
    exchange, taken, asked = exchange_of(actor), taken_of(actor), False
    for w in range(len(gain)):
        if rng.random() < 0.35:
            t = int(rng.integers(1, 3))
            hit = (exchange <= -t, exchange >= t, taken >= 1)[kind := int(rng.integers(3))]
            other = bool(rng.random() < 0.5)
            asked |= kind == 0 and other
            gain[w, ~hit if other else hit] = -np.inf
    return asked


def priced(
    actor: Actor, gain: FloatArray, *, exact_load: bool = False, least: float = -100.0, room: int = _ROOM
) -> tuple[float, dict[Vector, float]]:
    """Return the bound on the rest, and the value of every schedule found."""
    must = sum(1 << w for w in range(len(gain)) if gain[w, actor.capacity] == -np.inf)
    rest, found, worths, code_of, place, parent = price_labels(
        actor, gain, np.uint64(must), exact_load, least, room, room
    )
    values: dict[Vector, float] = {}
    for k, worth in zip(found, worths, strict=True):
        vector = _vector(actor, int(k), code_of, place, parent)
        values[vector] = max(float(worth), values.get(vector, -np.inf))  # with a toll the order counts
    return float(rest), values


def _vector(
    actor: Actor, label: int, code_of: NDArray[np.int16], place: NDArray[np.int16], parent: NDArray[np.int32]
) -> Vector:
    codes = [0] * len(actor.cost)
    while label >= 0:
        codes[place[label]] = int(code_of[label])
        label = int(parent[label])
    return tuple(codes)


@pytest.mark.parametrize("seed", range(60))
def test_listing_is_complete_and_cheapest(seed: int) -> None:
    actor = random_actor(seed, places=4 + (seed % 10 == 0), ties=seed % 3 == 0)
    assert listed(actor, idle(actor), _ALL) == pytest.approx(every_schedule(actor), abs=1e-9)


def test_the_cases_are_of_every_kind() -> None:
    actors = [random_actor(seed, ties=seed % 3 == 0) for seed in range(60)]
    sizes = [len(every_schedule(actor)) for actor in actors]
    assert max(sizes) > 100
    assert any(actor.depot[0] for actor in actors)
    assert any(actor.depot.sum() == 1 and actor.most_pick[actor.depot].any() for actor in actors)
    assert any(actor.on_board and actor.limits[0] for actor in actors)
    whole = [
        energy == actor.budget
        for actor in actors if float(actor.budget).is_integer()
        for energy in every_schedule(actor).values()
    ]  # fmt: skip
    assert any(whole)


@pytest.mark.parametrize("seed", range(20))
def test_a_threshold_keeps_all_schedules_worth_it(seed: int) -> None:
    actor, rng = random_actor(seed), np.random.default_rng(seed)
    every = every_schedule(actor)
    gain = free_gain(rng, actor)
    best = max(value_of(actor, gain, vector) for vector in every)
    found = listed(actor, gain, best - 0.4)
    worthy = {vector: e for vector, e in every.items() if value_of(actor, gain, vector) >= best - 0.4}
    assert worthy.keys() <= found.keys() <= every.keys()
    assert {vector: found[vector] for vector in worthy} == pytest.approx(worthy, abs=1e-9)
    assert len(found) < len(every) or len(every) < 20
    assert not listed(actor, gain, best + 10.0)


def test_forbidden_codes_are_not_listed() -> None:
    actor = random_actor(6)
    gain = idle(actor)
    gain[2, exchange_of(actor) != 0] = -np.inf
    expected = {v: e for v, e in every_schedule(actor).items() if gain[2, v[2] + actor.capacity] == 0.0}
    assert 0 < len(expected) < len(every_schedule(actor))
    assert listed(actor, gain, -1.0) == pytest.approx(expected)


def test_a_list_that_does_not_fit_is_no_list() -> None:
    actor = random_actor(4)
    count = enumerate_labels(actor, idle(actor), _ALL, _ROOM)[0]
    assert count > 10
    assert enumerate_labels(actor, idle(actor), _ALL, count + 1)[0] == count
    assert enumerate_labels(actor, idle(actor), _ALL, count - 1)[0] == -1


def test_a_robot_without_energy_or_a_way_home_has_nothing() -> None:
    actor = random_actor(4)
    stuck = actor._replace(depot=np.zeros_like(actor.depot), home=np.full_like(actor.home, np.inf))
    assert not listed(stuck, idle(actor), _ALL)
    at_home = random_actor(4)._replace(
        budget=0.0,
        home=np.where(np.arange(4) == 0, 0.0, actor.home),
        depot=np.array([True, False, False, False]),
    )
    assert set(listed(at_home, idle(actor), _ALL)) == set(every_schedule(at_home))


@pytest.mark.parametrize("seed", range(24))
def test_completion_is_never_below_what_can_still_be_gathered(seed: int) -> None:
    rng = np.random.default_rng(seed)
    actor = random_actor(seed, ties=seed % 3 == 0)
    if seed % 4 == 0:  # legs below one step of energy
        actor = actor._replace(cost=actor.cost * 1e-3, home=actor.home * 1e-3)
    gain = free_gain(rng, actor)
    if seed % 2:
        forbid(rng, actor, gain)
    gain[:, actor.capacity] = 0.0
    bound, step, slack = completion(actor, gain)
    assert bound.shape[:2] == (4, actor.capacity + 1)
    for at, load in np.ndindex(4, actor.capacity + 1):
        for energy in rng.uniform(0.0, actor.budget, 4 if seed % 4 else 1):
            level = min(int(energy / step) + slack, bound.shape[2] - 1)
            assert bound[at, load, level] >= best_completion(actor, gain, at, load, energy) - 1e-9


@pytest.mark.parametrize("seed", range(60))
def test_pricing_finds_the_best_schedule(seed: int) -> None:
    actor = random_actor(seed, places=4 + (seed % 10 == 0), ties=seed % 3 == 0)
    every = every_schedule(actor)
    rng = np.random.default_rng(seed)
    for trial in range(10):
        gain = master_gain(rng, actor)
        exact_load = trial > 0 and forbid(rng, actor, gain)
        best = max((value_of(actor, gain, vector) for vector in every), default=-np.inf)
        rest, found = priced(actor, gain, exact_load=exact_load)
        assert rest == -100.0
        assert max(found.values(), default=-np.inf) == pytest.approx(best, abs=1e-8)
        for vector, worth in found.items():
            assert vector in every
            assert worth == pytest.approx(value_of(actor, gain, vector))


def test_a_load_unloaded_on_the_way_does_not_put_a_place_out_of_reach() -> None:
    # the direct leg to place 2 is too dear with two on board; by way of the depot it is not
    side = np.array([[0.0, 1.0, 2.0], [1.0, 0.0, 1.0], [2.0, 1.0, 0.0]])
    actor = Actor(
        cost=side, home=np.array([1.0, np.inf, 1.0]), empty_mass=1.0, sample_mass=1.0, budget=6.0, capacity=2,
        on_board=2, limits=np.array([0, 0, 1]), most_drop=np.zeros(3, dtype=np.int64),
        most_pick=np.zeros(3, dtype=np.int64), depot=np.array([False, True, False]),
    )  # fmt: skip
    gain = np.zeros((3, 10))
    gain[2, 5:] = 1.0
    assert priced(actor, gain, least=0.5)[1] == {(0, 0, 5): 1.0}


def test_what_is_to_be_dropped_may_be_picked_for_nothing() -> None:
    line = np.abs(np.subtract.outer([0.0, 1.0, 2.0], [0.0, 1.0, 2.0]))
    actor = Actor(
        cost=line, home=line[:, 0].copy(), empty_mass=1.0, sample_mass=1.0, budget=10.0, capacity=1,
        on_board=0, limits=np.zeros(3, dtype=np.int64), most_drop=np.array([0, 0, 1]),
        most_pick=np.array([0, 1, 0]), depot=np.array([True, False, False]),
    )  # fmt: skip
    gain = np.zeros((3, 3))
    gain[2, 0], gain[2, 1:] = -1.0, -np.inf
    assert priced(actor, gain, exact_load=True)[1] == {(0, 1, -1): -1.0}


@pytest.mark.parametrize("seed", range(12))
def test_a_search_that_runs_out_of_room_still_bounds_the_rest(seed: int) -> None:
    actor, rng = random_actor(seed, places=5), np.random.default_rng(seed)
    every = every_schedule(actor)
    cut_short = 0
    for room in (codes_wide(actor), 13, 17, 33, 70):  # what can be done at the start has room
        gain = master_gain(rng, actor)
        best = max(value_of(actor, gain, vector) for vector in every)
        rest, found = priced(actor, gain, room=room)
        cut_short += rest > -100.0
        assert max(rest, *found.values(), -100.0) >= best - 1e-9
    assert cut_short


def test_only_schedules_worth_more_than_asked_for_are_found() -> None:
    actor = random_actor(6)
    gain = master_gain(np.random.default_rng(3), actor)
    best = max(value_of(actor, gain, vector) for vector in every_schedule(actor))
    rest, found = priced(actor, gain, least=best - 1e-3)
    assert rest == best - 1e-3
    assert found
    assert all(worth > best - 1e-3 for worth in found.values())
    assert priced(actor, gain, least=best + 1e-6) == (best + 1e-6, {})


@pytest.mark.parametrize("seed", range(20))
def test_what_is_left_out_is_beaten_by_something_kept(seed: int) -> None:
    actor = random_actor(seed)
    every = every_schedule(actor)
    codes = np.array(list(every), dtype=np.int16)
    keep = without_dominated(codes, actor.capacity, actor.limits, actor.most_pick)
    taken, exchange = taken_of(actor)[codes + actor.capacity], exchange_of(actor)[codes + actor.capacity]
    for k in range(len(codes)):
        beaten = np.all((taken >= taken[k]) & (exchange >= exchange[k]), axis=1)
        beaten[k] = False
        if keep[k]:
            steps = np.sum(taken - taken[k] + exchange - exchange[k], axis=1)
            assert not np.any(beaten & (steps == 1))
        else:
            assert np.any(beaten & keep)
