import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from malipp_field.sim.motion import Disc, Leg, Rates, distance_to_segment_m, stretches

RATES = Rates(speed_m_s=2.0, energy_per_kg_m=3.0)
SLOPE = Disc((50.0, 0.0), 10.0, speed_factor=0.5, energy_factor=2.0)
ROCKS = Disc((58.0, 6.0), 9.0, speed_factor=0.25, energy_factor=1.5)
coordinates = st.floats(-100.0, 100.0)


def leg(start: tuple[float, float] = (0.0, 0.0), end: tuple[float, float] = (100.0, 0.0)) -> Leg:
    return Leg(start, end, stretches(start, end, RATES, [SLOPE, ROCKS]))


def test_even_ground_costs_what_the_paper_says() -> None:
    even = Leg((0.0, 0.0), (30.0, 40.0), stretches((0.0, 0.0), (30.0, 40.0), RATES, []))
    progress = even.advance(1e9, mass_kg=17.0, energy_j=math.inf)
    assert even.done
    assert progress.time_s == pytest.approx(25.0, rel=1e-12)
    assert progress.energy_j == pytest.approx(3.0 * 50.0 * 17.0, rel=1e-12)


def test_a_disc_slows_and_drains_over_exactly_its_chord() -> None:
    parts = stretches((0.0, 0.0), (100.0, 0.0), RATES, [SLOPE])
    assert [part.length_m for part in parts] == pytest.approx([40.0, 20.0, 40.0])
    assert [part.rates.speed_m_s for part in parts] == [2.0, 1.0, 2.0]
    assert [part.rates.energy_per_kg_m for part in parts] == [3.0, 6.0, 3.0]


def test_overlapping_discs_multiply() -> None:
    parts = stretches((50.0, 0.0), (55.0, 0.0), RATES, [SLOPE, ROCKS])
    assert parts[-1].rates.speed_m_s == pytest.approx(2.0 * 0.5 * 0.25)


@given(coordinates, coordinates, coordinates, coordinates)
def test_stretches_add_up_to_the_line_and_agree_with_points_along_it(
    x0: float, y0: float, x1: float, y1: float
) -> None:
    start, end = (x0, y0), (x1, y1)
    parts = stretches(start, end, RATES, [SLOPE, ROCKS])
    length_m = math.dist(start, end)
    assert sum(part.length_m for part in parts) == pytest.approx(length_m, abs=1e-9)
    along_m = 0.0
    for part in parts:
        share = (along_m + part.length_m / 2) / length_m
        middle = (x0 + share * (x1 - x0), y0 + share * (y1 - y0))
        factors = [d.speed_factor for d in (SLOPE, ROCKS) if math.dist(middle, d.centre) < d.radius_m]
        if part.length_m > 1e-6:
            assert part.rates.speed_m_s == pytest.approx(2.0 * math.prod(factors))
        along_m += part.length_m


@given(st.lists(st.floats(1e-3, 40.0), min_size=1, max_size=60))
def test_the_step_size_makes_no_difference(steps: list[float]) -> None:
    whole, stepped = leg(), leg()
    once = whole.advance(sum(steps), 17.0, math.inf)
    taken = [stepped.advance(step, 17.0, math.inf) for step in steps]
    assert stepped.position == pytest.approx(whole.position, abs=1e-7)
    assert sum(p.energy_j for p in taken) == pytest.approx(once.energy_j, rel=1e-9)
    assert sum(p.time_s for p in taken) == pytest.approx(once.time_s, rel=1e-9)


def test_energy_ends_the_drive_where_it_runs_out() -> None:
    short = leg()
    progress = short.advance(1e9, mass_kg=10.0, energy_j=30.0 * 40.0 + 60.0 * 5.0)
    assert not short.done
    assert short.position == pytest.approx((45.0, 0.0))
    assert progress.energy_j == pytest.approx(1500.0)
    assert short.advance(1e9, 10.0, 0.0).time_s == 0.0


def test_headings_are_clockwise_from_north() -> None:
    assert leg(end=(0.0, 10.0)).heading_deg == 0.0
    assert leg(end=(10.0, 0.0)).heading_deg == pytest.approx(90.0)
    assert leg(end=(-10.0, 0.0)).heading_deg == pytest.approx(270.0)


def test_a_leg_to_where_it_began_is_done() -> None:
    nowhere = leg(end=(0.0, 0.0))
    assert nowhere.done
    assert nowhere.position == (0.0, 0.0)
    assert nowhere.advance(1.0, 17.0, math.inf).energy_j == 0.0


def test_distance_to_a_segment_knows_its_ends() -> None:
    assert distance_to_segment_m((5.0, 3.0), (0.0, 0.0), (10.0, 0.0)) == pytest.approx((3.0, 5.0))
    assert distance_to_segment_m((13.0, 4.0), (0.0, 0.0), (10.0, 0.0)) == pytest.approx((5.0, 10.0))
    assert distance_to_segment_m((3.0, 4.0), (0.0, 0.0), (0.0, 0.0)) == pytest.approx((5.0, 0.0))
