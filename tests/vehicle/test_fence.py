"""Fence and rally points in ArduPilot's encoding, and through the simulated vehicle's stores."""

from __future__ import annotations

import pytest
from check_cases import changed
from vehicle_cases import handoff_plan, small_mission

from malipp_field.errors import PlanError
from malipp_field.mission import Mission, parse_mission, to_local
from malipp_field.vehicle.check import check
from malipp_field.vehicle.check_fence import OF_FENCE
from malipp_field.vehicle.fence import MAX_CORNERS, MAX_RALLY_POINTS, fence_items, rally_items
from malipp_field.vehicle.finding import Finding
from malipp_field.vehicle.items import MissionItem

TEXT = """
format: malipp-mission/1
name: fenced
site:
  origin: {lat_deg: 34.0219, lon_deg: -118.2870, alt_m: 60.0}
  nodes:
    - {id: base, x_m: 0.0, y_m: 0.0, role: depot}
    - {id: east, x_m: 40.0, y_m: 0.0, role: depot}
  edges: [{from: base, to: east}]
  keep_outs:
    - {id: sump, polygon: [{x_m: 20.0, y_m: 5.0}, {x_m: 30.0, y_m: 5.0}, {x_m: 25.0, y_m: 12.0}]}
  fence: [{x_m: -5.0, y_m: -5.0}, {x_m: 60.0, y_m: -5.0}, {x_m: 60.0, y_m: 50.0}, {x_m: -5.0, y_m: 50.0}]
field:
  kernel: {family: rbf, length_scale_m: 30.0}
  test_points: [{x_m: 50.0, y_m: 20.0}]
team:
  sample_mass_kg: 1.0
  robots:
    - {id: scout, start: base, depots: [east, base], empty_mass_kg: 15.0, energy_budget_j: 6000.0,
       payload_capacity: 4, samples_per_node: 2, noise_variance: 0.01, energy_per_kg_m: 3.0, speed_m_s: 1.0}
"""


def fenced(text: str = TEXT) -> Mission:
    return parse_mission(text)


def places(mission: Mission, items: list[MissionItem]) -> set[tuple[float, float]]:
    origin = mission.site.origin
    assert origin is not None
    local = [to_local(item.x / 1e7, item.y / 1e7, origin) for item in items]
    return {(round(x, 1) + 0.0, round(y, 1) + 0.0) for x, y in local}


def test_the_outline_is_an_inclusion_and_keep_outs_are_exclusions() -> None:
    mission = fenced()
    assert mission.site.origin is not None
    items = fence_items(mission, mission.site.origin)
    assert [item.seq for item in items] == list(range(7))
    assert [item.command for item in items] == [5001] * 4 + [5002] * 3
    assert [item.param1 for item in items] == [4.0] * 4 + [3.0] * 3
    assert {item.frame for item in items} == {0}
    assert places(mission, items[:4]) == {(-5.0, -5.0), (60.0, -5.0), (60.0, 50.0), (-5.0, 50.0)}
    assert places(mission, items[4:]) == {(20.0, 5.0), (30.0, 5.0), (25.0, 12.0)}


def test_depots_are_rally_points_in_the_order_of_the_mission_file() -> None:
    mission = fenced()
    assert mission.site.origin is not None
    items = rally_items(mission, mission.site.origin, "scout")
    assert [(item.seq, item.command, item.frame, item.z) for item in items] == [
        (0, 5100, 3, 0.0), (1, 5100, 3, 0.0)
    ]  # fmt: skip
    assert [places(mission, [item]) for item in items] == [{(40.0, 0.0)}, {(0.0, 0.0)}]


def test_a_site_without_either_has_no_fence() -> None:
    lines = [line for line in TEXT.splitlines() if "sump" not in line and "fence:" not in line]
    mission = fenced("\n".join(line for line in lines if "keep_outs" not in line))
    assert mission.site.origin is not None
    assert fence_items(mission, mission.site.origin) == []


def test_a_polygon_with_more_corners_than_fit_is_refused() -> None:
    corners = [f"{{x_m: {x}.0, y_m: -5.0}}" for x in range(-5, MAX_CORNERS)]
    corners += ["{x_m: 300.0, y_m: 50.0}", "{x_m: -5.0, y_m: 50.0}"]
    lines = [f"  fence: [{', '.join(corners)}]" if "fence:" in line else line for line in TEXT.splitlines()]
    mission = fenced("\n".join(lines))
    assert mission.site.origin is not None
    with pytest.raises(PlanError, match=r"site.fence has \d+ corners; ArduPilot stores at most 255"):
        fence_items(mission, mission.site.origin)


def ring(corners: int) -> list[dict[str, float]]:
    """Return a polygon round every node, with so many corners."""
    top = [{"x_m": -5.0 + 65.0 * k / (corners - 2), "y_m": 50.0} for k in range(corners - 1, 0, -1)]
    return [{"x_m": -5.0, "y_m": -5.0}, {"x_m": 70.0, "y_m": -5.0}, *top][:corners]


def findings(**site: object) -> list[Finding]:
    mission = changed(small_mission(), site=site)
    return [found for found in check(mission, handoff_plan()) if found.rule in OF_FENCE]


def test_a_fence_that_just_fits_is_not_found() -> None:
    keep_outs = [{"id": "sump", "polygon": ring(3)}]
    assert findings(fence=ring(252), keep_outs=keep_outs) == []
    assert findings(fence=ring(MAX_CORNERS), keep_outs=[]) == []


def test_a_polygon_with_too_many_corners_is_named() -> None:
    (found,) = findings(fence=None, keep_outs=[{"id": "sump", "polygon": ring(258)}])
    assert (found.severity, found.rule, found.where) == ("error", "fence-too-large", "keep-out 'sump'")
    assert "258 corners" in found.problem
    assert found.remedy.startswith("leave out 3 of them")


def test_polygons_that_are_too_many_together_are_named() -> None:
    keep_outs = [{"id": "sump", "polygon": ring(200)}, {"id": "pond", "polygon": ring(40)}]
    (found,) = findings(fence=ring(20), keep_outs=keep_outs)
    assert found.where == "site.fence, keep-out 'sump', keep-out 'pond'"
    assert "260 corners in all" in found.problem
    assert found.remedy.startswith("leave out 5, first of keep-out 'sump' (200)")


def test_more_depots_than_rally_points_are_found_robot_by_robot() -> None:
    record = small_mission().model_dump(mode="json", by_alias=True, exclude_none=True)
    more = [f"camp{k}" for k in range(MAX_RALLY_POINTS)]
    nodes = [
        *record["site"]["nodes"],
        *({"id": name, "x_m": 0.0, "y_m": 0.0, "role": "depot"} for name in more),
    ]
    robots = record["team"]["robots"]
    first, *others = robots
    kept = first["depots"][:1]
    team = {"robots": [{**first, "depots": [*kept, *more]}, *others]}
    mission = changed(small_mission(), site={"nodes": nodes}, team=team)
    (found,) = [found for found in check(mission, handoff_plan()) if found.rule in OF_FENCE]
    assert (found.severity, found.rule, found.robot) == ("error", "rally-too-many", first["id"])
    assert "21 depots" in found.problem
    assert "leave out 1 of its depots (such as camp19)" in found.remedy
