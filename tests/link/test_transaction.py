"""New missions for a whole team or for nobody, whatever goes wrong with one vehicle of it."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from contextlib import AsyncExitStack
from typing import Any, TypeVar

import pytest
from link_cases import STEP_S, Wire, framed, from_ground
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from malipp_field.clock import SimClock
from malipp_field.link.compare import differences
from malipp_field.link.contact import Contact
from malipp_field.link.exchange import MavMessage
from malipp_field.link.mission_protocol import MissionType
from malipp_field.link.transaction import Member, Transaction
from malipp_field.mission import parse_mission
from malipp_field.sim import Rover, World
from malipp_field.vehicle.fence import fence_items, rally_items
from malipp_field.vehicle.items import MissionItem, item_at

TEAM = parse_mission(
    """
format: malipp-mission/1
name: team
site:
  origin: {lat_deg: 34.0219, lon_deg: -118.2870, alt_m: 60.0}
  nodes:
    - {id: base, x_m: 0.0, y_m: 0.0, role: depot}
    - {id: a, x_m: 500.0, y_m: 0.0}
  edges: [{from: base, to: a}]
  keep_outs: [{id: sump, polygon: [{x_m: 20.0, y_m: 5.0}, {x_m: 30.0, y_m: 5.0}, {x_m: 25.0, y_m: 12.0}]}]
field:
  kernel: {family: rbf, length_scale_m: 30.0}
  test_points: [{x_m: 50.0, y_m: 20.0}]
team:
  sample_mass_kg: 1.0
  robots:
"""
    + "".join(
        f"    - {{id: {name}, start: base, depots: [base], empty_mass_kg: 15.0, energy_budget_j: 600000.0,"
        " payload_capacity: 4, samples_per_node: 2, noise_variance: 0.01, energy_per_kg_m: 3.0,"
        " speed_m_s: 1.0}\n"
        for name in ("scout", "carrier", "spare")
    )
)
ROBOTS = ("scout", "carrier", "spare")
MISSION, FENCE, RALLY = MissionType
OLD_LENGTH, NEW_LENGTH = 7, 5

ResultT = TypeVar("ResultT")


def way(count: int, shift: int) -> list[MissionItem]:
    """A mission of waypoints, home first."""
    items = [item_at(n, 16, 34.0219 + 1e-4 * (n + shift), -118.2870) for n in range(count)]
    return [items[0]._replace(frame=0), *items[1:]]


OLD, NEW = way(OLD_LENGTH, 0), way(NEW_LENGTH, 50)


class Radio:
    """One rover, the wires to it, and the contact at our end."""

    def __init__(
        self, robot: str, system: int, clock: SimClock, world: World, seed: int, loss: float
    ) -> None:
        self.clock, self.system = clock, system
        self.rover = Rover(robot, world, system, clock.now_s())
        self.up, self.down = Wire(seed, loss, loss > 0.0), Wire(seed + 1_000_000, loss, loss > 0.0)
        self.cut = False
        self.uplinks = 0
        self.cut_at: int | None = None
        self.contact = Contact((system, 1), self._open, clock)
        self.rover.autopilot.store.items = list(OLD)

    async def _open(self, on_message: Callable[[MavMessage], None]) -> Radio:
        self._on_message = on_message
        return self

    def send(self, message: MavMessage) -> None:
        if message.get_type().startswith(("MISSION_", "COMMAND_")):
            self.cut = self.cut or self.uplinks == self.cut_at
            self.uplinks += 1
        if not self.cut:
            self.up.put(from_ground(message), self.clock.now_s())

    def close(self) -> None:
        self.cut = True

    def carry(self, now_s: float) -> None:
        for message in self.up.arrived(now_s):
            self.rover.receive(message, "ground", now_s)
        self.rover.step(now_s)
        outbox, self.rover.outbox = self.rover.outbox, []
        for peer, message in outbox:
            if not self.cut and peer in (None, "ground"):
                self.down.put(framed(message, self.system), now_s)
        for message in self.down.arrived(now_s):
            self._on_message(message)

    def aboard(self) -> str:
        store = self.rover.autopilot.store
        if store.receiving:
            return "half"
        return next(
            (name for name, each in (("old", OLD), ("new", NEW)) if not differences(each, store.items)), "?"
        )


class Field:
    """Three rovers, each by a link of its own."""

    def __init__(self, seed: int = 0, loss: float = 0.0) -> None:
        self.clock = SimClock(1e9)
        world = World(TEAM)
        self.radios = {
            robot: Radio(robot, system, self.clock, world, seed + system, loss)
            for system, robot in enumerate(ROBOTS, start=1)
        }
        self.said: list[tuple[str, str]] = []

    def run(self, scene: Callable[[Field], Coroutine[Any, Any, ResultT]]) -> ResultT:
        async def whole() -> ResultT:
            async with AsyncExitStack() as stack:
                for radio in self.radios.values():
                    await stack.enter_async_context(radio.contact)
                await self.live(8.0)
                return await scene(self)

        return asyncio.run(whole())

    async def live(self, duration_s: float = STEP_S) -> None:
        end_s = self.clock.now_s() + duration_s
        while self.clock.now_s() < end_s - 1e-6:
            self.clock.advance(STEP_S)
            for radio in self.radios.values():
                radio.carry(self.clock.now_s())
            for _ in range(8):
                await asyncio.sleep(0)

    def members(self, wanted: dict[MissionType, list[MissionItem]] | None = None) -> list[Member]:
        return [
            Member(robot, radio.contact.driver, wanted or {MISSION: NEW})
            for robot, radio in self.radios.items()
        ]

    def transaction(
        self, *, hold: bool = False, wanted: dict[MissionType, list[MissionItem]] | None = None
    ) -> Transaction:
        return Transaction(
            self.members(wanted), hold=hold, on_progress=lambda *words: self.said.append(words)
        )

    async def finish(self, task: asyncio.Task[Any], limit_s: float = 600.0) -> None:
        end_s = self.clock.now_s() + limit_s
        while not task.done():
            assert self.clock.now_s() < end_s, "it does not end"
            await self.live()

    async def carry_out(self, transaction: Transaction) -> bool:
        task = asyncio.create_task(transaction.run())
        await self.finish(task)
        return task.result()

    @property
    def aboard(self) -> list[str]:
        return [radio.aboard() for radio in self.radios.values()]

    def check(self, transaction: Transaction) -> None:
        """What is said of each vehicle is so, and none drives."""
        for member in transaction.members:
            radio = self.radios[member.robot]
            if member.state != "unknown":
                assert radio.aboard() == {"had": "old", "wanted": "new"}[member.state], member.words
            autopilot = radio.rover.autopilot
            assert not (autopilot.armed and autopilot.mode == mavlink.ROVER_MODE_AUTO)


@pytest.mark.parametrize("loss", [0.0, 0.1, 0.25])
def test_all_get_theirs_and_it_is_told_how_far_it_is(loss: float) -> None:
    async def scene(field: Field) -> None:
        transaction = field.transaction()
        assert await field.carry_out(transaction), [member.words for member in transaction.members]
        assert field.aboard == ["new"] * 3
        if not loss:
            assert {radio.uplinks for radio in field.radios.values()} == {MESSAGES}
        assert {member.words for member in transaction.members} == {
            "has its new mission, read back and compared"
        }
        assert ("carrier", f"mission upload {NEW_LENGTH}/{NEW_LENGTH}") in field.said
        assert ("spare", f"mission read back {NEW_LENGTH}/{NEW_LENGTH}") in field.said

    Field(seed=3, loss=loss).run(scene)


def test_fence_and_rally_points_go_with_the_mission() -> None:
    async def scene(field: Field) -> None:
        assert TEAM.site.origin is not None
        fence, rally = fence_items(TEAM, TEAM.site.origin), rally_items(TEAM, TEAM.site.origin, "scout")
        assert await field.carry_out(field.transaction(wanted={MISSION: NEW, FENCE: fence, RALLY: rally}))
        for radio in field.radios.values():
            stores = radio.rover._stores
            assert differences(fence, stores[FENCE].items, home=False) == []
            assert differences(rally, stores[RALLY].items, home=False) == []
        assert field.aboard == ["new"] * 3

    Field().run(scene)


def test_what_is_there_already_is_not_sent_again() -> None:
    async def scene(field: Field) -> None:
        assert await field.carry_out(field.transaction())
        field.said.clear()
        assert await field.carry_out(field.transaction())
        assert not [words for _, words in field.said if "upload" in words]

    Field().run(scene)


def test_a_vehicle_that_had_got_further_begins_anew() -> None:
    async def scene(field: Field) -> None:
        run = field.radios["scout"].rover.autopilot.run
        run.set_current(4)
        assert await field.carry_out(field.transaction())
        assert run.seq == 1

    Field().run(scene)


@pytest.mark.parametrize("hold", [False, True])
def test_a_vehicle_that_drives_is_refused_or_held(hold: bool) -> None:
    async def scene(field: Field) -> None:
        autopilot = field.radios["carrier"].rover.autopilot
        assert autopilot.arm()
        assert autopilot.set_mode(mavlink.ROVER_MODE_AUTO)
        await field.live(2.0)
        transaction = field.transaction(hold=hold)
        assert await field.carry_out(transaction) is hold
        assert field.aboard == ["new" if hold else "old"] * 3
        if hold:
            field.check(transaction)
        else:
            assert autopilot.mode == mavlink.ROVER_MODE_AUTO  # not ours to stop
            assert "it is in AUTO, where it may drive" in transaction.members[1].words

    Field().run(scene)


@pytest.mark.parametrize(
    ("ahead_s", "words"),
    [(-3600.0, "its clock is 3600 s behind this computer's"), (None, "does not know the time of day")],
)
def test_gates_by_time_are_only_sent_where_all_clocks_agree(ahead_s: float | None, words: str) -> None:
    """One clock that is wrong, and nobody is stopped or given anything."""

    async def scene(field: Field) -> None:
        driving = field.radios["scout"].rover.autopilot
        assert driving.arm()
        assert driving.set_mode(mavlink.ROVER_MODE_AUTO)
        field.radios["carrier"].rover._telemetry._builders[mavlink.MAVLINK_MSG_ID_SYSTEM_TIME] = (
            lambda now_s: mavlink.MAVLink_system_time_message(
                0 if ahead_s is None else int((now_s + ahead_s) * 1e6), 0
            )
        )
        await field.live(3.0)
        sent = {robot: radio.uplinks for robot, radio in field.radios.items()}
        transaction = field.transaction(hold=True)
        for member in transaction.members:
            member.keeps_time = True
        assert not await field.carry_out(transaction)
        assert words in transaction.members[1].words
        assert {robot: radio.uplinks for robot, radio in field.radios.items()} == sent
        assert driving.mode == mavlink.ROVER_MODE_AUTO
        assert {member.words for member in transaction.members[::2]} == {"has what it had"}

    Field().run(scene)


@pytest.mark.parametrize("seq", [1, 4])
def test_one_refusal_puts_all_back_on_what_they_had(seq: int) -> None:
    async def scene(field: Field) -> None:
        store = field.radios["carrier"].rover.autopilot.store
        honest = store.receive

        def receive(message: Any, sender: Any, now_s: float) -> list[Any]:
            if message.get_type() == "MISSION_ITEM_INT" and message.seq == seq and message.x == NEW[seq].x:
                message.param1 = float("nan")
            return honest(message, sender, now_s)

        store.receive = receive  # type: ignore[method-assign]
        field.radios["scout"].rover.autopilot.run.set_current(4)
        transaction = field.transaction()
        assert not await field.carry_out(transaction)
        assert field.aboard == ["old"] * 3
        assert field.radios["scout"].rover.autopilot.run.seq == 4
        field.check(transaction)
        words = [member.words for member in transaction.members]
        assert words[0] == words[2] == "has what it had"
        assert words[1].startswith(
            f"has what it had (item {seq} (NAV_WAYPOINT) was refused (MAV_MISSION_INVALID"
        )

    Field().run(scene)


def test_a_full_store_leaves_all_as_they_were() -> None:
    async def scene(field: Field) -> None:
        field.radios["spare"].rover.autopilot.store.max_items = 4
        transaction = field.transaction()
        assert not await field.carry_out(transaction)
        assert field.aboard[:2] == ["old", "old"]
        assert "MAV_MISSION_NO_SPACE" in transaction.members[2].words

    Field().run(scene)


MESSAGES = 22
"""Of the ground to one vehicle on a good link: snapshot, upload and read-back."""


@pytest.mark.parametrize("cut_at", range(MESSAGES - 1))
def test_a_link_cut_at_any_message(cut_at: int) -> None:
    """One of three is lost; the others get back what they had. What is said of the one is so."""

    async def scene(field: Field) -> None:
        radio = field.radios["carrier"]
        radio.cut_at = cut_at
        transaction = field.transaction()
        assert not await field.carry_out(transaction)
        field.check(transaction)
        assert [field.aboard[0], field.aboard[2]] == ["old", "old"]
        lost = transaction.members[1]
        assert any(words in lost.fault for words in ("does not answer", "not heard", "does not report"))
        if lost.state == "unknown":
            assert "is not known; as far as is known it stands; do not start it" in lost.words

    Field().run(scene)


@pytest.mark.parametrize("after_s", [0.0, 0.3, 0.7, 0.9, 1.1, 1.3, 1.6, 2.2])
def test_broken_off_it_gives_back_what_it_touched(after_s: float) -> None:
    async def scene(field: Field) -> None:
        transaction = field.transaction()
        task = asyncio.create_task(transaction.run())
        await field.live(after_s)
        if task.done():
            assert after_s > 2.0
            return
        task.cancel()
        await field.finish(task)
        assert task.cancelled()
        field.check(transaction)
        assert field.aboard == ["old"] * 3
        assert {member.state for member in transaction.members} == {"had"}

    Field().run(scene)


def test_broken_off_twice_it_says_of_whom_nothing_is_known() -> None:
    async def scene(field: Field) -> None:
        transaction = field.transaction()
        task = asyncio.create_task(transaction.run())
        while not any(member.state == "unknown" for member in transaction.members):
            await field.live()
        await field.live(0.2)
        for _ in range(2):
            task.cancel()
            await field.live(0.1)
        assert task.cancelled()
        field.check(transaction)
        assert {member.state for member in transaction.members} == {"unknown"}

    Field().run(scene)


@pytest.mark.parametrize("robot", ROBOTS)
def test_a_restart_in_the_middle(robot: str) -> None:
    async def scene(field: Field) -> None:
        radio = field.radios[robot]
        transaction = field.transaction()
        task = asyncio.create_task(transaction.run())
        while not radio.rover.autopilot.store.receiving:
            await field.live()
        radio.rover.reboot(field.clock.now_s())
        await field.finish(task)
        field.check(transaction)
        assert field.aboard in (["new"] * 3, ["old"] * 3)

    Field().run(scene)


def test_another_station_on_one_vehicle_delays_all() -> None:
    async def scene(field: Field) -> None:
        stranger = framed(mavlink.MAVLink_mission_count_message(2, 1, OLD_LENGTH), 245, 190)
        field.radios["carrier"].rover.receive(stranger, "stranger", field.clock.now_s())
        transaction = field.transaction()
        assert await field.carry_out(transaction), [member.words for member in transaction.members]
        field.check(transaction)

    Field().run(scene)
