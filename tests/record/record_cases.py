"""A mission of one robot, and what its recordings are made of."""

from __future__ import annotations

from malipp_field.bus.messages import MissionText, Telemetry, root

MISSION = """\
format: malipp-mission/1
name: patch
site:
  nodes:
    - {id: base, x_m: 0, y_m: 0, role: depot}
    - {id: a, x_m: 10, y_m: 0}
  complete: true
field:
  kernel: {family: rbf, length_scale_m: 5.0}
  test_points: [{x_m: 8, y_m: 1}]
team:
  sample_mass_kg: 1.0
  robots:
    - {id: r1, start: base, depots: [base], empty_mass_kg: 1.0, energy_budget_j: 60.0, payload_capacity: 2,
       samples_per_node: 1, noise_variance: 0.1, energy_per_kg_m: 1.0, speed_m_s: 1.0}
"""
TEXT = MissionText(time_s=1000.0, text=MISSION)
KEY = f"{root('patch')}/mission"


def telemetry(time_s: float) -> Telemetry:
    return Telemetry(
        time_s=time_s, robot="r1", lat_deg=0.0, lon_deg=0.0001, heading_deg=90.0, speed_m_s=1.0, mode="AUTO",
        armed=True, ready_to_arm=True, energy_used_j=1.5, mission_version=1, step_uid=None, finished=False,
        link_ok=True,
    )  # fmt: skip
