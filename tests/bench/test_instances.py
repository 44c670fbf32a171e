"""The generator of benchmark instances, and the tuning of their budgets."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import networkx as nx
import numpy as np
import pytest

from malipp_field.bench import (
    Specification,
    build,
    sequential_coverage,
    tune,
    tuned_mission,
    write_mission,
)
from malipp_field.errors import InputError
from malipp_field.mission import Mission, node_positions, passages, read_mission
from malipp_field.planner import solve

SPEC = Specification(robots=4, candidates=14, seed=3)


def carrier_budget(mission: Mission) -> float:
    return max(robot.energy_budget_j for robot in mission.team.robots)


def one_for_every(joules: float) -> Callable[[Mission], int]:
    """Return a stand-in for Seq-LIPP that samples a candidate for every so many joules."""
    return lambda mission: int(carrier_budget(mission) / joules)


def motion_graph(mission: Mission) -> nx.DiGraph[str]:
    graph: nx.DiGraph[str] = nx.DiGraph()
    graph.add_nodes_from(node.id for node in mission.site.nodes)
    graph.add_edges_from((p.tail, p.head) for p in passages(mission, mission.team.robots[0].id))
    return graph


def test_the_same_specification_gives_the_same_mission() -> None:
    assert build(SPEC, 30.0) == build(SPEC, 30.0)
    assert build(SPEC, 30.0).site != build(replace(SPEC, seed=4), 30.0).site


def test_generated_instances_stay_what_they_are() -> None:
    """Published figures are about these instances: a change of the generator must not go unnoticed."""
    places = node_positions(build(Specification(2, 10), 30.0))
    assert places["v0"] == (0.4412, 3.3529)
    assert places["d0"] == (0.3103, 2.9911)


@pytest.mark.parametrize("seed", range(5))
def test_every_node_reaches_every_other(seed: int) -> None:
    assert nx.is_strongly_connected(motion_graph(build(Specification(3, 12, seed), 30.0)))


def test_without_random_edges_the_repair_alone_connects_the_site() -> None:
    mission = build(replace(SPEC, density=0.0), 30.0)
    assert nx.is_strongly_connected(motion_graph(mission))
    assert len(mission.site.edges) == len(mission.site.nodes) - 1  # a tree
    assert not any(edge.one_way for edge in mission.site.edges)


def test_density_and_one_way_share() -> None:
    mission = build(Specification(8, 60), 30.0)
    count = len(mission.site.nodes)
    pairs = count * (count - 1) // 2
    assert len(mission.site.edges) == round(0.3 * pairs)
    assert sum(edge.one_way for edge in mission.site.edges) == round(0.05 * len(mission.site.edges))
    tails = {edge.from_ < edge.to for edge in mission.site.edges if edge.one_way}
    assert tails == {True, False}  # both directions occur


def test_the_workspace_keeps_candidates_per_area() -> None:
    base, large = Specification(2, 10), Specification(8, 20)
    assert base.side_m == 10.0
    assert large.candidates / large.side_m**2 == pytest.approx(base.candidates / base.side_m**2)
    assert Specification(2, 6).side_m == 10.0
    assert Specification(4, 12, base_candidates=6).side_m == pytest.approx(10.0 * 2**0.5)
    places = np.array(list(node_positions(build(large, 30.0)).values()))
    assert places.min() >= 0.0
    assert 10.0 < places.max() <= large.side_m


def test_precise_robots_have_less_capacity_and_reach() -> None:
    team = build(replace(SPEC, robots=6), 30.0).team.robots
    precise, carriers = team[::2], team[1::2]
    for scout, carrier in zip(precise, carriers, strict=True):
        assert carrier.noise_variance == pytest.approx(20.0 * scout.noise_variance)
        assert 1.0 / carrier.noise_variance + 1.0 / scout.noise_variance == pytest.approx(40.0)
        assert scout.payload_capacity < carrier.payload_capacity
        assert scout.energy_budget_j < carrier.energy_budget_j == 30.0
        assert scout.start == carrier.start
    assert {robot.start for robot in team} == {"d0", "d1"}
    assert all(robot.depots == ("d0", "d1") for robot in team)


def test_sweeps_are_over_the_same_site() -> None:
    plain = build(SPEC, 30.0)
    for other in (
        replace(SPEC, noise_ratio=3.0),
        replace(SPEC, sample_mass_kg=2.0),
        replace(SPEC, test_points="candidates"),
    ):
        assert build(other, 40.0).site == plain.site
    assert build(replace(SPEC, sample_mass_kg=2.0), 30.0).team.sample_mass_kg == 2.0


def test_test_points_at_the_candidates() -> None:
    mission = build(replace(SPEC, test_points="candidates"), 30.0)
    points = [(point.x_m, point.y_m) for point in mission.field.test_points]
    assert points == [place for node, place in node_positions(mission).items() if node.startswith("v")]
    assert len(build(SPEC, 30.0).field.test_points) == SPEC.candidates


def test_a_mission_file_reads_back_as_the_same_mission(tmp_path: Path) -> None:
    mission = build(SPEC, 31.41592653589793)
    write_mission(mission, tmp_path / "mission.yaml")
    assert read_mission(tmp_path / "mission.yaml") == mission


def test_names_tell_specifications_apart() -> None:
    others = [
        replace(SPEC, noise_ratio=3.0),
        replace(SPEC, sample_mass_kg=3.0),
        replace(SPEC, test_points="candidates"),
        replace(SPEC, seed=4),
    ]
    assert SPEC.name == "r4-n14-s3"
    assert len({spec.name for spec in (SPEC, *others)}) == 5


@pytest.mark.parametrize(
    "change",
    [{"robots": 0}, {"seed": -1}, {"density": 1.5}, {"noise_ratio": 0.5}, {"test_points": "nowhere"}],
)
def test_senseless_specifications_are_refused(change: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=next(iter(change)).split("_")[0]):
        Specification(**({"robots": 2, "candidates": 6} | change))


@pytest.mark.parametrize(("n", "target"), [(6, 3), (10, 5), (12, 7), (18, 10), (20, 11)])
def test_target_is_the_number_nearest_to_the_coverage(n: int, target: int) -> None:
    assert Specification(2, n).target == target


def test_budgets_are_tuned_to_the_target() -> None:
    for joules_each in (1.0, 7.0, 200.0):
        mission, sampled = tune(SPEC, one_for_every(joules_each))
        assert sampled == SPEC.target == 8
        assert 8 * joules_each <= carrier_budget(mission) < 9 * joules_each


def test_a_target_stepped_over_gives_the_nearest_coverage() -> None:
    mission, sampled = tune(SPEC, lambda m: 9 if carrier_budget(m) >= 50.0 else 4)
    assert sampled == 9
    assert carrier_budget(mission) >= 50.0
    assert tune(SPEC, lambda _: 2)[1] == 2  # out of reach at any budget


def test_a_tuned_instance_comes_from_its_file(tmp_path: Path) -> None:
    mission = tuned_mission(SPEC, tmp_path, one_for_every(4.0))

    def forbidden(_: Mission) -> int:
        raise AssertionError("tuned again")

    assert tuned_mission(SPEC, tmp_path, forbidden) == mission
    with pytest.raises(AssertionError, match="tuned again"):
        tuned_mission(replace(SPEC, seed=9), tmp_path, forbidden)


@pytest.mark.parametrize("content", ["no mission at all", None])
def test_a_file_of_another_generator_is_replaced(tmp_path: Path, content: str | None) -> None:
    path = tmp_path / f"{SPEC.name}.yaml"
    if content is None:
        other = build(replace(SPEC, density=0.5), 30.0)
        write_mission(other.model_copy(update={"name": SPEC.name}), path)
    else:
        path.write_text(content)
    mission = tuned_mission(SPEC, tmp_path, one_for_every(4.0))
    assert mission.site == build(SPEC, 30.0).site
    assert read_mission(path) == mission


def test_a_folder_that_cannot_be_written_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot be written"):
        tuned_mission(SPEC, tmp_path / "file" / "below", lambda _: 8)


def test_seq_lipp_samples_the_target_on_a_small_instance() -> None:
    spec = Specification(2, 5, seed=1)
    mission, sampled = tune(spec)
    plan = solve(mission, method="seq")
    nodes = {stop.node for robot in plan.robots for stop in robot.route if stop.collect}
    assert sampled == len(nodes) == spec.target == 3
    assert sequential_coverage(build(spec, 0.0)) == 0
