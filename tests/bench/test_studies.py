"""What the studies are, how their results are summed up, tabulated and drawn."""

from __future__ import annotations

import csv
import itertools
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import bench_cases
import numpy as np
import pytest
from PIL import Image

from malipp_field.bench import Row, Specification, build
from malipp_field.bench.campaign import Campaign
from malipp_field.bench.cases import Cases, gain, mean
from malipp_field.bench.export import COLUMNS, TRAIL_COLUMNS, write_tables
from malipp_field.bench.figures import draw
from malipp_field.bench.labour import Terms, make_instance
from malipp_field.bench.report import report
from malipp_field.bench.studies import REDUCED, SEQ, STUDIES, Study
from malipp_field.bench.tasks import Trail
from malipp_field.bench.tours import reference_tour_j, shortest_tour, tour_mission
from malipp_field.planner import Progress


def cells(study: Study) -> set[tuple[int, int]]:
    return {(cell.robots, cell.candidates) for cell in study.cells}


def test_the_joint_study_is_the_paper_s() -> None:
    study = STUDIES["joint"]
    assert cells(study) == {(2, 6), (4, 12), (6, 18)}
    assert study.instances == 100
    assert [arm.method for arm in study.arms] == ["seq", "auto", "auto"]
    assert {cell.noise_ratio for cell in study.cells} == {20.0}
    areas = [cell.side_m**2 / cell.robots for cell in study.cells]
    assert areas == pytest.approx([50.0] * 3)  # the workspace grows with the team
    assert len(study.specifications) == 300


def test_the_sweep_is_the_paper_s() -> None:
    study = STUDIES["sweep"]
    assert cells(study) == {(3, 17)}
    assert {cell.candidates + cell.depots for cell in study.cells} == {18}
    grid = {(cell.noise_ratio, cell.sample_mass_kg) for cell in study.cells}
    assert grid == set(itertools.product((1, 3, 5, 20, 100), (0.1, 0.5, 1, 2, 3)))
    assert (study.instances, len(study.specifications)) == (120, 3000)
    first = study.specifications[:25]
    assert len({tour_mission(spec).team.robots[0].energy_budget_j for spec in first[::8]}) == 1


def test_the_other_studies() -> None:
    optimality, scalability, growth = (STUDIES[name] for name in ("optimality", "scalability", "growth"))
    assert cells(optimality) == set(itertools.product((2, 3, 4, 6, 8), range(10, 21, 2)))
    assert {arm.method: arm.time_limit_s for arm in optimality.arms} == {"exact": 900, "fast": 5, "lns": 5}
    assert cells(scalability) == {(8, 31), (10, 38), (12, 45)}
    assert scalability.instances == 60
    assert {arm.method: arm.time_limit_s for arm in scalability.arms}["lns"] == 1800.0
    assert {(50, 500), (100, 1000)} < cells(growth)
    assert growth.fresh
    assert set(REDUCED) == set(STUDIES)


def test_a_study_is_changed_but_for_seq_lipp_s_limit() -> None:
    changed = STUDIES["joint"].changed(
        instances=2, limits_s={None: 3.0, "auto": 2.0}, test_points="candidates"
    )
    assert [arm.time_limit_s for arm in changed.arms] == [1200.0, 2.0, 2.0]
    limited = STUDIES["optimality"].changed(limits_s={None: 7.0, "exact": 60.0})
    assert {arm.method: arm.time_limit_s for arm in limited.arms} == {"exact": 60.0, "fast": 7.0, "lns": 7.0}
    assert STUDIES["scalability"].changed(limits_s={"seq": 9.0}).arms[0].time_limit_s == 9.0
    assert [(spec.robots, spec.seed) for spec in changed.specifications] == [
        (2, 0), (4, 0), (6, 0), (2, 1), (4, 1), (6, 1)
    ]  # fmt: skip
    assert {spec.test_points for spec in changed.specifications} == {"candidates"}


def test_methods_that_the_planner_lacks_are_left_out() -> None:
    arms = (*bench_cases.study().arms, replace(bench_cases.study().arms[0], label="x", method="oracle"))
    study = bench_cases.study(arms=arms)
    assert [arm.label for arm in study.missing] == ["x"]
    assert [arm.label for arm in study.planned] == [SEQ, "no handoffs", "full"]


def test_the_shortest_tour_is_that_of_trying_all_orders() -> None:
    rng = np.random.default_rng(5)
    away = rng.uniform(1.0, 9.0, (7, 7))
    tours = [(0, *order, 0) for order in itertools.permutations(range(1, 7))]
    least = min(sum(away[u, v] for u, v in itertools.pairwise(tour)) for tour in tours)
    assert shortest_tour(away) == pytest.approx(least)
    assert shortest_tour(np.array([[0.0, 2.0], [3.0, 0.0]])) == 5.0


def test_tour_budgets_add_up_to_half_of_the_tour() -> None:
    spec = Specification(3, 6, seed=2)
    mission = tour_mission(spec)
    budgets = [robot.energy_budget_j for robot in mission.team.robots]
    assert sum(budgets) == pytest.approx(0.5 * reference_tour_j(mission), rel=1e-5)
    assert budgets[0] / budgets[1] == pytest.approx(0.6)
    heavy = tour_mission(replace(spec, sample_mass_kg=3.0, noise_ratio=100.0))
    assert [robot.energy_budget_j for robot in heavy.team.robots] == budgets
    with pytest.raises(ValueError, match="at most 18"):
        tour_mission(Specification(3, 19))


@pytest.mark.parametrize("budgets", ["fixed", "tour"])
def test_an_instance_follows_from_its_budget(budgets: Any) -> None:
    spec = Specification(3, 5, seed=1)
    made = make_instance(spec, budgets, Terms())
    assert f"energy_budget_j: {made.carrier_budget_j}" in made.text
    if budgets == "tour":
        assert build(spec, made.carrier_budget_j) == tour_mission(spec)


def test_means_and_intervals_by_hand() -> None:
    found = mean([1.0, 2.0, 3.0, 4.0])
    assert found is not None
    assert found.value == 2.5
    assert found.half == pytest.approx(1.96 * (5.0 / 3.0) ** 0.5 / 2.0)
    assert (found.low, found.high) == pytest.approx((2.5 - 1.265174, 2.5 + 1.265174), abs=1e-6)
    assert str(found) == "2.50 ± 1.27"
    single = mean([3.0])
    assert single is not None
    assert (single.half, single.low, str(single)) == (None, 3.0, "3.00")
    assert mean([]) is None
    assert (gain(10.0, 8.0), gain(10.0, 11.0), gain(0.0, 0.0)) == (20.0, -10.0, 0.0)


def test_a_trail_keeps_better_plans_and_higher_bounds_only() -> None:
    trail = Trail()
    told: list[tuple[float, float | None, float | None]] = [
        (0.1, None, -float("inf")), (0.2, 9.0, 1.0), (0.3, 9.0, 1.0005), (0.4, 8.0, 1.0006), (0.5, 8.5, 2.0)
    ]  # fmt: skip
    for time_s, best, bound in told:
        trail.note(Progress(time_s, "search", best, bound, None, 0))
    assert trail.moments == [(0.2, 9.0, 1.0), (0.4, 8.0, 1.0), (0.5, 8.0, 2.0)]
    assert trail.root_bound == 1.0
    assert trail.ended(0.6, 7.0, 2.5)[-1] == (0.6, 7.0, 2.5)


def test_a_row_tells_what_was_known_when() -> None:
    row = rows_of(bench_cases.study(), {})[bench_cases.CELLS[0], "full"]
    assert row.first_plan_s == 0.5
    assert row.information_at(0.4) is None
    assert row.information_at(0.7) == pytest.approx(8.8)
    assert row.information_at(99.0) == 8.0


def rows_of(study: Study, figures: Mapping[str, Any]) -> dict[tuple[Specification, str], Row]:
    """Return a row for every plan of a study; J differs a little from seed to seed."""
    values = {"Seq-LIPP": 10.0, "no handoffs": 9.0, "LNS": 8.5}
    return {
        (spec, arm.label): bench_cases.planned(
            bench_cases.task_here(spec, arm), values.get(arm.label, 8.0) - 0.1 * spec.seed, **figures
        )
        for spec in study.specifications
        for arm in study.arms
    }


def every_arm(study: Study) -> Study:
    """Return a study whose methods this planner has, whatever they are called in it."""
    known = {"fast": "auto", "lns": "arcs"}
    arms = tuple(replace(arm, method=known.get(arm.method, arm.method)) for arm in study.arms)
    return replace(study, arms=arms)


@pytest.mark.parametrize("name", sorted(REDUCED))
def test_figures_are_drawn(name: str, tmp_path: Path) -> None:
    study = every_arm(REDUCED[name])
    figures = {"bound": 8.0} if name == "optimality" else {}
    png, svg = draw(Cases(study, rows_of(study, figures)), tmp_path / "figure")
    assert svg.read_text().startswith("<?xml")
    with Image.open(png) as image:
        assert image.width >= 700
        assert image.height >= 500
        pixels = np.asarray(image.convert("RGB"))
    colours = {tuple(colour) for colour in pixels.reshape(-1, 3)[::7]}
    assert len(colours) > 20
    ink = (pixels != 255).any(axis=2).mean()
    assert 0.02 < ink < 0.9


@pytest.mark.parametrize("name", sorted(STUDIES))
def test_nothing_is_drawn_of_nothing(name: str, tmp_path: Path) -> None:
    study = every_arm(REDUCED[name])
    assert draw(Cases(study, {}), tmp_path / "figure") == ()
    assert not list(tmp_path.iterdir())
    text = report([Cases(study, {})], "malipp bench", [], {})
    assert f"**{len(study.specifications) * len(study.planned)} of" in text


def test_the_page_has_the_paper_s_figures_beside_ours() -> None:
    study = STUDIES["joint"].changed(instances=2)
    text = report([Cases(study, rows_of(study, {}))], "malipp bench --study joint", ["joint, x: why"], {})
    assert "Made by `malipp bench --study joint`" in text
    assert "- joint, x: why" in text
    # J: 10 and 9.9 by Seq-LIPP, 8 and 7.9 by the full method; gains 20 and 20.202 %
    assert "| 6 x 18 | full | 2 | 33.10 | 20.10 ± 0.20 | 10.06 | 2.00 ± 0.00 | 0.0 % | 50 % |" in text
    assert "dead drops add to that at every size: holds here" in text
    assert "the gain with dead drops grows with the team: **does not hold here**" in text
    assert "Every plan passed the verifier" in text


def test_the_page_counts_matches_of_certified_optima() -> None:
    study = every_arm(REDUCED["optimality"])
    rows = rows_of(study, {"bound": None})
    for spec in study.specifications:
        exact = rows[spec, "exact"]
        rows[spec, "exact"] = exact.model_copy(update={"bound": exact.information})
    spec = study.specifications[0]
    rows[spec, "fast"] = rows[spec, "fast"].model_copy(update={"information": 8.0 * 1.005})
    rows[study.specifications[1], "exact"] = rows[study.specifications[1], "exact"].model_copy(
        update={"bound": 1.0}
    )
    text = report([Cases(study, rows)], "malipp bench", [], {})
    assert "| all | fast | 5 | 100.0 % | 80.0 % | 100.0 % | 0.50 | 1.0 |" in text
    assert "exact certified 5 of 6 instances" in text


def test_the_page_tells_failures_and_missing_methods() -> None:
    strange = replace(STUDIES["growth"].arms[1], method="x")
    study = bench_cases.study(arms=(*bench_cases.study().arms[:2], strange))
    rows = rows_of(study, {})
    first = bench_cases.CELLS[0], SEQ
    rows[first] = rows[first].model_copy(update={"status": "crashed", "information": None, "reason": "died"})
    text = report([Cases(study, {key: row for key, row in rows.items() if key[1] != "fast"})], "x", [], {})
    assert "- **crashed**: r2-n3-s0, Seq-LIPP: died" in text
    assert "not measured, since this planner does not have it: fast (`x`)" in text


def test_tables_have_all_that_is_needed_to_repeat_a_figure(tmp_path: Path) -> None:
    study = bench_cases.study()
    campaign = Campaign([study], tmp_path)
    campaign.cases = lambda study: Cases(study, rows_of(study, {}))  # type: ignore[method-assign]
    table, trails = write_tables(campaign, study)
    with table.open(newline="") as stream:
        lines = list(csv.DictReader(stream))
    assert tuple(lines[0]) == COLUMNS
    needed = {"robots", "candidates", "seed", "noise_ratio", "test_points", "carrier_budget_j", "method",
              "time_limit_s", "threads", "planner_seed", "code", "versions", "machine", "date"}  # fmt: skip
    assert needed < set(COLUMNS)
    assert len(lines) == 12
    full = next(line for line in lines if line["arm"] == "full" and line["seed"] == "0")
    assert (full["information"], full["gain_percent"], full["robots"]) == ("8.0", "20.0", "2")
    assert full["machine"]
    assert "numba" in full["versions"]
    with trails.open(newline="") as stream:
        steps = list(csv.DictReader(stream))
    assert tuple(steps[0]) == TRAIL_COLUMNS
    assert len(steps) == 24
