"""The synthetic mission's MCAP file, as the mcap library, Rerun and this project read it."""

from __future__ import annotations

import json
import random
from collections import Counter
from itertools import pairwise
from pathlib import Path

import pytest
import synthetic_plan
import synthetic_run
from mcap.data_stream import ReadDataStream
from mcap.reader import make_reader
from mcap.records import Chunk
from mcap.records import Message as McapMessage
from mcap.stream_reader import breakup_chunk
from mcap_protobuf.decoder import DecoderFactory
from rerun.chunk import McapReader

from malipp_field.bus.messages import Confirmation, Ledger, Message, PlanAdopted, Telemetry
from malipp_field.errors import InputError
from malipp_field.plan import parse_plan
from malipp_field.record import Run, read_run


@pytest.fixture(scope="module")
def said() -> list[tuple[str, Message]]:
    return synthetic_run.messages()


@pytest.fixture(scope="module")
def mcap_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return synthetic_run.record(tmp_path_factory.mktemp("recording") / "twin-pits.mcap")


def test_the_mcap_library_finds_every_message_under_its_key_and_time(
    mcap_file: Path, said: list[tuple[str, Message]]
) -> None:
    with mcap_file.open("rb") as file:
        rows = [
            (channel.topic, message.log_time, json.loads(message.data))
            for _, channel, message in make_reader(file, validate_crcs=True).iter_messages()
            if channel.message_encoding == "json"
        ]
    assert Counter(topic for topic, _, _ in rows) == Counter(f"/{key}" for key, _ in said)
    assert all(before[1] <= after[1] for before, after in pairwise(rows))
    assert all(abs(time_ns / 1e9 - body["time_s"]) < 1e-6 for _, time_ns, body in rows)


def test_the_file_is_chunked_indexed_and_compressed(mcap_file: Path, said: list[tuple[str, Message]]) -> None:
    with mcap_file.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    assert summary.statistics is not None
    derived = sum(type(message).__name__ in ("Telemetry", "Event") for _, message in said)
    assert summary.statistics.message_count == len(said) + derived
    assert len(summary.chunk_indexes) > 5
    assert {index.compression for index in summary.chunk_indexes} == {"zstd"}
    encodings = {schema.encoding for schema in summary.schemas.values()}
    assert encodings == {"jsonschema", "protobuf"}


def test_derived_channels_decode_as_foxglove_protobuf(
    mcap_file: Path, said: list[tuple[str, Message]]
) -> None:
    with mcap_file.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        fixes = [
            row.decoded_message for row in reader.iter_decoded_messages(topics=["/vehicle/mule/location"])
        ]
        logs = [row.decoded_message for row in reader.iter_decoded_messages(topics=["/log"])]
    reports = [m for _, m in said if isinstance(m, Telemetry) and m.robot == "mule"]
    assert [(fix.latitude, fix.longitude) for fix in fixes] == [(r.lat_deg, r.lon_deg) for r in reports]
    assert fixes[0].timestamp.seconds == int(synthetic_run.START_S)
    assert [log.level for log in logs] == [2, 2, 3, 3, 2]  # foxglove.Log: 2 info, 3 warning
    assert logs[2].name == "coordinator (mule)"


def test_mission_and_plans_are_attached_and_the_software_is_named(mcap_file: Path) -> None:
    with mcap_file.open("rb") as file:
        reader = make_reader(file)
        attached = {a.name: a.data.decode() for a in reader.iter_attachments()}
        metadata = {m.name: m.metadata for m in reader.iter_metadata()}
    assert attached.keys() == {"mission.yaml", "plan-1.json", "plan-2.json"}
    assert attached["mission.yaml"] == synthetic_plan.MISSION
    assert parse_plan(attached["plan-2.json"]) == synthetic_plan.plan(2)
    assert {"malipp-field", "mcap", "python"} <= metadata["software"].keys()


def test_rerun_opens_it_without_this_project(mcap_file: Path, said: list[tuple[str, Message]]) -> None:
    rows: Counter[str] = Counter()
    columns: dict[str, set[str]] = {}
    for chunk in McapReader(mcap_file).stream().to_chunks():
        if not chunk.is_static:
            rows[chunk.entity_path] += chunk.num_rows
            columns.setdefault(chunk.entity_path, set()).update(chunk.to_record_batch().schema.names)
    for robot in ("lark", "kite", "mule"):
        entity = f"/vehicle/{robot}/location"
        assert "GeoPoints:positions" in columns[entity]
        assert rows[entity] >= sum(isinstance(m, Telemetry) and m.robot == robot for _, m in said)
    assert "TextLog:text" in columns["/log"]


def test_everything_is_read_back_as_it_was_said(mcap_file: Path, said: list[tuple[str, Message]]) -> None:
    run = read_run(mcap_file)
    assert run.complete
    assert run.mission == synthetic_plan.mission()
    assert run.start_s == synthetic_run.START_S
    assert list(run.plans) == [m for _, m in said if isinstance(m, PlanAdopted)]
    assert list(run.confirmations) == [m for _, m in said if isinstance(m, Confirmation)]
    assert list(run.ledgers) == [m for _, m in said if isinstance(m, Ledger)]
    for robot, reports in run.telemetry.items():
        assert list(reports) == [m for _, m in said if isinstance(m, Telemetry) and m.robot == robot]


def _whole_messages(mcap_file: Path, size: int) -> int:
    """Return how many bus messages lie in chunks that end before ``size``, by the file's own index."""
    with mcap_file.open("rb") as file:
        summary = make_reader(file).get_summary()
        assert summary is not None
        json_channels = {c.id for c in summary.channels.values() if c.message_encoding == "json"}
        count = 0
        for index in summary.chunk_indexes:
            if index.chunk_start_offset + index.chunk_length <= size:
                file.seek(index.chunk_start_offset + 9)  # opcode and length come first
                chunk = Chunk.read(ReadDataStream(file))
                count += sum(
                    isinstance(record, McapMessage) and record.channel_id in json_channels
                    for record in breakup_chunk(chunk, validate_crc=True)
                )
        return count


def _count(run: Run) -> int:
    return (
        1 + len(run.plans) + len(run.confirmations) + len(run.events) + len(run.ledgers)
        + sum(map(len, run.telemetry.values()))
    )  # fmt: skip


@pytest.mark.parametrize("seed", range(20))
def test_a_cut_file_gives_back_every_whole_chunk_and_says_that_it_was_cut(
    mcap_file: Path, tmp_path: Path, seed: int
) -> None:
    data = mcap_file.read_bytes()
    size = random.Random(seed).randrange(len(data))
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(data[:size])
    expected = _whole_messages(mcap_file, size)
    if expected == 0:
        with pytest.raises(InputError, match="expected a recording made by malipp"):
            read_run(cut)
        return
    run = read_run(cut)
    assert not run.complete
    assert _count(run) == expected


@pytest.mark.parametrize("seed", range(5))
def test_damage_in_a_chunk_is_noticed(mcap_file: Path, tmp_path: Path, seed: int) -> None:
    data = bytearray(mcap_file.read_bytes())
    with mcap_file.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    third = sorted(summary.chunk_indexes, key=lambda index: index.chunk_start_offset)[2]
    data[third.chunk_start_offset + third.chunk_length - 1 - random.Random(seed).randrange(1000)] ^= 0x5A
    (tmp_path / "damaged.mcap").write_bytes(data)
    run = read_run(tmp_path / "damaged.mcap")
    assert not run.complete
    assert _count(run) == _whole_messages(mcap_file, third.chunk_start_offset)
