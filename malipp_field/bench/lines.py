"""A file of JSON lines that is appended to as records come, and survives being cut off."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Generic, TypeVar

from pydantic import ValidationError

from malipp_field.documents import StrictModel
from malipp_field.errors import InputError

RecordT = TypeVar("RecordT", bound=StrictModel)


class JsonLines(Generic[RecordT]):
    """Records of one kind in a file.

    A last line cut short by a kill is dropped; it is as if it had never been written.
    """

    def __init__(self, path: Path, model: type[RecordT]) -> None:
        self.path, self._model = path, model
        self._whole: int | None = None
        """Bytes up to the end of the last whole line, where something follows it."""

    def read(self) -> list[RecordT]:
        """Return the records; none where there is no file.

        Raises
        ------
        InputError
            When the file cannot be read, or holds something else.
        """
        try:
            content = self.path.read_bytes() if self.path.exists() else b""
        except OSError as fault:
            raise InputError(str(self.path), None, "", fault.strerror or str(fault)) from None
        whole = content.rfind(b"\n") + 1
        self._whole = whole if whole < len(content) else None
        return [self._parsed(line, number) for number, line in enumerate(content[:whole].splitlines(), 1)]

    def append(self, record: RecordT) -> None:
        """Keep a record, on disk at once.

        Raises
        ------
        InputError
            When the file cannot be written.
        """
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            if self._whole is not None:
                os.truncate(self.path, self._whole)
                self._whole = None
            with self.path.open("a", encoding="utf-8") as stream:
                stream.write(record.model_dump_json() + "\n")
        except OSError as fault:
            raise InputError(str(self.path), None, "", f"cannot be written: {fault.strerror}") from None

    def _parsed(self, line: bytes, number: int) -> RecordT:
        try:
            return self._model.model_validate_json(line)
        except ValidationError:
            problem = "not a result of this benchmark; name another file, or remove this one"
            raise InputError(str(self.path), number, "", problem) from None
