"""A recording read back as typed messages: all that a review may use."""

from __future__ import annotations

import struct
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import IO, TypeVar

from mcap.exceptions import McapError
from mcap.records import Channel, Schema
from mcap.records import Message as McapMessage
from mcap.stream_reader import StreamReader
from mcap.writer import MCAP0_MAGIC
from pydantic import ValidationError
from zstandard import ZstdError

from malipp_field.bus.messages import (
    Confirmation,
    Event,
    Ledger,
    Message,
    MissionText,
    PlanAdopted,
    Telemetry,
)
from malipp_field.errors import InputError
from malipp_field.mission import Mission, parse_mission
from malipp_field.record.writer import SCHEMA_PREFIX

MessageT = TypeVar("MessageT", bound=Message)

_TYPES: dict[str, type[Message]] = {
    SCHEMA_PREFIX + kind.__name__: kind
    for kind in (MissionText, PlanAdopted, Event, Telemetry, Confirmation, Ledger)
}
# A cut or damaged record may announce any length: nothing of ours comes near this.
_RECORD_LIMIT_BYTES = 256 * 2**20
# What reading on past damage can raise; `ValueError` covers checksums and UTF-8.
_DAMAGE = (McapError, ZstdError, struct.error, ValueError, MemoryError)


@dataclass(frozen=True)
class Run:
    """A recorded mission. All times are seconds since the Unix epoch on the team's clock."""

    source: str
    """The file, as the user named it."""
    complete: bool
    """Whether the file was finished; if not, what lies after its last whole chunk is lost."""
    mission: Mission
    plans: tuple[PlanAdopted, ...]
    """Every version that came into force, in that order."""
    telemetry: Mapping[str, tuple[Telemetry, ...]]
    """By robot, in the order of the mission file and of time; empty for one never heard of."""
    confirmations: tuple[Confirmation, ...]
    events: tuple[Event, ...]
    ledgers: tuple[Ledger, ...]
    start_s: float
    """Mission time 0: the start of the first plan, or of the recording where no plan was adopted."""
    end_s: float
    """Time of the last message."""


def read_run(path: Path) -> Run:
    """Read a recording, as far as it goes.

    A file that was cut off (power, a killed process) is read up to its last whole chunk.

    Raises
    ------
    InputError
        When there is no such file, it is no MCAP file, or it holds no mission of this project.
    """
    try:
        with path.open("rb") as file:
            messages, complete = _read_messages(file, str(path))
    except FileNotFoundError:
        raise InputError(str(path), None, "", "no such file") from None
    except OSError as fault:
        raise InputError(str(path), None, "", fault.strerror or str(fault)) from None
    return _run(str(path), messages, complete)


def _run(source: str, messages: list[Message], complete: bool) -> Run:
    texts = _of_type(MissionText, messages)
    if not texts:
        what = "no mission in it" if complete else "cut off before its mission was written"
        raise InputError(source, None, "", f"{what}; expected a recording made by malipp")
    mission = parse_mission(texts[0].text, f"{source} (mission.yaml)")
    plans = _of_type(PlanAdopted, messages)
    by_robot: dict[str, list[Telemetry]] = defaultdict(list)
    for telemetry in _of_type(Telemetry, messages):
        by_robot[telemetry.robot].append(telemetry)
    return Run(
        source=source,
        complete=complete,
        mission=mission,
        plans=plans,
        telemetry={robot.id: tuple(by_robot[robot.id]) for robot in mission.team.robots},
        confirmations=_of_type(Confirmation, messages),
        events=_of_type(Event, messages),
        ledgers=_of_type(Ledger, messages),
        start_s=plans[0].start_s if plans else min(m.time_s for m in messages),
        end_s=max(m.time_s for m in messages),
    )


def _of_type(kind: type[MessageT], messages: list[Message]) -> tuple[MessageT, ...]:
    """Return the messages of one type by time; those of equal time in the order of arrival."""
    return tuple(sorted((m for m in messages if isinstance(m, kind)), key=lambda m: m.time_s))


def _read_messages(file: IO[bytes], source: str) -> tuple[list[Message], bool]:
    """Return the bus messages of a file and whether the file is whole."""
    if file.read(len(MCAP0_MAGIC)) != MCAP0_MAGIC:
        raise InputError(source, None, "", "not an MCAP file; expected a recording made by malipp")
    file.seek(0)
    messages: list[Message] = []
    schemas: dict[int, str] = {}
    kinds: dict[int, type[Message] | None] = {}
    try:
        for record in StreamReader(file, validate_crcs=True, record_size_limit=_RECORD_LIMIT_BYTES).records:
            if isinstance(record, Schema):
                schemas[record.id] = record.name
            elif isinstance(record, Channel):
                kinds[record.id] = _TYPES.get(schemas.get(record.schema_id, ""))
            elif isinstance(record, McapMessage) and (kind := kinds.get(record.channel_id)) is not None:
                messages.append(_parse(kind, record.data, source))
    except _DAMAGE:
        return messages, False
    return messages, True


def _parse(kind: type[Message], data: bytes, source: str) -> Message:
    try:
        return kind.model_validate_json(data)
    except ValidationError as fault:
        what = f"a recorded {kind.__name__} is not what this version of malipp expects"
        raise InputError(source, None, "", f"{what}: {fault.errors()[0]['msg']}") from None
