from __future__ import annotations

import os
import stat
import threading
from pathlib import Path

import pytest

from malipp_field.errors import InputError
from malipp_field.link.keys import KeyFile, KeyRing, make_key_file, read_key
from malipp_field.link.signing import MAX_AGE_TICKS, Stamps, ticks

NOW_S = 1_700_000_000.0
STREAM = (7, 1, 0)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    path = tmp_path / "keys" / "scout.key"
    make_key_file(path)
    return path


def stamps_of(key_file: KeyFile) -> Stamps:
    return key_file.key._stamps


def crash(key_file: KeyFile) -> None:
    """End without a word, as the system ends a process."""
    if key_file._writer is not None:
        key_file._writer.join()
    assert key_file._file is not None
    os.close(key_file._file)
    key_file._file = None


def test_a_new_key_is_its_owners_alone_and_never_overwrites(path: Path) -> None:
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    text = path.read_text()
    assert len(bytes.fromhex(text)) == 32
    assert read_key(path) == bytes.fromhex(text)
    with pytest.raises(InputError, match="exists already; a key is never overwritten"):
        make_key_file(path)
    assert path.read_text() == text
    make_key_file(path.with_name("other"))
    assert path.with_name("other").read_text() != text


@pytest.mark.parametrize("mode", [0o640, 0o604, 0o620, 0o610, 0o644])
def test_a_key_that_others_can_read_is_refused(path: Path, mode: int) -> None:
    path.chmod(mode)
    with pytest.raises(InputError, match=f"run: chmod 600 {path}$"):
        KeyFile(path)
    assert not path.with_name("scout.key.state").exists()


@pytest.mark.parametrize("text", ["", "beef" * 15, "beef" * 17, "beef" * 15 + "lamb", "00" * 32, "\x00\xff"])
def test_what_is_no_key_is_refused_without_showing_it(path: Path, text: str) -> None:
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        KeyFile(path)
    assert "expected 64 hexadecimal digits" in str(caught.value)
    assert "beef" not in str(caught.value)


def test_no_file_a_folder_and_a_pipe_are_refused(path: Path) -> None:
    os.mkfifo(path.with_name("pipe"), 0o600)
    for name, words in (("none", "No such file"), (".", "is not a file"), ("pipe", "is not a file")):
        with pytest.raises(InputError, match=words):
            KeyFile(path.parent / name)


def test_one_process_at_a_time(path: Path) -> None:
    with KeyFile(path) as first:
        with pytest.raises(InputError, match="is in use by another process"):
            KeyFile(path)
        assert "scout.key" in repr(first)
        assert path.read_text().strip() not in repr(first)
    with KeyFile(path):
        pass
    with KeyRing() as ring:
        assert ring.key(path) is ring.key(path.parent / ".." / "keys" / "scout.key")
    with KeyFile(path):
        pass


def test_timestamps_go_on_exactly_after_a_good_end(path: Path) -> None:
    with KeyFile(path) as key_file:
        last = [stamps_of(key_file).next(NOW_S) for _ in range(3)][-1]
        assert stamps_of(key_file).refusal(STREAM, last + 5, NOW_S) is None
    with KeyFile(path) as key_file:
        assert stamps_of(key_file).next(NOW_S - 1000.0) == last + 6
        assert stamps_of(key_file).refusal(STREAM, last + 5, NOW_S) == "replayed"


@pytest.mark.parametrize("lived_s", [0.0, 1.0, 59.0, 61.0, 121.0, 500.0, 7200.0])
def test_after_a_crash_no_timestamp_is_used_again_and_nothing_heard_is_new(
    path: Path, lived_s: float
) -> None:
    key_file = KeyFile(path)
    used, time_s = [], NOW_S
    while time_s <= NOW_S + lived_s:
        used.append(stamps_of(key_file).next(time_s))
        assert stamps_of(key_file).refusal(STREAM, used[-1] + 7, time_s) is None
        time_s += 1.0 + lived_s / 500.0
    crash(key_file)
    with KeyFile(path) as key_file:
        assert stamps_of(key_file).refusal(STREAM, used[-1] + 7, time_s) == "stale"
        assert stamps_of(key_file).next(NOW_S) > used[-1] + 7


def test_the_disk_is_written_once_a_minute_and_not_in_the_event_loop(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    key_file = KeyFile(path)
    stamps_of(key_file).next(NOW_S)  # from nothing to now: at once
    written_by: list[bool] = []
    honest = key_file._write_state

    def write(floor: int, streams: dict[tuple[int, int, int], int]) -> None:
        written_by.append(threading.current_thread() is threading.main_thread())
        honest(floor, streams)

    monkeypatch.setattr(key_file, "_write_state", write)
    for second in range(600):
        stamps_of(key_file).next(NOW_S + second)
        if key_file._writer is not None:
            key_file._writer.join()
    assert 5 <= len(written_by) <= 10
    assert not any(written_by)
    key_file.close()


def test_a_slow_disk_is_waited_for_before_a_timestamp_could_be_lost(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    key_file = KeyFile(path)
    stamps_of(key_file).next(NOW_S)
    monkeypatch.setattr(threading.Thread, "start", lambda thread: None)  # it does not get to it
    monkeypatch.setattr(threading.Thread, "join", lambda thread: None)
    for second in range(600):
        last = stamps_of(key_file).next(NOW_S + second)
    crash(key_file)
    with KeyFile(path) as again:
        assert stamps_of(again).next(NOW_S) > last + MAX_AGE_TICKS


def test_a_full_disk_stops_no_vehicle(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    key_file = KeyFile(path)

    def full(floor: int, streams: dict[tuple[int, int, int], int]) -> None:
        raise InputError("x", None, "", "cannot be written: No space left on device")

    monkeypatch.setattr(key_file, "_write_state", full)
    assert [stamps_of(key_file).next(NOW_S + s) for s in (0.0, 500.0)] == [ticks(NOW_S), ticks(NOW_S + 500.0)]
    crash(key_file)


@pytest.mark.parametrize(
    "text", ["", "{}", '{"floor": -1}', '{"floor": 1, "streams": [["a", 1, 1, 1]]}', "\xff"]
)
def test_a_state_that_is_none_is_not_guessed_at(path: Path, text: str) -> None:
    path.with_name("scout.key.state").write_text(text)
    with pytest.raises(InputError, match="does not hold a signing key's timestamps"):
        KeyFile(path)
    KeyRing().close()
