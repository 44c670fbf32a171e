import itertools
import math

import pytest
from sim_cases import SITE, site

from malipp_field.mission import parse_mission
from malipp_field.sim import World
from malipp_field.sim.world import Outcome
from malipp_field.vehicle.steps import Action

BASE, A, B = (0.0, 0.0), (100.0, 0.0), (100.0, 60.0)
SLOPE = """
simulation:
  terrain: [{x_m: 50.0, y_m: 0.0, radius_m: 10.0, speed_factor: 0.5, energy_factor: 2.0}]
"""


def cost(world: World, robot: str, *places: tuple[float, float]) -> tuple[float, float]:
    """Return time and joules for each kilogram."""
    legs = [
        world.leg(robot, start, end).advance(1e9, 1.0, math.inf) for start, end in itertools.pairwise(places)
    ]
    return sum(p.time_s for p in legs), sum(p.energy_j for p in legs)


def test_a_leg_along_an_edge_has_its_length_and_factors_for_that_robot() -> None:
    world = World(site())
    assert cost(world, "scout", A, B) == pytest.approx((90.0 / (2.0 * 0.5), 90.0 * 3.0 * 1.5), rel=1e-12)
    assert cost(world, "carrier", A, B) == pytest.approx((90.0, 90.0 * 3.0), rel=1e-12)
    assert cost(world, "scout", B, A) == cost(world, "scout", A, B)


def test_parts_of_an_edge_cost_their_share_of_it() -> None:
    world = World(site())
    whole = cost(world, "scout", A, B)
    assert cost(world, "scout", A, (100.0, 17.0), (100.04, 40.0), B) == pytest.approx(whole, rel=1e-4)
    back_and_forth = cost(world, "scout", A, (100.0, 30.0), A)
    assert back_and_forth == pytest.approx(whole, rel=1e-12)


def test_off_any_edge_the_straight_line_counts() -> None:
    world = World(site())
    start, end = (0.0, 30.0), (50.0, 30.0)
    assert cost(world, "scout", start, end) == pytest.approx((25.0, 150.0))
    assert cost(world, "scout", (100.5, 0.0), (100.5, 60.0)) == pytest.approx((30.0, 180.0))


def test_terrain_slows_and_drains_beyond_what_the_planner_knows() -> None:
    assert cost(World(site()), "scout", BASE, A) == pytest.approx((50.0, 300.0))
    assert cost(World(site(SLOPE)), "scout", BASE, A) == pytest.approx((60.0, 360.0))


def test_a_place_that_came_as_multiples_of_1e_7_degree_is_the_node_itself() -> None:
    world = World(site())
    lat_deg, lon_deg = world.globe(B)
    assert world.local(round(lat_deg * 1e7) / 1e7, round(lon_deg * 1e7) / 1e7) == B
    assert world.local(*world.globe((50.0, 50.0))) == pytest.approx((50.0, 50.0), abs=1e-6)


def test_a_container_goes_from_hand_to_hand_and_home() -> None:
    world = World(site())
    assert world.act("scout", Action.COLLECT, 7, A).result == "ok"
    assert world.on_board("scout") == [7]
    assert world.mass_kg("scout") == 17.0
    assert world.act("scout", Action.DROP, 7, B).result == "ok"
    assert world.caches() == {7: B}
    assert world.act("carrier", Action.PICK, 7, (101.0, 60.0)).result == "ok"
    assert world.act("carrier", Action.UNLOAD, 7, BASE).result == "ok"
    assert world.delivered() == {7: "base"}
    assert world.mass_kg("carrier") == 90.0


def test_what_cannot_be_is_refused_with_the_reason() -> None:
    world = World(site())
    assert world.act("scout", Action.COLLECT, 1, BASE).result == "unknown"  # a depot is not sampled
    assert world.act("scout", Action.COLLECT, 0, A).result == "unknown"
    assert world.act("scout", Action.WAIT, 1, A).result == "unknown"
    for tag in (1, 2):
        assert world.act("scout", Action.COLLECT, tag, A).result == "ok"
    assert world.act("scout", Action.COLLECT, 3, A).result == "full"
    assert world.act("carrier", Action.COLLECT, 1, A).result == "unknown"  # that tag is taken
    assert world.act("carrier", Action.PICK, 1, A).result == "missing"
    assert world.act("carrier", Action.UNLOAD, 1, BASE).result == "missing"
    assert world.act("scout", Action.UNLOAD, 1, B).result == "unknown"  # no depot of its own there
    assert world.act("scout", Action.DROP, 1, A).result == "ok"
    assert world.act("carrier", Action.PICK, 1, (100.0, 3.5)).result == "missing"
    assert world.act("carrier", Action.DROP, 1, A).result == "missing"
    assert sorted(world.caches()) == [1]
    assert world.on_board("scout") == [2]


def test_a_full_robot_leaves_the_container_lying() -> None:
    world = World(site())
    assert world.act("carrier", Action.COLLECT, 9, A).result == "ok"
    assert world.act("carrier", Action.DROP, 9, A).result == "ok"
    for tag in (1, 2):
        world.act("scout", Action.COLLECT, tag, A)
    assert world.act("scout", Action.PICK, 9, A).result == "full"
    assert world.caches() == {9: A}


def test_a_repeated_request_is_confirmed_again_and_done_once() -> None:
    world = World(site())
    first = world.act("scout", Action.COLLECT, 7, A)
    assert world.act("scout", Action.COLLECT, 7, A) == first
    assert world.on_board("scout") == [7]
    world.act("scout", Action.DROP, 7, B)
    world.act("carrier", Action.PICK, 7, B)
    assert world.act("scout", Action.DROP, 7, B) == Outcome("ok")
    assert world.act("carrier", Action.PICK, 7, B) == Outcome("ok")
    assert world.on_board("carrier") == [7]
    world.act("carrier", Action.UNLOAD, 7, BASE)
    assert world.act("carrier", Action.UNLOAD, 7, BASE) == Outcome("ok")
    assert world.act("scout", Action.COLLECT, 7, A) == first


def test_in_another_run_the_tags_are_given_anew() -> None:
    world = World(site())
    world.begin_run(3)
    world.act("scout", Action.COLLECT, 7, A)
    world.act("scout", Action.COLLECT, 8, A)
    world.act("scout", Action.DROP, 8, A)
    world.begin_run(3)
    assert world.act("carrier", Action.COLLECT, 7, A).result == "unknown"
    world.begin_run(4)
    assert world.act("carrier", Action.COLLECT, 7, A).result == "ok"
    assert (world.on_board("carrier"), len(world.on_board("scout")), len(world.caches())) == ([7], 1, 1)
    assert world.act("scout", Action.DROP, 9, B).result == "ok"  # whatever it is, it is labelled now
    assert world.caches()[9] == B


def test_having_picked_it_elsewhere_does_not_excuse_a_missing_container() -> None:
    world = World(site())
    world.act("scout", Action.COLLECT, 7, A)
    world.act("scout", Action.DROP, 7, A)
    world.act("scout", Action.PICK, 7, A)
    world.act("scout", Action.DROP, 7, B)
    world.remove(7)
    assert world.act("scout", Action.PICK, 7, B).result == "missing"


def test_the_field_and_its_readings_follow_from_the_seed_alone() -> None:
    one, two = World(site()), World(site())
    other = World(site("simulation: {seed: 5}\n"))
    assert one.true_values == two.true_values != other.true_values
    assert one.act("scout", Action.COLLECT, 1, A) != one.act("scout", Action.COLLECT, 2, A)
    assert two.act("scout", Action.COLLECT, 2, A) == one.act("scout", Action.COLLECT, 2, A)


def test_readings_scatter_about_the_truth_as_the_sensor_does() -> None:
    world = World(site(payload_capacity="500"))
    values = [world.act("scout", Action.COLLECT, tag, A).value for tag in range(1, 401)]
    errors = [value - world.true_values["a"] for value in values if value is not None]
    assert len(errors) == 400
    mean = sum(errors) / 400
    assert abs(mean) < 0.1 / 20 * 4
    assert sum(e**2 for e in errors) / 400 == pytest.approx(0.01, rel=0.3)


def test_the_edge_that_joins_both_places_goes_before_a_longer_one_along_the_same_line() -> None:
    node = "    - {id: m, x_m: 50.0, y_m: 0.0}\n  edges:"
    edge = "    - {from: m, to: a, energy_factor: {scout: 4.0}}\nfield:"
    mission = parse_mission(SITE.replace("  edges:", node).replace("field:", edge))
    world = World(mission)
    assert cost(world, "scout", (50.0, 0.0), A) == pytest.approx((25.0, 50.0 * 3.0 * 4.0))
    assert cost(world, "scout", BASE, A) == pytest.approx((50.0, 300.0))
    assert cost(world, "scout", (25.0, 0.0), A) == pytest.approx((37.5, 225.0))
