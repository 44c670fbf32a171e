"""The studies of `malipp bench`: which instances, with which budgets, planned how.

The first three are the paper's (Section "Experiments"); *growth* goes beyond it. All instances are those of
`malipp_field.bench.instances`, whose docstring says what the paper leaves open; choices of a single study:

- *joint*: n = 3R in a workspace that grows from n = 6 on. "Budgets scaled proportionally" is read as tuned
  for each instance so that Seq-LIPP samples the number of candidates nearest to 54.5 % of them, which keeps
  the difficulty the same at every size.
- *sweep*: 18 nodes in all are 17 candidates and one depot. Budgets: `malipp_field.bench.tours`.
- *optimality*: every pair of R and n, tuned budgets. Instances that the exact method does not certify within
  its limit do not count, as in the paper.
- *scalability*: tuned budgets.
- *growth*: ten candidates a robot. Every carrier has the same budget at all sizes, as candidates per area
  are the same: tuning would take dozens of Seq-LIPP plans of the largest teams. With it Seq-LIPP samples
  about 55 % of the candidates of 10 and of 20 robots, as in the other studies.

Unless asked otherwise every plan has one thread, so that as many plans as cores run side by side.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Literal, get_args

from malipp_field.bench.instances import Specification
from malipp_field.mission.schema import Method

Budgets = Literal["tuned", "tour", "fixed"]
"""How an instance comes to its energy budgets: Seq-LIPP's coverage, the reference tour, or one for all."""
TestPoints = Literal["random", "candidates"]

GROWTH_BUDGET_J = 280.0
"""Of a carrier in the study of growth."""
SEQ = "Seq-LIPP"
_SEQ_LIMIT_S = 1200.0
"""The paper's limit for Seq-LIPP in its scalability study."""
_PAPER_LIMIT_S = 900.0
"""The paper's limit for everything that it does not say otherwise of."""
_RATIOS = (1.0, 3.0, 5.0, 20.0, 100.0)
_MASSES_KG = (0.1, 0.5, 1.0, 2.0, 3.0)


@dataclass(frozen=True)
class Arm:
    """One way of planning the instances of a study."""

    label: str
    method: str
    time_limit_s: float
    handoffs: bool = True

    @property
    def available(self) -> bool:
        """Tell whether this planner knows the method."""
        return self.method in get_args(Method)


@dataclass(frozen=True)
class Study:
    """Instances and the ways of planning them.

    Attributes
    ----------
    cells
        Kinds of instances, each given by its first one (seed 0).
    instances
        Of each kind; seeds 0, 1, ...
    fresh
        A process of its own for every plan, so that memory is that of one plan.
    """

    name: str
    title: str
    cells: tuple[Specification, ...]
    instances: int
    budgets: Budgets
    arms: tuple[Arm, ...]
    fresh: bool = False

    @property
    def specifications(self) -> tuple[Specification, ...]:
        """Return all instances, seed by seed, so that a part of a study is a smaller study."""
        return tuple(replace(cell, seed=seed) for seed in range(self.instances) for cell in self.cells)

    @property
    def planned(self) -> tuple[Arm, ...]:
        """Return the arms that this planner can do."""
        return tuple(arm for arm in self.arms if arm.available)

    @property
    def missing(self) -> tuple[Arm, ...]:
        """Return the arms that it cannot."""
        return tuple(arm for arm in self.arms if not arm.available)

    def changed(
        self,
        instances: int | None = None,
        limits_s: Mapping[str | None, float] | None = None,
        test_points: TestPoints = "random",
    ) -> Study:
        """Return the study with another number of instances of each kind, or other limits or test points.

        Limits are by method; that of None is of every method that has none but Seq-LIPP, which is the same
        measure for all of them.
        """
        limits_s = limits_s or {}
        arms = tuple(
            replace(arm, time_limit_s=limits_s.get(arm.method, arm.time_limit_s if arm.label == SEQ else
                                                   limits_s.get(None, arm.time_limit_s)))
            for arm in self.arms
        )  # fmt: skip
        cells = tuple(replace(cell, test_points=test_points) for cell in self.cells)
        return replace(self, instances=instances or self.instances, arms=arms, cells=cells)


def _seq(limit_s: float = _SEQ_LIMIT_S) -> Arm:
    return Arm(SEQ, "seq", limit_s, handoffs=False)


def _sweep_cells(ratios: Iterable[float], masses_kg: Iterable[float]) -> tuple[Specification, ...]:
    masses = tuple(masses_kg)
    return tuple(
        Specification(3, 17, noise_ratio=ratio, sample_mass_kg=mass) for ratio in ratios for mass in masses
    )


def _sizes(pairs: Iterable[tuple[int, int]], base_candidates: int = 10) -> tuple[Specification, ...]:
    return tuple(Specification(r, n, base_candidates=base_candidates) for r, n in pairs)


def _joint(sizes: Iterable[int], instances: int, limit_s: float) -> Study:
    return Study(
        "joint", "Joint planning and dead drops",
        _sizes(((robots, 3 * robots) for robots in sizes), base_candidates=6), instances, "tuned",
        (
            _seq(),
            Arm("no handoffs", "auto", limit_s, handoffs=False),
            Arm("full", "auto", limit_s),
        ),
    )  # fmt: skip


def _sweep(ratios: Iterable[float], masses_kg: Iterable[float], instances: int, limit_s: float) -> Study:
    return Study(
        "sweep", "Sensing ratio and sample mass",
        _sweep_cells(ratios, masses_kg), instances, "tour", (_seq(), Arm("full", "auto", limit_s)),
    )  # fmt: skip


def _optimality(
    sizes: Iterable[tuple[int, int]], instances: int, exact_limit_s: float, limit_s: float
) -> Study:
    return Study(
        "optimality", "How often the optimum is found",
        _sizes(sizes), instances, "tuned",
        (Arm("exact", "exact", exact_limit_s), Arm("fast", "fast", limit_s), Arm("LNS", "lns", limit_s)),
    )  # fmt: skip


def _scalability(
    sizes: Iterable[tuple[int, int]], instances: int, limit_s: float, lns_limit_s: float
) -> Study:
    return Study(
        "scalability", "Gain over time on large teams",
        _sizes(sizes), instances, "tuned",
        (_seq(), Arm("fast", "fast", limit_s), Arm("LNS", "lns", lns_limit_s)),
    )  # fmt: skip


def _growth(robots: Iterable[int], instances: int, seq_limit_s: float, limit_s: float) -> Study:
    return Study(
        "growth", "Time and memory with the size of the team",
        _sizes((count, 10 * count) for count in robots), instances, "fixed",
        (_seq(seq_limit_s), Arm("fast", "fast", limit_s)), fresh=True,
    )  # fmt: skip


_LARGE = ((8, 31), (10, 38), (12, 45))

STUDIES: dict[str, Study] = {
    study.name: study
    for study in (
        _joint((2, 4, 6), 100, _PAPER_LIMIT_S),
        _sweep(_RATIOS, _MASSES_KG, 120, _PAPER_LIMIT_S),
        _optimality([(r, n) for r in (2, 3, 4, 6, 8) for n in range(10, 21, 2)], 12, _PAPER_LIMIT_S, 5.0),
        _scalability(_LARGE, 60, 120.0, 1800.0),
        _growth((5, 10, 20, 35, 50, 70, 100), 3, _SEQ_LIMIT_S, 120.0),
    )
}
"""The studies at full size."""

REDUCED: dict[str, Study] = {
    study.name: study
    for study in (
        _joint((2, 4, 6), 4, 8.0),
        _sweep((1.0, 5.0, 100.0), (0.1, 1.0, 3.0), 2, 4.0),
        _optimality([(2, 10), (3, 10), (4, 10)], 2, 30.0, 5.0),
        _scalability([(8, 31), (12, 45)], 1, 30.0, 60.0),
        _growth((5, 10, 20), 1, 30.0, 15.0),
    )
}
"""The same in ten minutes on two cores: few instances, short limits."""
