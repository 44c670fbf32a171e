"""`malipp confirm` against a bus on which vehicles wait."""

from __future__ import annotations

import asyncio
import sys
from io import StringIO
from pathlib import Path

import pytest
import typer

from malipp_field.bus import Awaited, Bus, Command, Confirm, Reply, Telemetry, vehicle_key
from malipp_field.cli import confirm as command
from malipp_field.cli.app import main
from malipp_field.errors import LinkError
from malipp_field.mission import Mission, read_mission
from malipp_field.run import any_free_port
from malipp_field.vehicle.steps import Action

MIXED = Path(__file__).parents[2] / "missions" / "corridor-mixed.yaml"
BAG = Awaited(uid="v1/helper/1/collect/2", action=Action.COLLECT, node="l1", tag=2, since_s=10.0)
STUCK = Awaited(
    uid="v1/carrier/2/pick/1", action=Action.PICK, node="hub", tag=1, since_s=5.0, problem="missing"
)


class Terminal(StringIO):
    def isatty(self) -> bool:
        return True


def telemetry(robot: str, awaits: Awaited | None) -> Telemetry:
    return Telemetry(
        time_s=20.0, robot=robot, lat_deg=0.0, lon_deg=0.0, heading_deg=0.0, speed_m_s=0.0, mode="AUTO",
        armed=True, ready_to_arm=True, energy_used_j=0.0, mission_version=1, step_uid=None, finished=False,
        link_ok=True, awaits=awaits,
    )  # fmt: skip


def confirmed(
    robot: str | None, failed: str | None = None, value: float | None = None, ok: bool = True
) -> list[tuple[str, Confirm]]:
    """Run the command in a team of which two wait; return the words that arrived."""
    mission, words = read_mission(MIXED), []

    async def scene(mission: Mission) -> None:
        hub = any_free_port()
        async with Bus(listen=hub) as bus:
            for name in ("helper", "carrier"):

                async def answer(asked: Command, name: str = name) -> Reply:
                    assert isinstance(asked.order, Confirm)
                    words.append((name, asked.order))
                    return Reply(time_s=0.0, ok=ok, text="" if ok else "nothing waits")

                await bus.serve(vehicle_key(mission.name, name, "command"), Command, answer)

            async def speak() -> None:
                while True:
                    for name, awaits in (("helper", BAG), ("carrier", STUCK), ("scout", None)):
                        bus.publish(vehicle_key(mission.name, name, "telemetry"), telemetry(name, awaits))
                    await asyncio.sleep(0.02)

            speaker = asyncio.create_task(speak())
            try:
                await command._confirm(mission, robot, hub, failed, value)
            finally:
                speaker.cancel()

    asyncio.run(asyncio.wait_for(scene(mission), 60.0))
    return words


def test_one_robot_named_is_confirmed_unasked() -> None:
    ((name, word),) = confirmed("helper", value=0.7)
    assert (name, word) == ("helper", Confirm(uid=BAG.uid, value=0.7))
    ((name, word),) = confirmed("carrier", failed="gone")
    assert (name, word) == ("carrier", Confirm(uid=STUCK.uid, ok=False, text="gone"))


def test_without_a_terminal_what_waits_is_listed_the_longest_first(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert confirmed(None) == []
    assert capsys.readouterr().out.splitlines() == [
        "carrier: pick container 1 at hub (missing)",
        "helper: collect container 2 at l1",
    ]


def test_on_a_terminal_each_is_asked_about(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    answers = iter(["3", "n", "lid jams", "0,25"])
    prompted: list[str] = []

    def prompt(text: str, **_: object) -> str:
        prompted.append(text)
        return next(answers)

    monkeypatch.setattr(typer, "prompt", prompt)
    monkeypatch.setattr(sys, "stdin", Terminal())
    words = confirmed(None)
    assert [(name, w.ok, w.text, w.value) for name, w in words] == [
        ("carrier", False, "lid jams", None),
        ("helper", True, "", 0.25),
    ]
    assert "'3' is none of these" in capsys.readouterr().out, "a pick has no reading"
    assert ["a number" in text for text in prompted] == [False, False, False, True]


def test_what_is_not_taken_is_said() -> None:
    with pytest.raises(LinkError, match="helper: not confirmed: nothing waits"):
        confirmed("helper", ok=False)
    with pytest.raises(LinkError, match="scout waits for nobody"):
        confirmed("scout")


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (["helper"], "say where the mission's bus is: --connect ADDRESS, or MALIPP_BUS=ADDRESS beforehand"),
        (
            ["helpr", "--connect", "x"],
            f"{MIXED}: has no robot 'helpr'; did you mean 'helper'?",
        ),
        (["helper", "--connect", "x"], "'x' is no address of a bus, such as tcp/127.0.0.1:7447"),
        (["--failed", "no", "--connect", "x"], "say which ROBOT's action that is"),
    ],
)
def test_a_mistake_is_one_line(
    arguments: list[str], line: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("MALIPP_BUS", raising=False)
    with pytest.raises(SystemExit) as ended:
        main(["confirm", str(MIXED), *arguments])
    assert ended.value.code == 2
    assert capsys.readouterr().err == f"{line}\n"


def test_a_mission_that_does_not_run_is_said(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(command, "_HEAR_S", 0.2)
    address = any_free_port()
    monkeypatch.setenv("MALIPP_BUS", address)
    with pytest.raises(SystemExit) as ended:
        main(["confirm", str(MIXED), "helper"])
    assert ended.value.code == 2
    line = f"mission 'corridor-mixed' is not heard at {address}: is it running?\n"
    assert capsys.readouterr().err == line
