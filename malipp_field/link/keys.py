"""Signing keys in files that only their owner can read, and the timestamps that go with them.

A key file holds 64 hexadecimal digits. Beside it, ``NAME.state`` keeps the newest timestamp, written ahead,
so that no timestamp is ever used twice and nothing heard before a crash is taken for new after it.
"""

from __future__ import annotations

import contextlib
import fcntl
import logging
import os
import re
import secrets
import stat
import threading
from pathlib import Path

from pydantic import Field, ValidationError

from malipp_field.documents import StrictModel, whole_file
from malipp_field.errors import InputError
from malipp_field.link.signing import MAX_AGE_TICKS, SigningKey, Stamps, Stream

AHEAD_TICKS = 3 * MAX_AGE_TICKS
"""How far ahead of the newest timestamp the file is written: the age limit, a minute's reserve, and a minute
for the disk to write the next."""

log = logging.getLogger(__name__)


class _State(StrictModel):
    """What is kept of the timestamps."""

    floor: int = Field(ge=0, lt=2**48)
    """What to begin with."""
    streams: tuple[tuple[int, int, int, int], ...] = ()
    """System, component, link id, and the last timestamp."""


class KeyFile:
    """A signing key and its timestamps; use as a context manager, one process at a time.

    Parameters
    ----------
    path
        The key; only its owner may be able to read it.

    Attributes
    ----------
    key : SigningKey
        To sign and to verify with.

    Raises
    ------
    InputError
        When the file is not such a key, others could read it, another process uses it, or its state cannot
        be read or written. No text of the file is in the message.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._state_path = path.with_name(path.name + ".state")
        self._lock = threading.Lock()
        self._writer: threading.Thread | None = None
        self._file: int | None = _open_private(path)
        try:
            secret = _secret(self._file, path)
            _lock_for_us(self._file, path)
            state = self._read_state()
            self._stamps = Stamps(
                state.floor, {(s, c, link): at for s, c, link, at in state.streams}, self._running_out
            )
            self._reserve()
        except BaseException:
            os.close(self._file)
            raise
        self.key = SigningKey(secret, self._stamps)

    def __enter__(self) -> KeyFile:
        return self

    def __exit__(self, *_fault: object) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"KeyFile({str(self._path)!r})"

    def close(self) -> None:
        """Keep the timestamps exactly as they are, and let others have the key."""
        if self._file is None:
            return
        if self._writer is not None:
            self._writer.join()
        try:
            with self._lock:
                self._write_state(self._stamps.newest, self._stamps.streams)
        finally:
            os.close(self._file)
            self._file = None

    def _reserve(self) -> None:
        """Write ahead. After a crash one begins where all that was heard by then is too old to be new."""
        with self._lock:
            self._floor = self._stamps.newest + AHEAD_TICKS
            self._write_state(self._floor, {})
            self._stamps.limit = self._floor - 2 * MAX_AGE_TICKS

    def _running_out(self) -> None:
        """Write further ahead: beside the event loop while there is time, else at once."""
        last_moment = self._floor - MAX_AGE_TICKS
        if self._stamps.newest < last_moment:
            self._stamps.limit = last_moment
            self._writer = threading.Thread(target=self._reserve_or_go_on, name="signing timestamps")
            self._writer.start()
        else:
            self._reserve_or_go_on()

    def _reserve_or_go_on(self) -> None:
        """Write ahead, or go on without: a vehicle that hears no more of us for a full disk is worse."""
        try:
            self._reserve()
        except InputError as fault:
            self._stamps.limit = self._floor - 2 * MAX_AGE_TICKS
            log.warning("timestamps are not kept: %s", fault)

    def _read_state(self) -> _State:
        path = str(self._state_path)
        try:
            return _State.model_validate_json(self._state_path.read_bytes())
        except FileNotFoundError:
            return _State(floor=0)
        except OSError as fault:
            raise InputError(path, None, "", fault.strerror or str(fault)) from None
        except ValidationError:
            problem = (
                "does not hold a signing key's timestamps; where this computer's clock is right, remove it"
            )
            raise InputError(path, None, "", problem) from None

    def _write_state(self, floor: int, streams: dict[Stream, int]) -> None:
        kept = tuple((*stream, stamp) for stream, stamp in streams.items())
        with whole_file(self._state_path) as partial:
            partial.write_text(_State(floor=floor, streams=kept).model_dump_json() + "\n", encoding="ascii")
            _sync(partial)
        _sync(self._state_path.parent)


class KeyRing(contextlib.ExitStack):
    """The keys of a team, each opened once; a context manager that closes them."""

    def __init__(self) -> None:
        super().__init__()
        self._keys: dict[Path, SigningKey] = {}

    def key(self, path: Path) -> SigningKey:
        """Return the key in a file; raises like `KeyFile`."""
        whole = path.resolve()
        if whole not in self._keys:
            self._keys[whole] = self.enter_context(KeyFile(path)).key
        return self._keys[whole]


def read_key(path: Path) -> bytes:
    """Return the 32 bytes of a key, for a vehicle and not for its ground station; raises like `KeyFile`."""
    file = _open_private(path)
    try:
        return _secret(file, path)
    finally:
        os.close(file)


def make_key_file(path: Path) -> None:
    """Write a new random key, for its owner only.

    Raises
    ------
    InputError
        When there is a file of that name, or it cannot be written.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    except FileExistsError:
        raise InputError(
            str(path), None, "", "exists already; a key is never overwritten: choose another name"
        ) from None
    except OSError as fault:
        raise InputError(str(path), None, "", f"cannot be written: {fault.strerror}") from None
    with os.fdopen(file, "w", encoding="ascii") as new:
        new.write(secrets.token_hex(32) + "\n")
        new.flush()
        os.fsync(file)


def _sync(path: Path) -> None:
    """Have what was written to a file, or the names in a folder, outlast a power cut."""
    file = os.open(path, os.O_RDONLY)
    try:
        os.fsync(file)
    finally:
        os.close(file)


def _open_private(path: Path) -> int:
    """Open a file that nobody but its owner, who is us, can read."""
    try:
        file = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    except OSError as fault:
        hint = "; malipp key makes keys" if isinstance(fault, FileNotFoundError) else ""
        raise InputError(str(path), None, "", f"{fault.strerror or fault}{hint}") from None
    state = os.fstat(file)
    problem = None
    if not stat.S_ISREG(state.st_mode):
        problem = "is not a file"
    elif state.st_mode & 0o077:
        problem = f"is a signing key that others than its owner can read or change; run: chmod 600 {path}"
    elif state.st_uid != os.geteuid():
        problem = "is a signing key that belongs to another user"
    if problem:
        os.close(file)
        raise InputError(str(path), None, "", problem)
    return file


def _secret(file: int, path: Path) -> bytes:
    text = os.read(file, 100).decode("ascii", "replace").strip()
    if not re.fullmatch(r"[0-9A-Fa-f]{64}", text) or not int(text, 16):
        raise InputError(
            str(path), None, "", "is not a signing key: expected 64 hexadecimal digits (make one: malipp key)"
        )
    return bytes.fromhex(text)


def _lock_for_us(file: int, path: Path) -> None:
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        problem = "this signing key is in use by another process; end that first"
        raise InputError(str(path), None, "", problem) from None
