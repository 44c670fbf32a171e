"""Writing a recording, and reading it back as this project does."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest
from mcap.reader import make_reader
from mcap.writer import Writer
from record_cases import KEY, TEXT, telemetry

from malipp_field.bus.messages import Event, root, vehicle_key
from malipp_field.errors import InputError
from malipp_field.record import RunWriter, read_run
from malipp_field.record.writer import to_ns


def test_what_was_flushed_is_there_before_the_file_is_closed(tmp_path: Path) -> None:
    with RunWriter(tmp_path / "run.mcap") as writer:
        writer.write(KEY, TEXT)
        for second in range(5):
            writer.write(vehicle_key("patch", "r1", "telemetry"), telemetry(1001.0 + second))
        writer.flush()
        writer.sync()
        run = read_run(tmp_path / "run.mcap")
        assert not run.complete
        assert [report.time_s for report in run.telemetry["r1"]] == [1001.0, 1002.0, 1003.0, 1004.0, 1005.0]


def test_the_file_is_finished_when_the_run_fails(tmp_path: Path) -> None:
    def fail() -> None:
        with RunWriter(tmp_path / "run.mcap") as writer:
            writer.write(KEY, TEXT)
            raise RuntimeError("rover on fire")

    with pytest.raises(RuntimeError, match="rover on fire"):
        fail()
    assert read_run(tmp_path / "run.mcap").complete


def test_closing_twice_changes_nothing(tmp_path: Path) -> None:
    writer = RunWriter(tmp_path / "run.mcap")
    writer.write(KEY, TEXT)
    writer.close()
    before = (tmp_path / "run.mcap").read_bytes()
    writer.close()
    assert (tmp_path / "run.mcap").read_bytes() == before


def test_every_schema_is_the_json_schema_of_its_message(tmp_path: Path) -> None:
    with RunWriter(tmp_path / "run.mcap") as writer:
        writer.write(KEY, TEXT)
        writer.write(f"{root('patch')}/event", Event(time_s=1.0, source="me", severity="error", text="no"))
    with (tmp_path / "run.mcap").open("rb") as file:
        found = {
            schema.name: json.loads(schema.data)
            for schema, channel, _ in make_reader(file).iter_messages()
            if schema is not None and channel.message_encoding == "json"
        }
    assert found["malipp.MissionText"]["properties"].keys() == {"time_s", "kind", "text"}
    assert found["malipp.Event"]["properties"]["severity"]["enum"] == ["info", "warning", "error"]


def test_times_are_whole_nanoseconds() -> None:
    assert to_ns(1_780_000_000.25) == 1_780_000_000_250_000_000


def test_a_place_that_cannot_be_written_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match=r"run\.mcap: cannot be written: File exists$"):
        RunWriter(tmp_path / "file" / "run.mcap")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs Linux's /dev/full")
def test_a_full_disk_is_one_line() -> None:
    writer = RunWriter(Path("/dev/full"))
    writer.write(KEY, TEXT)
    with pytest.raises(InputError, match=f"cannot be written: {os.strerror(28)}$"):
        writer.flush()
    with pytest.raises(InputError, match="cannot be written"):
        writer.close()
    assert writer.closed


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        (b"", "not an MCAP file"),
        (b"RRF2 something else", "not an MCAP file"),
        (b"\x89MCAP0\r\n", "cut off before its mission was written"),
    ],
)
def test_a_file_that_is_no_recording_is_one_line(tmp_path: Path, content: bytes, problem: str) -> None:
    path = tmp_path / "bad.mcap"
    path.write_bytes(content)
    with pytest.raises(InputError, match=f"bad.mcap: {problem}; expected a recording made by malipp$"):
        read_run(path)


def test_someone_elses_recording_is_one_line(tmp_path: Path) -> None:
    path = tmp_path / "theirs.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        channel = writer.register_channel("/imu", "json", 0)
        writer.add_message(channel, 1, b"{}", 1)
        writer.finish()  # type: ignore[no-untyped-call]
    with pytest.raises(InputError, match=r"theirs\.mcap: no mission in it; expected a recording"):
        read_run(path)


def test_a_missing_file_and_a_directory_are_one_line(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"none\.mcap: no such file$"):
        read_run(tmp_path / "none.mcap")
    with pytest.raises(InputError, match=r"Is a directory$"):
        read_run(tmp_path)


def test_a_message_of_another_version_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "old.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("malipp.Event", "jsonschema", b"{}")
        channel = writer.register_channel("/malipp/patch/event", "json", schema)
        writer.add_message(channel, 1, b'{"time_s": 1.0, "kind": "event/9"}', 1)
        writer.finish()  # type: ignore[no-untyped-call]
    with pytest.raises(InputError, match="a recorded Event is not what this version of malipp expects"):
        read_run(path)
