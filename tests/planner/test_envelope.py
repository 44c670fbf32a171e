"""Cuts of J between sampling plans: they hold at every plan, and touch J where they should."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray

from malipp_field.field import Information
from malipp_field.planner.exact.cuts import split_information
from malipp_field.planner.exact.envelope import Cut, Envelope, Level, Pair, levels_of

FloatArray = NDArray[np.float64]
Counts = tuple[int, ...]


@dataclass
class Field:
    """A small information model with selectors for every way of sampling each candidate."""

    information: Information
    classes: list[float]
    counts: list[list[Counts]]
    gained: FloatArray

    @property
    def levels(self) -> list[list[Level]]:
        return [
            levels_of(dict(enumerate(own)), self.classes, float(g))
            for own, g in zip(self.counts, self.gained, strict=True)
        ]

    @property
    def apart(self) -> list[list[Level]]:
        """Return a level for every selector."""
        return [
            [Level((), 0.0, (0,) * len(self.classes))]
            + [Level((s,), float(np.dot(c, self.classes)), c) for s, c in enumerate(own)]
            for own in self.counts
        ]

    def plans(self) -> Iterator[tuple[int, ...]]:
        """Yield every combination of selectors; -1 is not sampled."""
        return itertools.product(*(range(-1, len(own)) for own in self.counts))

    def taken(self, plan: Sequence[int]) -> NDArray[np.int64]:
        """Return samples by candidate and class."""
        zero = (0,) * len(self.classes)
        return np.array([zero if s < 0 else own[s] for s, own in zip(plan, self.counts, strict=True)])

    def value(self, plan: Sequence[int]) -> float:
        return self.information.value(self.gained + self.taken(plan) @ np.array(self.classes))

    def share(self, plan: Sequence[int]) -> list[FloatArray]:
        return [np.array([float(s == k) for k in range(len(own))])
                for s, own in zip(plan, self.counts, strict=True)]  # fmt: skip

    def together(self, plan: Sequence[int]) -> dict[Pair, float]:
        """Return n_u n_v."""
        n = self.taken(plan)
        return {
            (k, u, v): float(n[u, k] * n[v, k])
            for k in range(len(self.classes))
            for u, v in itertools.combinations(range(len(n)), 2)
        }


def make(
    seed: int, most: Sequence[Counts], classes: Sequence[float] = (3.0, 40.0), *, gained: bool = False
) -> Field:
    """Return a field with up to ``most`` samples of each class at each candidate."""
    rng = np.random.default_rng(seed)
    places, tests = rng.uniform(0.0, 5.0, (len(most), 2)), rng.uniform(0.0, 5.0, (3, 2))

    def covariance(a: FloatArray, b: FloatArray) -> FloatArray:
        squared: FloatArray = ((a[:, None] - b[None]) ** 2).sum(axis=2)
        return np.asarray(np.exp(-squared / 8.0))

    information = Information(
        covariance(places, places), covariance(tests, places), np.ones(3), rng.uniform(0.5, 2.0, 3)
    )
    counts = [[c for c in itertools.product(*(range(m + 1) for m in own)) if any(c)] for own in most]
    so_far = rng.choice([0.0, 3.0], len(most)) if gained else np.zeros(len(most))
    return Field(information, list(classes), counts, so_far)


def at(cut: Cut, share: Sequence[FloatArray], together: dict[Pair, float]) -> float:
    value = cut.constant + sum(slope * share[i][s] for (i, s), slope in cut.slopes.items())
    return float(value + sum(slope * together[pair] for pair, slope in cut.pairs.items()))


def mixture(rng: np.random.Generator, field: Field) -> tuple[FloatArray, list[tuple[int, ...]]]:
    plans = list(field.plans())
    chosen = [plans[k] for k in rng.choice(len(plans), 3, replace=False)]
    return rng.dirichlet(np.ones(3)), chosen


def averaged(
    field: Field, weights: FloatArray, plans: list[tuple[int, ...]]
) -> tuple[list[FloatArray], dict[Pair, float]]:
    shares = [field.share(plan) for plan in plans]
    share = [sum((w * own[i] for w, own in zip(weights, shares, strict=True)), np.zeros(len(field.counts[i])))
             for i in range(len(field.counts))]  # fmt: skip
    pairs = [field.together(plan) for plan in plans]
    return share, {key: sum(w * own[key] for w, own in zip(weights, pairs, strict=True)) for key in pairs[0]}


_FIELDS = {
    "one each": make(1, [(1, 0), (0, 1), (1, 0), (0, 1)]),
    "both classes": make(2, [(1, 1), (1, 1), (0, 1)]),
    "merged levels": make(3, [(2, 1), (1, 2), (1, 0)]),
    "part-way": make(4, [(1, 1), (2, 0), (0, 1)], gained=True),
    "somebody never": make(5, [(1, 1), (0, 0), (1, 2)], gained=True),
    "three classes": make(6, [(1, 1, 1), (1, 0, 1), (0, 1, 0)], (1.0, 5.0, 25.0)),
}


@pytest.mark.parametrize("name", _FIELDS)
def test_every_cut_holds_at_every_plan(name: str) -> None:
    field = _FIELDS[name]
    envelope = Envelope(field.information, field.levels)
    rng, sloped = np.random.default_rng(7), 0
    every = [(field.value(plan), field.share(plan), field.together(plan)) for plan in field.plans()]
    for trial in range(15):
        share, together = averaged(field, *mixture(rng, field))
        if trial % 3 == 0:  # as far as listed schedules bring it about
            together = {pair: value * rng.uniform() for pair, value in together.items()}
        if trial % 5 == 0:
            share = [rng.dirichlet(np.ones(len(own) + 1))[:-1] for own in share]
        cut = envelope.separate(share, together)
        assert cut is not None
        sloped += bool(cut.slopes)
        assert all(slope > 0.0 for slope in cut.pairs.values())
        for value, own, pairs in every:
            assert at(cut, own, pairs) <= value + 1e-9
    assert sloped > 10


@pytest.mark.parametrize("name", ["one each", "both classes", "three classes"])
def test_cuts_touch_at_plans(name: str) -> None:
    field = _FIELDS[name]
    for plan in field.plans():
        cut = Envelope(field.information, field.apart).separate(field.share(plan), field.together(plan))
        assert cut is not None
        assert at(cut, field.share(plan), field.together(plan)) == pytest.approx(field.value(plan), abs=1e-6)


def test_candidates_outside_the_cluster_are_taken_at_their_highest() -> None:
    field = make(8, [(1, 1)] * 9)  # 4^9 combinations are too many
    envelope = Envelope(field.information, field.levels)
    assert 3 < len(envelope.cluster) < 9
    rng = np.random.default_rng(2)
    best = len(field.counts[0]) - 1
    for trial in range(10):
        plan = rng.integers(-1, best + 1, 9)
        if trial % 2:
            plan[[i for i in range(9) if i not in envelope.cluster]] = best
        share, together = field.share(plan.tolist()), field.together(plan.tolist())
        cut = envelope.separate(share, together)
        assert cut is not None
        value, found = field.value(plan.tolist()), at(cut, share, together)
        assert found == pytest.approx(value, abs=1e-6) if trial % 2 else found <= value + 1e-9
        for other in rng.integers(-1, best + 1, (40, 9)).tolist():
            assert at(cut, field.share(other), field.together(other)) <= field.value(other) + 1e-9


@pytest.mark.parametrize("name", ["one each", "both classes", "three classes"])
def test_between_plans_the_envelope_lies_between_tangents_and_the_average(name: str) -> None:
    field, rng, above = _FIELDS[name], np.random.default_rng(3), 0.0
    envelope = Envelope(field.information, field.apart)
    groups = split_information(field.information, np.ones(len(field.counts), dtype=np.bool_), 40.0)
    precision = [np.array([np.dot(c, field.classes) for c in own]) for own in field.counts]
    for _ in range(20):
        weights, plans = mixture(rng, field)
        share, together = averaged(field, weights, plans)
        average = float(weights @ [field.value(plan) for plan in plans])
        tangent = 0.0
        for group in groups:
            q = [own / (1.0 + d * own) for d, own in zip(group.share, precision, strict=True)]
            mean = np.array([float(own @ part) for own, part in zip(q, share, strict=True)])
            tangent += group.information.value(mean)
        cut = envelope.separate(share, together)
        assert cut is not None
        found = at(cut, share, together)
        assert tangent - 1e-6 <= found <= average + 1e-6
        above = max(above, found - tangent)
    assert above > 1e-3


def test_levels_merge_what_is_more_than_a_sample() -> None:
    counts = {0: (1, 0), 1: (0, 1), 2: (2, 0), 3: (1, 1), 4: (0, 2)}
    assert levels_of(counts, [1.0, 10.0], 0.5) == [
        Level((), 0.5, (0, 0)),
        Level((0,), 1.5, (1, 0)),
        Level((1,), 10.5, (0, 1)),
        Level((2,), 2.5, (2, 0)),
        Level((3, 4), 20.5, (1, 2)),
    ]
