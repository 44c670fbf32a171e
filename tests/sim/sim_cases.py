"""A small site, missions for its rovers, and a ground station made of messages."""

from __future__ import annotations

import re
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from malipp_field.mission import Mission, parse_mission
from malipp_field.sim import Rover, RoverConfig, World
from malipp_field.vehicle.items import MissionItem, degrees_e7
from malipp_field.vehicle.layout import ACTION_CODES
from malipp_field.vehicle.payload_protocol import PayloadReport, ack_name, parse_confirmation
from malipp_field.vehicle.steps import Action

START_S = 1_700_000_000.0
GROUND = (255, 190)

SITE = """
format: malipp-mission/1
name: small
site:
  origin: {lat_deg: 34.0219, lon_deg: -118.2870, alt_m: 60.0}
  nodes:
    - {id: base, x_m: 0.0, y_m: 0.0, role: depot}
    - {id: a, x_m: 100.0, y_m: 0.0}
    - {id: b, x_m: 100.0, y_m: 60.0}
  edges:
    - {from: base, to: a}
    - {from: a, to: b, length_m: 90.0, energy_factor: {scout: 1.5}, speed_factor: {scout: 0.5}}
    - {from: b, to: base}
field:
  kernel: {family: rbf, length_scale_m: 30.0, variance: 2.0}
  test_points: [{x_m: 50.0, y_m: 20.0}]
team:
  sample_mass_kg: 2.0
  service_time_s: 12.0
  robots:
    - {id: scout, start: base, depots: [base], empty_mass_kg: 15.0, energy_budget_j: 60000.0,
       payload_capacity: 2, samples_per_node: 2, noise_variance: 0.01, energy_per_kg_m: 3.0, speed_m_s: 2.0}
    - {id: carrier, start: base, depots: [base], empty_mass_kg: 90.0, energy_budget_j: 200000.0,
       payload_capacity: 8, samples_per_node: 1, noise_variance: 1.0, energy_per_kg_m: 3.0, speed_m_s: 1.0}
"""


def site(extra: str = "", **replaced: str) -> Mission:
    """Return the small site, with text appended and the first ``key: value`` of each key replaced."""
    text = SITE
    for key, value in replaced.items():
        text = re.sub(rf"\b{key}: [^,}}\n]+", f"{key}: {value}", text, count=1)
    return parse_mission(text + extra)


def waypoint(world: World, node: str, hold_s: float = 0.0) -> MissionItem:
    lat_deg, lon_deg = world.globe(world.places[node])
    return MissionItem(
        0, mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT, mavlink.MAV_CMD_NAV_WAYPOINT, 0, 1, hold_s, 0.0, 0.0, 0.0,
        degrees_e7(lat_deg), degrees_e7(lon_deg), 0.0,
    )  # fmt: skip


def action(what: Action, stop: int, tag: int = 0, timeout_s: float = 0.0) -> MissionItem:
    return MissionItem(
        0, mavlink.MAV_FRAME_MISSION, mavlink.MAV_CMD_NAV_SCRIPT_TIME, 0, 1,
        float(ACTION_CODES[what]), timeout_s, float(stop), 1.0, tag, 0, 0.0,
    )  # fmt: skip


def numbered(world: World, items: list[MissionItem]) -> list[MissionItem]:
    """Return a mission: home first, then the items, numbered."""
    return [item._replace(seq=seq) for seq, item in enumerate([waypoint(world, "base"), *items])]


def from_ground(message: Any, ground: tuple[int, int] = GROUND) -> Any:
    """Return a message as it arrives from a ground station: packed and parsed."""
    packed = message.pack(mavlink.MAVLink(None, srcSystem=ground[0], srcComponent=ground[1]))
    return mavlink.MAVLink(None).parse_buffer(bytearray(packed))[0]


def item_int(item: MissionItem, mission_type: int = 0, system: int = 1) -> Any:
    return mavlink.MAVLink_mission_item_int_message(system, 1, *item, mission_type=mission_type)


class Ground:
    """A ground station in direct reach of one rover, on a virtual clock."""

    def __init__(self, rover: Rover, now_s: float = START_S) -> None:
        self.rover = rover
        self.now_s = now_s
        self.heard: list[Any] = []

    def take(self) -> list[Any]:
        """Return what the rover says now, as it arrives."""
        outbox, self.rover.outbox = self.rover.outbox, []
        arrived = [from_ground(message, (self.rover.system_id, 1)) for _, message in outbox]
        self.heard += arrived
        return arrived

    def send(self, message: Any, ground: tuple[int, int] = GROUND) -> list[Any]:
        """Send a message and return what the rover says then."""
        self.rover.receive(from_ground(message, ground), "ground", self.now_s)
        return self.take()

    def wait(self, duration_s: float, step_s: float = 0.1) -> list[Any]:
        """Let time pass; return what was said."""
        end_s = self.now_s + duration_s
        said = []
        while self.now_s < end_s - 1e-9:
            self.now_s = min(end_s, self.now_s + step_s)
            self.rover.step(self.now_s)
            said += self.take()
        return said

    def command(self, command: int, *params: float) -> int:
        """Send COMMAND_LONG and return the result of its acknowledgement."""
        padded = [*params, *[0.0] * (7 - len(params))]
        answers = self.send(
            mavlink.MAVLink_command_long_message(self.rover.system_id, 1, command, 0, *padded)
        )
        return int(next(m for m in answers if m.get_type() == "COMMAND_ACK" and m.command == command).result)

    def upload(self, items: list[MissionItem], mission_type: int = 0) -> int:
        """Upload over a perfect link; return the MAV_MISSION_RESULT."""
        said = self.send(
            mavlink.MAVLink_mission_count_message(self.rover.system_id, 1, len(items), mission_type)
        )
        while not (acks := of(said, "MISSION_ACK")):
            said = self.send(item_int(items[of(said, "MISSION_REQUEST")[-1].seq], mission_type))
        return int(acks[-1].type)

    def download(self) -> list[Any]:
        """Download over a perfect link."""
        (count,) = of(self.send(mavlink.MAVLink_mission_request_list_message(1, 1)), "MISSION_COUNT")
        return [
            of(self.send(mavlink.MAVLink_mission_request_int_message(1, 1, seq)), "MISSION_ITEM_INT")[0]
            for seq in range(count.count)
        ]

    def acknowledge(self, number: int, system_id: int = 1) -> None:
        self.send(mavlink.MAVLink_named_value_int_message(0, ack_name(system_id).encode(), number))

    def start(self, items: list[MissionItem]) -> None:
        """Upload, wait until ready, arm and enter AUTO."""
        assert self.upload(numbered(self.rover.world, items)) == mavlink.MAV_MISSION_ACCEPTED
        self.wait(6.0)
        assert self.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1.0) == mavlink.MAV_RESULT_ACCEPTED
        assert self.mode(mavlink.ROVER_MODE_AUTO) == mavlink.MAV_RESULT_ACCEPTED
        self.heard.clear()

    def mode(self, mode: int) -> int:
        return self.command(mavlink.MAV_CMD_DO_SET_MODE, 1.0, float(mode))

    def reports(self) -> list[PayloadReport]:
        """Return every confirmation heard since the start, repeats as well."""
        found = [parse_confirmation(m.text) for m in of(self.heard, "STATUSTEXT")]
        return [report for report in found if report is not None]

    def texts(self) -> list[str]:
        return [m.text for m in of(self.heard, "STATUSTEXT") if parse_confirmation(m.text) is None]


def of(messages: list[Any], kind: str) -> list[Any]:
    return [message for message in messages if message.get_type() == kind]


def ground_for(
    mission: Mission, robot_id: str = "scout", world: World | None = None, config: RoverConfig | None = None
) -> Ground:
    return Ground(Rover(robot_id, world or World(mission), 1, START_S, config))
