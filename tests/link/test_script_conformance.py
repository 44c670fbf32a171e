"""The Lua script on a vehicle and the simulated rover's payload say the same of the same missions.

Whatever the order of the items, the acknowledgements and the holds. What cannot be the same is left out: a
script does not see the site, so items ask for what can be done where the rover stands, but for containers
that are not there; and readings are only the simulation's.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from hypothesis import given, settings
from hypothesis import strategies as st
from lua_cases import Scripted
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from malipp_field.mission import Mission, parse_mission
from malipp_field.sim import Rover, World
from malipp_field.vehicle.items import MAV_CMD_NAV_SCRIPT_TIME, MissionItem, item_at, item_without_place
from malipp_field.vehicle.layout import ACTION_CODES
from malipp_field.vehicle.payload_protocol import ack_name
from malipp_field.vehicle.steps import Action

HOLD, AUTO = mavlink.ROVER_MODE_HOLD, mavlink.ROVER_MODE_AUTO
START_S = 1_700_000_000.0
LYING = (1, 2)
"""Tags of the containers that a teammate has left; nobody has left 3 and 4, and 5 to 7 are to be filled."""
ROUND_S = 1.3
"""Long enough for an action, and for all that is unheard to be said at least once."""

SITE = """
format: malipp-mission/1
name: one
site:
  origin: {lat_deg: 34.0219, lon_deg: -118.2870, alt_m: 60.0}
  nodes:
    - {id: base, x_m: 0.0, y_m: 0.0, role: depot}
    - {id: a, x_m: 20.0, y_m: 0.0}
  complete: true
field:
  kernel: {family: rbf, length_scale_m: 30.0, variance: 2.0}
  test_points: [{x_m: 50.0, y_m: 20.0}]
team:
  sample_mass_kg: 1.0
  service_time_s: 0.0
  robots:
    - {id: scout, start: a, depots: [base], empty_mass_kg: 15.0, energy_budget_j: 60000.0,
       payload_capacity: 2, samples_per_node: 2, noise_variance: 0.01, energy_per_kg_m: 3.0, speed_m_s: 2.0}
    - {id: mate, start: a, depots: [base], empty_mass_kg: 15.0, energy_budget_j: 60000.0,
       payload_capacity: 9, samples_per_node: 9, noise_variance: 0.01, energy_per_kg_m: 3.0, speed_m_s: 2.0}
"""
MISSION = parse_mission(SITE)


@dataclass(frozen=True)
class Ask:
    """One item, where it is asked for, and what share of the confirmations so far is heard after it.

    With ``anew`` it is the first of another run, which gives the tags to other containers.
    """

    action: Action
    tag: int
    node: str
    go_on: bool
    heard: float
    anew: bool


ASKS = st.lists(
    st.builds(
        Ask,
        st.sampled_from([Action.COLLECT, Action.DROP, Action.PICK, Action.UNLOAD]),
        st.integers(0, 7),
        st.sampled_from(["a", "a", "base"]),
        st.booleans(),
        st.sampled_from([0.0, 0.4, 1.0]),
        st.sampled_from([False] * 4 + [True]),
    ),
    min_size=1,
    max_size=10,
)


class Simulated:
    """The simulated rover, carried from place to place."""

    def __init__(self, mission: Mission) -> None:
        self.world = World(mission)
        place = self.world.places["a"]
        for tag in LYING:
            self.world.act("mate", Action.COLLECT, tag, place)
            self.world.act("mate", Action.DROP, tag, place)
        self.rover = Rover("scout", self.world, 7, START_S)
        self.now_s = START_S
        self.run(10.0)
        assert self.rover.autopilot.arm()
        self.run(0.1)
        self.take()

    def run(self, seconds: float) -> None:
        end_s = self.now_s + seconds
        while self.now_s < end_s - 1e-9:
            self.now_s += 0.1
            self.rover.step(self.now_s)

    def take(self) -> list[str]:
        said = [message for _, message in self.rover.outbox if message.get_type() == "STATUSTEXT"]
        self.rover.outbox.clear()
        return [re.sub(r" v=\S+$", "", message.text) for message in said]

    def ask(self, item: MissionItem, node: str) -> None:
        """Let the mission come to that item; one to stay at follows it."""
        pilot = self.rover.autopilot
        pilot.position = self.world.places[node]
        lat_deg, lon_deg = self.world.globe(pilot.position)
        stay = item_at(2, mavlink.MAV_CMD_NAV_LOITER_UNLIM, lat_deg, lon_deg)
        pilot.store.items[:] = [pilot.home_item(), item._replace(seq=1), stay]
        pilot.set_mode(HOLD)
        pilot.set_current(1, reset=False)
        assert pilot.set_mode(AUTO)

    def acknowledge(self, number: int) -> None:
        message = mavlink.MAVLink_named_value_int_message(0, ack_name(7).encode(), number)
        message.pack(mavlink.MAVLink(None, srcSystem=255, srcComponent=190))
        message.name = ack_name(7)  # as it arrives
        self.rover.receive(message, "ground", self.now_s)

    @property
    def mode(self) -> int:
        return self.rover.autopilot.mode


def script_on_a_vehicle() -> Scripted:
    outputs = {
        f"{word}_{what}": value
        for word in ("COL", "DRP", "PIK", "UNL")
        for what, value in {"TYPE": 2, "NUM": 0, "ON": 1, "OFF": 0, "TIME": 0.2}.items()
    }
    vehicle = Scripted("S.relays[0] = true; S.pins[50] = true", CAP=2, SW_PIN=50, SW_ON=1, **outputs)
    vehicle.run(1.0)
    vehicle.take()
    return vehicle


def lies_there(ask: Ask, world: World) -> bool:
    """Tell whether a container is found: one so labelled, or where there is no such label one without."""
    labels = {ask.tag} if ask.tag in world.containers else {tag for tag in world.containers if tag < 0}
    return any(world.caches().get(label) == world.places[ask.node] for label in labels)


def differs_by_nature(ask: Ask, world: World, put_down: set[int], taken: set[int]) -> bool:
    """Tell what a script cannot know: it must try before it finds that a container is not there."""
    if ask.action is Action.PICK:
        absent = not lies_there(ask, world) and ask.tag not in world.on_board("scout")
        return ask.tag in put_down or (absent and len(world.on_board("scout")) == 2)
    if ask.action is Action.COLLECT:
        labelled_as_it_was_put_down = ask.tag in put_down - taken
        return ask.tag in LYING or ask.node != "a" or labelled_as_it_was_put_down
    return ask.action is Action.UNLOAD and ask.node != "base"


@settings(max_examples=40, deadline=None)
@given(asks=ASKS, run=st.sampled_from([0, 16000]))
def test_the_script_and_the_simulated_payload_say_the_same(asks: list[Ask], run: int) -> None:
    simulated, scripted = Simulated(MISSION), script_on_a_vehicle()
    world = simulated.world
    given_so_far = 0
    put_down: set[int] = set()
    taken: set[int] = set()
    for ask in asks:
        if ask.anew:
            run += 1
            world.begin_run(run)  # before the script comes to it, since what lies there is looked at
            put_down, taken = set(), set()
        if differs_by_nature(ask, world, put_down, taken):
            continue
        if ask.action in (Action.COLLECT, Action.PICK):
            taken.add(ask.tag)
        else:
            put_down.add(ask.tag)
        y = 2 * run + ask.go_on
        code = ACTION_CODES[ask.action]
        seen = ask.action is not Action.PICK or lies_there(ask, world)
        scripted.set(f"S.pins[50] = {str(seen).lower()}; S.place = {{ {world.places[ask.node][0]}, 0.0 }}")
        simulated.ask(
            item_without_place(0, MAV_CMD_NAV_SCRIPT_TIME, code, 0.0, 1.0, 1.0, x=ask.tag, y=y),
            ask.node,
        )
        scripted.ask(code, ask.tag, y)
        texts = said_within(ROUND_S, simulated, scripted)
        assert texts[0] == texts[1]
        assert (simulated.mode == HOLD) == (scripted.mode == HOLD)
        given_so_far = max([given_so_far, *(int(text.split()[1]) for text in texts[0] if text[:3] == "MLP")])
        for vehicle in (simulated, scripted):
            vehicle.acknowledge(round(ask.heard * given_so_far))
        repeated = said_within(ROUND_S, simulated, scripted)
        assert repeated[0] == repeated[1]
    assert len(world.on_board("scout")) == scripted.parameter("ABOARD")


def said_within(seconds: float, *vehicles: Simulated | Scripted) -> list[set[str]]:
    """Let time pass for each; return what each says in it, however often."""
    for vehicle in vehicles:
        vehicle.run(seconds)
    return [{text for text in vehicle.take() if text[:7] != "Reached"} for vehicle in vehicles]
