"""`malipp upload`: the missions of a plan, on all vehicles or on none; `malipp vehicles`: what is on them."""

from __future__ import annotations

import asyncio
from collections.abc import Container, Iterable, Mapping, Sequence
from contextlib import AsyncExitStack
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from malipp_field.cli.check import show_faults
from malipp_field.cli.files import MissionFile, PlanFile, known_robot, verified
from malipp_field.cli.status import NOT_DONE, UNKNOWN
from malipp_field.cli.times import StartTime
from malipp_field.errors import InputError, LinkError, PlanError

if TYPE_CHECKING:
    from malipp_field.link.contact import Contact
    from malipp_field.link.mission_protocol import MissionType
    from malipp_field.link.transaction import Member
    from malipp_field.mission import Mission
    from malipp_field.plan import Plan
    from malipp_field.vehicle.items import MissionItem
    from malipp_field.vehicle.steps import VehicleMission

    Wanted = dict[str, dict[MissionType, list[MissionItem]]]

RobotNames = Annotated[
    list[str] | None,
    typer.Option("--robot", metavar="R", help="Only this robot; may be given again. All if not given."),
]
LinkUrls = Annotated[
    list[str] | None,
    typer.Option("--link", metavar="R=URL", help="A robot's link, in place of the mission file's."),
]


def upload(
    mission_file: MissionFile,
    plan_file: PlanFile,
    robot: RobotNames = None,
    link: LinkUrls = None,
    fence: Annotated[
        bool, typer.Option("--fence/--no-fence", help="Replace fence and rally points too, or not.")
    ] = True,
    start: StartTime = None,
    hold: Annotated[bool, typer.Option("--hold", help="Stop vehicles that may be driving.")] = False,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Say what would be sent; send nothing.")] = False,
) -> None:
    """Put the missions of a plan on all its vehicles, or on none. Nothing is started.

    What `malipp check` finds is said first; with errors nothing is sent. What is on each vehicle is read
    before anything else; new missions are read back and compared. If one fails, or at Ctrl-C, all are given
    back what they had. A vehicle that may be driving is a reason not to begin.

    Exit status: 0 when all have their new missions, 2 for what you can mend, 6 when nobody has (all have what
    they had), 7 when of some vehicle it is not known.
    """
    mission, plan = verified(mission_file, plan_file)
    missions = _compiled(mission, plan, start)
    wanted = _wanted(mission, missions, _chosen(mission_file, mission, robot), fence=fence)
    keepers = [name for name in wanted if missions[name].keeps_time]
    mission = _linked(mission_file, mission, wanted, link, needed=not dry_run)
    if show_faults(mission, plan, start, fence=fence):
        raise InputError(str(plan_file), None, "", "nothing is sent: see the errors above")
    if keepers and start is not None:
        _refuse_past(start, keepers)
    if dry_run:
        for name, lists in wanted.items():
            counts = ", ".join(f"{kind.word} ({len(items)})" for kind, items in lists.items())
            typer.echo(f"{name}: {counts} by {mission.vehicle(name).link or 'no link yet'}")
        return
    states = asyncio.run(_upload(mission, mission_file.parent, wanted, keepers, hold=hold))
    if "unknown" in states:
        raise typer.Exit(UNKNOWN)
    if "had" in states:
        raise typer.Exit(NOT_DONE)


def vehicles(
    mission_file: MissionFile,
    plan_file: Annotated[
        Path | None, typer.Option("--plan", metavar="PLAN", help="Compare with the missions of this plan.")
    ] = None,
    robot: RobotNames = None,
    link: LinkUrls = None,
    start: StartTime = None,
) -> None:
    """Show which vehicles are heard, what they are doing, and which missions are on them.

    Exit status: 0 when all are heard and have the missions of the plan, if one is given; else 6.
    """
    from malipp_field.cli.display import err, out
    from malipp_field.mission import read_mission

    mission, wanted = read_mission(mission_file), None
    robots = _chosen(mission_file, mission, robot)
    if plan_file is not None:
        mission, plan = verified(mission_file, plan_file)
        wanted = _wanted(mission, _compiled(mission, plan, start), robots, fence=False)
    mission = _linked(mission_file, mission, robots, link, needed=True)
    lines = asyncio.run(_look(mission, mission_file.parent, robots, wanted))
    for name, (words, _) in lines.items():
        out.print(f"{name}: {words}", soft_wrap=True)
    timed = [name for name, (_, right) in lines.items() if not right and mission.vehicle(name).gate == "time"]
    if wanted is not None and start is None and timed:
        err.print(f"{', '.join(timed)}: with gates by time give the --start of the upload", soft_wrap=True)
    if not all(right for _, right in lines.values()):
        raise typer.Exit(NOT_DONE)


def _chosen(mission_file: Path, mission: Mission, names: Sequence[str] | None) -> list[str]:
    for name in names or ():
        known_robot(mission_file, mission, name)
    return [robot.id for robot in mission.team.robots if not names or robot.id in names]


def _compiled(mission: Mission, plan: Plan, start_s: float | None) -> dict[str, VehicleMission]:
    from malipp_field.vehicle.compile import compile_plan

    return compile_plan(mission, plan, start_s=start_s).missions


def _refuse_past(start_s: float, keepers: Iterable[str]) -> None:
    """Refuse a start that is over: a team that starts now would come to gates that have opened already."""
    from malipp_field.clock import WallClock
    from malipp_field.vehicle.check_times import utc

    if start_s < WallClock().now_s():
        raise InputError(
            "--start", None, "",
            f"{utc(start_s)} is over: the gates of {', '.join(keepers)} would open before the drops; give a "
            "time to come",
        )  # fmt: skip


def _wanted(
    mission: Mission, missions: Mapping[str, VehicleMission], robots: Sequence[str], *, fence: bool
) -> Wanted:
    """Return what every vehicle is to have. A site without a fence leaves the one that is on board."""
    from malipp_field.link.mission_protocol import MissionType
    from malipp_field.vehicle.fence import fence_items, rally_items
    from malipp_field.vehicle.layout import lay_out

    origin = mission.site.origin
    if origin is None:
        raise PlanError(
            f"mission '{mission.name}' has no site.origin: an abstract site has no degrees to send"
        )
    lists: Wanted = {}
    for name in robots:
        lists[name] = {MissionType.MISSION: lay_out(missions[name]).items}
        if fence:
            corners = fence_items(mission, origin)
            lists[name] |= {MissionType.FENCE: corners} if corners else {}
            lists[name] |= {MissionType.RALLY: rally_items(mission, origin, name)}
    return lists


def _linked(
    mission_file: Path, mission: Mission, robots: Iterable[str], given: Sequence[str] | None, *, needed: bool
) -> Mission:
    """Return the mission with the links of the command line in place of its own."""
    from malipp_field.mission.link_url import parse_link_url

    vehicles = dict(mission.vehicles)
    for each in given or ():
        name, is_one, url = each.partition("=")
        if not is_one:
            raise InputError("--link", None, "", f"'{each}' is not ROBOT=URL")
        known_robot(mission_file, mission, name)
        try:
            parse_link_url(url)
        except ValueError as fault:
            raise InputError("--link", None, "", f"{name}: {fault}") from None
        vehicles[name] = mission.vehicle(name).model_copy(update={"link": url})
    for name in robots:
        if needed and (name not in vehicles or vehicles[name].link is None):
            raise InputError(
                "--link", None, "", f"'{name}' has no link: give --link {name}=URL, or vehicles.{name}.link"
            )
    return mission.model_copy(update={"vehicles": vehicles})


async def _upload(
    mission: Mission, folder: Path, wanted: Wanted, keepers: Container[str], *, hold: bool
) -> list[str]:
    from malipp_field.cli.display import ProgressLine, err, out
    from malipp_field.link.transaction import Member, Transaction

    doing: dict[str, str] = {}
    async with AsyncExitStack() as stack:
        contacts = await _contacts(stack, mission, folder, wanted)
        members = [
            Member(name, contacts[name].driver, lists, keeps_time=name in keepers)
            for name, lists in wanted.items()
        ]
        try:
            with ProgressLine("uploading") as line:

                def tell(name: str, words: str) -> None:
                    doing[name] = words
                    line.show("; ".join(f"{each} {what}" for each, what in doing.items()))

                await Transaction(members, hold=hold, on_progress=tell).run()
        finally:  # after Ctrl-C as well
            for member in members:
                (out if member.state == "wanted" else err).print(
                    f"{member.robot}: {member.words}{_armed(member)}", soft_wrap=True
                )
                for warning in member.warnings:
                    err.print(f"{member.robot}: warning: {warning}", soft_wrap=True)
            _say_why_unheard(contacts)
    return [member.state for member in members]


def _armed(member: Member) -> str:
    """Return what to know of a vehicle that would set off when somebody sets it to AUTO."""
    vehicle = member.driver.vehicle
    return f"; it is armed, in {vehicle.mode}" if vehicle.armed and member.state != "unknown" else ""


async def _look(
    mission: Mission, folder: Path, robots: Sequence[str], wanted: Wanted | None
) -> dict[str, tuple[str, bool]]:
    """Return what each vehicle is doing and has on board, in words, and whether that is as wanted."""
    async with AsyncExitStack() as stack:
        contacts = await _contacts(stack, mission, folder, robots, only_looks=True)
        async with asyncio.TaskGroup() as group:
            looks = {
                name: group.create_task(_look_at(contact, None if wanted is None else wanted[name]))
                for name, contact in contacts.items()
            }
        _say_why_unheard(contacts)
    return {name: look.result() for name, look in looks.items()}


def _say_why_unheard(contacts: dict[str, Contact]) -> None:
    from malipp_field.cli.display import err

    silent = [name for name, contact in contacts.items() if contact.driver.vehicle.heartbeats == 0]
    if silent:
        err.print(
            f"not heard: {', '.join(silent)}; check that link, system_id and signing_key are right",
            soft_wrap=True,
        )


async def _look_at(contact: Contact, wanted: dict[MissionType, list[MissionItem]] | None) -> tuple[str, bool]:
    from malipp_field.link.compare import differences
    from malipp_field.link.mission_protocol import MissionType

    driver = contact.driver
    try:
        await driver.hear()
        there = await driver.download()
    except LinkError as fault:
        return str(fault), False
    state = f"{driver.vehicle.mode}, {'armed' if driver.vehicle.armed else 'disarmed'}"
    count = max(0, len(there) - 1)
    words = f"{state}, {count} mission items after home" if count else f"{state}, no mission"
    if wanted is None:
        return words, True
    found = differences(wanted[MissionType.MISSION], there)
    return f"{words}: {'not the plan: ' + found[0] if found else 'those of the plan'}", not found


async def _contacts(
    stack: AsyncExitStack, mission: Mission, folder: Path, robots: Iterable[str], *, only_looks: bool = False
) -> dict[str, Contact]:
    """Open the links of robots for as long as the stack lasts, and return who is at their ends."""
    from malipp_field.cli.display import err
    from malipp_field.clock import WallClock
    from malipp_field.link import KeyRing, Links, vehicle_link
    from malipp_field.link.contact import Contact

    clock = WallClock()
    keys = stack.enter_context(KeyRing())
    links = await stack.enter_async_context(Links(clock))
    contacts = {}
    for name in robots:
        where = vehicle_link(mission, name, folder, keys)

        def tell(_severity: str, text: str, name: str = name) -> None:
            err.print(f"{name}: {text}", soft_wrap=True)

        address, channel = (where.system_id, where.component_id), partial(links.open, where, on_event=tell)
        contact = Contact(address, channel, clock, where.own, only_looks=only_looks)
        contacts[name] = await stack.enter_async_context(contact)
    return contacts
