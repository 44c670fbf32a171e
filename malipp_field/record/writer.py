"""Everything said on the bus, in one MCAP file.

========================================  ==========  ==================================================
topic                                     encoding    content
========================================  ==========  ==================================================
``/malipp/MISSION/...``                   json        every bus message under its key (bus/messages.py)
``/vehicle/ROBOT/location``               protobuf    ``foxglove.LocationFix`` from `Telemetry`
``/log``                                  protobuf    ``foxglove.Log`` from `Event`
========================================  ==========  ==================================================

The Protobuf channels say nothing new: they are there so that Rerun and Foxglove show a recording without this
project. Attachments are the mission file and every plan version; the metadata record ``software`` says what
wrote the file.
"""

from __future__ import annotations

import contextlib
import json
import os
import platform
from collections.abc import Iterator
from importlib.metadata import PackageNotFoundError, version
from math import radians
from pathlib import Path
from types import TracebackType
from typing import Any

from foxglove_schemas_protobuf.LocationFix_pb2 import LocationFix
from foxglove_schemas_protobuf.Log_pb2 import Log
from google.protobuf.message import Message as ProtobufMessage
from google.protobuf.timestamp_pb2 import Timestamp
from mcap.well_known import MessageEncoding, SchemaEncoding
from mcap.writer import CompressionType, Writer
from mcap_protobuf.schema import register_schema

from malipp_field.bus.messages import Event, Message, MissionText, PlanAdopted, Telemetry
from malipp_field.errors import InputError
from malipp_field.plan import plan_text

CHUNK_BYTES = 64 * 1024
"""Uncompressed size at which a chunk is finished even if nobody calls `RunWriter.flush`."""

SCHEMA_PREFIX = "malipp."
"""Schemas of bus messages are named by this and the class: ``malipp.Telemetry``."""

_PACKAGES = ("malipp-field", "eclipse-zenoh", "highspy", "mcap", "numpy", "pymavlink")
_LEVELS = {"info": Log.INFO, "warning": Log.WARNING, "error": Log.ERROR}


def to_ns(time_s: float) -> int:
    """Return seconds since the Unix epoch as MCAP counts them: whole nanoseconds."""
    whole_s = int(time_s // 1)
    return whole_s * 10**9 + round((time_s - whole_s) * 1e9)


class RunWriter:
    """One recording. Use as a context manager: the file gets its index also when the run fails.

    Chunks are compressed with zstd and indexed. What `flush` has written survives the end of the process,
    and what `sync` has passed on survives a power cut.

    Parameters
    ----------
    path
        The file to write; an older one of that name is replaced.

    Raises
    ------
    InputError
        When the file cannot be written.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        with self._one_line_faults():
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = path.open("wb")
        # Any: mcap leaves some of its methods untyped.
        self._mcap: Any = Writer(self._file, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD)
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}
        self._counts: dict[int, int] = {}
        self._mcap.start()
        self._mcap.add_metadata("software", _software())

    def __enter__(self) -> RunWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, fault: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @property
    def closed(self) -> bool:
        """Whether the file is finished; nothing can be written any more."""
        return self._file.closed

    def write(self, key: str, message: Message) -> None:
        """Record a bus message under its key, and what Rerun and Foxglove can show of it.

        Raises
        ------
        InputError
            From this and the methods below, when the disk is full or gone.
        """
        with self._one_line_faults():
            self._write(key, message)

    def flush(self) -> None:
        """Finish the chunk in progress and hand everything to the operating system."""
        with self._one_line_faults():
            self._mcap.flush()

    def sync(self) -> None:
        """Have the operating system put on the disk what was flushed; may be called from another thread."""
        with self._one_line_faults():
            os.fsync(self._file.fileno())

    def close(self) -> None:
        """Write index and statistics, sync, and close; a second call does nothing."""
        if self._file.closed:
            return
        with self._one_line_faults(), self._file:
            self._mcap.finish()
            self._file.flush()
            self.sync()

    def _write(self, key: str, message: Message) -> None:
        time_ns = to_ns(message.time_s)
        self._add(self._json_channel(key, type(message)), time_ns, message.model_dump_json().encode())
        if isinstance(message, Telemetry):
            self._add_protobuf(f"/vehicle/{message.robot}/location", time_ns, _location(message, time_ns))
        elif isinstance(message, Event):
            self._add_protobuf("/log", time_ns, _log(message, time_ns))
        elif isinstance(message, MissionText):
            self._attach("mission.yaml", "application/yaml", time_ns, message.text)
        elif isinstance(message, PlanAdopted):
            name = f"plan-{message.plan.version}.json"
            self._attach(name, "application/json", time_ns, plan_text(message.plan))

    @contextlib.contextmanager
    def _one_line_faults(self) -> Iterator[None]:
        try:
            yield
        except OSError as fault:
            raise InputError(str(self._path), None, "", f"cannot be written: {fault.strerror}") from None

    def _add(self, channel: int, time_ns: int, data: bytes) -> None:
        self._counts[channel] = sequence = self._counts.get(channel, 0) + 1
        self._mcap.add_message(channel, log_time=time_ns, data=data, publish_time=time_ns, sequence=sequence)

    def _add_protobuf(self, topic: str, time_ns: int, message: ProtobufMessage) -> None:
        if topic not in self._channels:
            name = message.DESCRIPTOR.full_name
            if name not in self._schemas:
                self._schemas[name] = register_schema(self._mcap, type(message))
            self._channels[topic] = self._mcap.register_channel(
                topic, MessageEncoding.Protobuf, self._schemas[name]
            )
        self._add(self._channels[topic], time_ns, message.SerializeToString())

    def _json_channel(self, key: str, kind: type[Message]) -> int:
        topic = f"/{key}"
        if topic not in self._channels:
            name = SCHEMA_PREFIX + kind.__name__
            if name not in self._schemas:
                schema = json.dumps(kind.model_json_schema(mode="serialization")).encode()
                self._schemas[name] = self._mcap.register_schema(name, SchemaEncoding.JSONSchema, schema)
            self._channels[topic] = self._mcap.register_channel(
                topic, MessageEncoding.JSON, self._schemas[name]
            )
        return self._channels[topic]

    def _attach(self, name: str, media_type: str, time_ns: int, text: str) -> None:
        self._mcap.add_attachment(
            create_time=time_ns, log_time=time_ns, name=name, media_type=media_type, data=text.encode()
        )


def _location(telemetry: Telemetry, time_ns: int) -> LocationFix:
    return LocationFix(
        timestamp=_timestamp(time_ns),
        frame_id=telemetry.robot,
        latitude=telemetry.lat_deg,
        longitude=telemetry.lon_deg,
        heading=radians(telemetry.heading_deg),
    )


def _log(event: Event, time_ns: int) -> Log:
    name = event.source if event.robot in (None, event.source) else f"{event.source} ({event.robot})"
    return Log(timestamp=_timestamp(time_ns), level=_LEVELS[event.severity], message=event.text, name=name)


def _timestamp(time_ns: int) -> Timestamp:
    return Timestamp(seconds=time_ns // 10**9, nanos=time_ns % 10**9)


def _software() -> dict[str, str]:
    """Return the versions that a person asks for first when a recording looks odd."""
    found = {"python": platform.python_version()}
    for package in _PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:  # run from a source tree that was never installed
            found[package] = "unknown"
    return found
