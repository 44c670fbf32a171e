"""`malipp key`, against simulated vehicles on UDP."""

from __future__ import annotations

import asyncio
import re
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from malipp_field.cli.app import _status, app
from malipp_field.clock import WallClock
from malipp_field.link.keys import make_key_file, read_key
from malipp_field.mission import Mission, read_mission
from malipp_field.sim import Fleet

MISSION = Path(__file__).parents[2] / "missions" / "corridor.yaml"


def status(*arguments: object) -> int:
    return _status(lambda: app([str(a) for a in arguments], prog_name="malipp", standalone_mode=False))


@contextmanager
def flying(mission: Mission, keys: dict[str, bytes]) -> Iterator[Fleet]:
    """A fleet in a thread of its own: the command has an event loop of its own, too."""
    ready, leave = threading.Event(), threading.Event()
    fleets: list[Fleet] = []

    async def live() -> None:
        async with Fleet(mission, WallClock(), keys=keys) as fleet:
            fleets.append(fleet)
            ready.set()
            await asyncio.to_thread(leave.wait)

    thread = threading.Thread(target=lambda: asyncio.run(live()))
    thread.start()
    try:
        assert ready.wait(20.0)
        yield fleets[0]
    finally:
        leave.set()
        thread.join()


def test_a_key_is_made_and_given_to_a_vehicle_which_then_wants_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, other = tmp_path / "a.key", tmp_path / "b.key"
    assert status("key", path) == 0
    make_key_file(other)
    mission = read_mission(MISSION)
    robots = [robot.id for robot in mission.team.robots]
    with flying(mission, {robots[1]: read_key(other)}) as fleet:
        how = ("--mission", MISSION, "--link")
        assert status("key", path, "--setup", robots[0], *how, fleet.links[robots[0]]) == 0
        assert status("key", path, "--setup", robots[0], *how, fleet.links[robots[0]]) == 0
        fleet.rovers[robots[1]].autopilot.armed = True
        assert status("key", other, "--setup", robots[1], *how, fleet.links[robots[1]]) == 0
    said = capsys.readouterr()
    assert re.findall(r"^\S+: (signs with the key|has had the key already)$", said.out, re.MULTILINE) == [
        "signs with the key", "has had the key already", "has had the key already",
    ]  # fmt: skip
    assert path.read_text().strip() not in said.out + said.err


def test_an_armed_vehicle_gets_no_key(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "a.key"
    make_key_file(path)
    mission = read_mission(MISSION)
    robot = mission.team.robots[0].id
    with flying(mission, {}) as fleet:
        fleet.rovers[robot].autopilot.armed = True
        assert status("key", path, "--setup", robot, "--mission", MISSION, "--link", fleet.links[robot]) == 2
    assert "is armed: it takes no signing key; disarm it first" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("more", "problem"),
    [
        (("--setup", "scout1"), "--setup ROBOT needs --mission MISSION"),
        (("--link", "tcp:h:5"), "go with --setup ROBOT"),
        (("--setup", "nobody", "--mission", MISSION), "has no robot 'nobody'; there are"),
        (("--setup", "ROBOT", "--mission", MISSION, "--link", "tcp:h"), "--link 'tcp:h' is not a link"),
        (("--setup", "ROBOT", "--mission", MISSION), "no link is given; add link: udpin:0.0.0.0:14550"),
    ],
)
def test_mistakes_are_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], more: tuple[object, ...], problem: str
) -> None:
    robot = read_mission(MISSION).team.robots[0].id
    assert status("key", tmp_path / "a.key", *(robot if a == "ROBOT" else a for a in more)) == 2
    error = capsys.readouterr().err
    assert problem in error
    assert error.count("\n") == 1
    assert not (tmp_path / "a.key").exists()


def test_an_existing_key_is_kept(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "a.key"
    assert status("key", path) == 0
    text = path.read_text()
    assert status("key", path) == 2
    assert "never overwritten" in capsys.readouterr().err
    assert path.read_text() == text
