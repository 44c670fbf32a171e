"""`malipp upload` and `malipp vehicles` with simulated rovers on this machine, on the real clock."""

from __future__ import annotations

import asyncio
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from malipp_field.cli.app import main
from malipp_field.clock import WallClock
from malipp_field.mission import parse_mission, read_mission
from malipp_field.plan import Plan, write_plan
from malipp_field.planner import solve
from malipp_field.sim import Fleet, RoverConfig
from malipp_field.sim.rover import Rover

ROOT = Path(__file__).parents[2]
TEXT = """
format: malipp-mission/1
name: yard
site:
  origin: {lat_deg: 34.0219, lon_deg: -118.2870, alt_m: 60.0}
  nodes:
    - {id: base, x_m: 0.0, y_m: 0.0, role: depot}
    - {id: a, x_m: 40.0, y_m: 0.0}
    - {id: b, x_m: 40.0, y_m: 30.0}
  complete: true
  fence: [{x_m: -5.0, y_m: -5.0}, {x_m: 60.0, y_m: -5.0}, {x_m: 60.0, y_m: 50.0}, {x_m: -5.0, y_m: 50.0}]
field:
  kernel: {family: rbf, length_scale_m: 30.0, variance: 2.0}
  test_points: [{x_m: 50.0, y_m: 20.0}]
team:
  sample_mass_kg: 1.0
  robots:
    - {id: scout, start: base, depots: [base], empty_mass_kg: 15.0, energy_budget_j: 6000.0,
       payload_capacity: 2, samples_per_node: 1, noise_variance: 0.01, energy_per_kg_m: 3.0, speed_m_s: 1.0}
    - {id: mule, start: base, depots: [base], empty_mass_kg: 15.0, energy_budget_j: 6000.0,
       payload_capacity: 2, samples_per_node: 1, noise_variance: 0.02, energy_per_kg_m: 3.0, speed_m_s: 1.0}
"""


@pytest.fixture(scope="module")
def plan() -> Plan:
    return solve(parse_mission(TEXT), method="seq")


@pytest.fixture
def files(tmp_path: Path, plan: Plan) -> tuple[Path, Path]:
    mission_file, plan_file = tmp_path / "yard.yaml", tmp_path / "plan.json"
    mission_file.write_text(TEXT, encoding="utf-8")
    write_plan(plan, plan_file)
    return mission_file, plan_file


@contextmanager
def rovers(mission_file: Path) -> Iterator[tuple[dict[str, Rover], list[str]]]:
    """Simulated rovers in a thread of their own, and the options that name their links."""
    started, over = threading.Event(), threading.Event()
    fleets: list[Fleet] = []

    async def live() -> None:
        ready = RoverConfig(ready_after_s=0.0)
        async with Fleet(read_mission(mission_file), WallClock(), config=ready) as fleet:
            fleets.append(fleet)
            started.set()
            await asyncio.to_thread(over.wait)

    thread = threading.Thread(target=lambda: asyncio.run(live()))
    thread.start()
    try:
        assert started.wait(30.0)
        links = [
            word
            for robot, (host, port) in fleets[0].endpoints.items()
            for word in ("--link", f"{robot}=udpout:{host}:{port}")
        ]
        yield fleets[0].rovers, links
    finally:
        over.set()
        thread.join()


def status(*arguments: str | Path) -> int:
    with pytest.raises(SystemExit) as ended:
        main([str(argument) for argument in arguments])
    return int(ended.value.code or 0)


def test_all_get_their_missions_and_it_is_seen(
    files: tuple[Path, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    with rovers(files[0]) as (fleet, links):
        assert status("vehicles", files[0], "--plan", files[1], *links) == 6
        assert "no mission: not the plan" in capsys.readouterr().out
        assert status("upload", *files, *links) == 0
        said = capsys.readouterr().out
        assert "scout: has its new mission, read back and compared" in said
        assert "mule: has its new mission, read back and compared" in said
        for rover in fleet.values():
            assert [len(store.items) for store in rover._stores.values()][1:] == [4, 1]
            assert len(rover.autopilot.store.items) > 2
            assert not rover.autopilot.armed
        assert status("vehicles", files[0], "--plan", files[1], *links) == 0
        assert "those of the plan" in capsys.readouterr().out


def test_one_that_refuses_keeps_all_from_theirs(
    files: tuple[Path, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    with rovers(files[0]) as (fleet, links):
        fleet["mule"].autopilot.store.max_items = 2
        assert status("upload", *files, *links) == 6
        said = capsys.readouterr().err
        assert "scout: has what it had" in said
        assert "mule: has what it had (a mission upload of" in said
        assert "MAV_MISSION_NO_SPACE" in said
        assert [len(rover.autopilot.store.items) for rover in fleet.values()] == [0, 0]


@pytest.fixture
def timed(tmp_path: Path) -> tuple[Path, Path]:
    """The corridor, whose carrier opens its gates by time, and a plan of it with drops."""
    mission_file, plan_file = tmp_path / "corridor.yaml", tmp_path / "plan.json"
    text = (ROOT / "missions" / "corridor.yaml").read_text(encoding="utf-8")
    mission_file.write_text(f"{text}\nvehicles: {{carrier: {{gate: time}}}}\n", encoding="utf-8")
    plan_file.write_bytes((ROOT / "tests" / "sim" / "corridor-plan.json").read_bytes())
    return mission_file, plan_file


def utc(time_s: float) -> str:
    return datetime.fromtimestamp(time_s, UTC).isoformat()


def test_gates_by_time_go_to_vehicles_that_know_the_time(
    timed: tuple[Path, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    start = "--start", utc(WallClock().now_s() + 600.0)
    with rovers(timed[0]) as (fleet, links):
        builders = fleet["carrier"]._telemetry._builders
        honest = builders[mavlink.MAVLINK_MSG_ID_SYSTEM_TIME]
        builders[mavlink.MAVLINK_MSG_ID_SYSTEM_TIME] = lambda now_s: honest(now_s - 3600.0)
        assert status("upload", *timed, *start, *links) == 6
        said = capsys.readouterr().err
        assert "scout: has what it had\n" in said
        assert "carrier: has what it had (its clock is 3600 s behind this computer's" in said
        assert [len(rover.autopilot.store.items) for rover in fleet.values()] == [0, 0]
        builders[mavlink.MAVLINK_MSG_ID_SYSTEM_TIME] = honest
        assert status("upload", *timed, *start, *links) == 0
        gates = [item for item in fleet["carrier"].autopilot.store.items if item.param1 == 1.0 and item.y > 0]
        assert gates
        capsys.readouterr()
        assert status("vehicles", timed[0], "--plan", timed[1], *links) == 6
        assert capsys.readouterr().err == "carrier: with gates by time give the --start of the upload\n"
        assert status("vehicles", timed[0], "--plan", timed[1], *start, *links) == 0


def test_a_start_that_is_over_is_refused(
    timed: tuple[Path, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    late = "--start", utc(WallClock().now_s() - 100.0)
    assert status("upload", *timed, *late, "--dry-run") == 2
    said = capsys.readouterr().err
    assert "the gates of carrier would open before the drops; give a time to come" in said
    assert status("upload", *timed, *late, "--robot", "scout", "--dry-run") == 0, "it has no gates"
    assert status("upload", *timed, "--dry-run") == 0
    assert "carrier\n  warning no gate opens by time" in capsys.readouterr().err


def test_an_armed_vehicle_that_was_held_is_told(
    files: tuple[Path, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    with rovers(files[0]) as (fleet, links):
        assert status("upload", *files, *links) == 0
        pilot = fleet["mule"].autopilot
        capsys.readouterr()
        assert pilot.arm()
        assert pilot.set_mode(mavlink.ROVER_MODE_AUTO)
        assert status("upload", *files, "--hold", *links) == 0
        said = capsys.readouterr().out.splitlines()
        assert said == [
            "scout: has its new mission, read back and compared",
            "mule: has its new mission, read back and compared; it is armed, in HOLD",
        ]


def test_a_dry_run_sends_nothing_and_needs_no_link(
    files: tuple[Path, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    assert status("upload", *files, "--robot", "scout", "--dry-run") == 0
    assert "scout: mission (" in capsys.readouterr().out
    assert status("upload", *files, "--robot", "scout", "--dry-run", "--no-fence") == 0
    assert "fence" not in capsys.readouterr().out


def test_bad_input_is_one_line(files: tuple[Path, Path], capsys: pytest.CaptureFixture[str]) -> None:
    for options, problem in (
        ((), "'scout' has no link: give --link scout=URL"),
        (("--robot", "nobody"), "has no robot 'nobody'; there are scout, mule"),
        (("--link", "udpout:1.2.3.4:5"), "is not ROBOT=URL"),
        (("--link", "mul=udpout:1.2.3.4:5"), "has no robot 'mul'; did you mean 'mule'?"),
        (("--link", "scout=nonsense", "--robot", "scout"), "'nonsense' is not a link"),
    ):
        assert status("upload", *files, *options) == 2
        said = capsys.readouterr().err
        assert problem in said
        assert "Traceback" not in said


def test_an_abstract_site_cannot_be_sent(
    files: tuple[Path, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    text = "\n".join(line for line in TEXT.splitlines() if "origin" not in line)
    files[0].write_text(text, encoding="utf-8")
    assert status("upload", *files, "--dry-run") == 2
    assert "an abstract site has no degrees to send" in capsys.readouterr().err


def test_who_is_not_heard_is_named_with_what_to_look_at(
    files: tuple[Path, Path], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("malipp_field.link.driver.HEARTBEAT_LOST_S", 0.1)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as nobody:
        nobody.bind(("127.0.0.1", 0))
        link = f"mule=udpout:127.0.0.1:{nobody.getsockname()[1]}"
        assert status("vehicles", files[0], "--robot", "mule", "--link", link) == 6
    assert (
        capsys.readouterr().err == "not heard: mule; check that link, system_id and signing_key are right\n"
    )
