"""Degrees and metres, passages of single robots, keep-outs, complete sites, and the state at the start."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from malipp_field.mission import (
    ABSTRACT_ORIGIN,
    Mission,
    Passage,
    initial_state,
    keep_out_polygons,
    locate,
    node_positions,
    parse_mission,
    passages,
    to_globe,
    to_local,
)  # fmt: skip
from malipp_field.mission.schema import Origin, Place

ORIGIN = Origin(lat_deg=52.48, lon_deg=13.785, alt_m=40.0)
SITE = """\
format: malipp-mission/1
name: graph
site:
{options}
  nodes:
    - {{id: base, x_m: 0.0, y_m: 0.0, role: depot}}
    - {{id: a, x_m: 30.0, y_m: 40.0}}
    - {{id: b, x_m: 60.0, y_m: 0.0}}
  edges:
    - {{from: base, to: a, energy_factor: {{carrier: 2.0}}, speed_factor: {{carrier: 0.5}}}}
    - {{from: a, to: b, length_m: 80.0, one_way: true, closed_to: [scout]}}
field: {{kernel: {{family: rbf, length_scale_m: 20.0}}, test_points: [{{x_m: 10.0, y_m: 10.0}}]}}
team:
  sample_mass_kg: 2.0
  robots:
    - {{id: scout, start: base, depots: [base], empty_mass_kg: 20.0, energy_budget_j: 1000.0,
       payload_capacity: 2, samples_per_node: 1, noise_variance: 0.1, energy_per_kg_m: 3.0, speed_m_s: 2.0}}
    - {{id: carrier, start: base, depots: [base], empty_mass_kg: 90.0, energy_budget_j: 9000.0,
       payload_capacity: 8, samples_per_node: 0, noise_variance: 1.0, energy_per_kg_m: 2.0, speed_m_s: 1.0}}
"""
POND = """\
  complete: true
  keep_outs:
    - id: pond
      polygon: [{x_m: 25.0, y_m: -5.0}, {x_m: 35.0, y_m: -5.0}, {x_m: 30.0, y_m: 5.0}]
"""


def mission(options: str = "  complete: false") -> Mission:
    return parse_mission(SITE.format(options=options))


def by_ends(found: list[Passage]) -> dict[tuple[str, str], Passage]:
    assert len({(p.tail, p.head) for p in found}) == len(found)
    return {(p.tail, p.head): p for p in found}


def test_passages_with_factors_one_way_and_closures() -> None:
    assert by_ends(passages(mission(), "scout")) == {
        ("base", "a"): Passage("base", "a", 50.0, 150.0, 25.0),
        ("a", "base"): Passage("a", "base", 50.0, 150.0, 25.0),
    }
    assert by_ends(passages(mission(), "carrier")) == {
        ("base", "a"): Passage("base", "a", 50.0, 200.0, 100.0),
        ("a", "base"): Passage("a", "base", 50.0, 200.0, 100.0),
        ("a", "b"): Passage("a", "b", 80.0, 160.0, 80.0),
    }


def test_a_complete_site_joins_what_no_edge_speaks_of() -> None:
    scout = by_ends(passages(mission("  complete: true"), "scout"))
    assert set(scout) == {("base", "a"), ("a", "base"), ("base", "b"), ("b", "base"), ("b", "a")}
    assert scout["b", "a"] == Passage("b", "a", 50.0, 150.0, 25.0)


def test_a_complete_site_leaves_out_what_a_keep_out_bars() -> None:
    pond = mission(POND)
    assert keep_out_polygons(pond)["pond"].area == pytest.approx(50.0)
    assert set(by_ends(passages(pond, "scout"))) == {("base", "a"), ("a", "base"), ("b", "a")}


def test_an_edge_may_touch_a_keep_out() -> None:
    touching = POND.replace("y_m: -5.0", "y_m: 0.0")  # its lower side now lies on the line base to b
    assert ("base", "b") in by_ends(passages(mission(touching), "scout"))


def test_degrees_and_metres_name_the_same_node() -> None:
    lat_deg, lon_deg = to_globe(30.0, 40.0, ORIGIN)
    text = SITE.format(options="  origin: {lat_deg: 52.48, lon_deg: 13.785, alt_m: 40.0}")
    text = text.replace("id: a, x_m: 30.0, y_m: 40.0", f"id: a, lat_deg: {lat_deg!r}, lon_deg: {lon_deg!r}")
    assert node_positions(parse_mission(text))["a"] == pytest.approx((30.0, 40.0), abs=1e-4)
    assert locate(Place(lat_deg=lat_deg, lon_deg=lon_deg), ORIGIN) == pytest.approx((30.0, 40.0), abs=1e-4)
    assert locate(Place(x_m=3.0, y_m=4.0), None) == (3.0, 4.0)


@given(
    st.floats(-75, 75), st.floats(-179, 179), st.floats(-2000, 2000), st.floats(-2000, 2000)
)  # fmt: skip
def test_the_way_there_and_back(lat_deg: float, lon_deg: float, x_m: float, y_m: float) -> None:
    origin = Origin(lat_deg=lat_deg, lon_deg=lon_deg, alt_m=100.0)
    assert to_local(*to_globe(x_m, y_m, origin), origin) == pytest.approx((x_m, y_m), abs=2e-3)


def test_a_minute_of_latitude_is_a_nautical_mile() -> None:
    x_m, y_m = to_local(45.0 + 1 / 60, 10.0, Origin(lat_deg=45.0, lon_deg=10.0))
    assert (x_m, y_m) == pytest.approx((0.0, 1852.0), abs=1.0)
    assert to_globe(0.0, 0.0, ABSTRACT_ORIGIN) == pytest.approx((1.0, 1.0), abs=1e-12)


def test_a_place_in_degrees_needs_an_origin() -> None:
    with pytest.raises(ValueError, match=r"needs site\.origin"):
        locate(Place(lat_deg=1.0, lon_deg=2.0), None)


def test_the_state_at_the_start() -> None:
    state = initial_state(mission())
    carrier = state.robot("carrier")
    assert (carrier.node, carrier.ready_s, carrier.energy_left_j, carrier.on_board) == (
        "base",
        0.0,
        9000.0,
        0,
    )
    assert (state.time_s, state.caches) == (0.0, ())
    with pytest.raises(KeyError):
        state.robot("nobody")
    assert math.isclose(state.robot("scout").energy_left_j, 1000.0)
