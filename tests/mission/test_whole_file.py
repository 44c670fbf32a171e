"""Files are written whole or not at all."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import pytest

from malipp_field.documents import whole_file
from malipp_field.errors import InputError


def write_half(path: Path, fault: BaseException) -> None:
    with whole_file(path) as partial:
        partial.write_text("half of the n")
        raise fault


def test_a_fault_leaves_what_was_there_and_nothing_beside_it(tmp_path: Path) -> None:
    path = tmp_path / "plan.json"
    path.write_text("old")
    with pytest.raises(InputError, match=r"plan\.json: cannot be written: No space left on device$"):
        write_half(path, OSError(errno.ENOSPC, os.strerror(errno.ENOSPC)))
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_other_faults_pass_and_leave_nothing_either(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        write_half(tmp_path / "plan.json", KeyboardInterrupt())
    assert not list(tmp_path.iterdir())


def test_the_old_file_is_there_until_the_new_one_is_whole(tmp_path: Path) -> None:
    path = tmp_path / "new" / "plan.json"
    for text in ("first", "second"):
        with whole_file(path) as partial:
            partial.write_text(text)
            assert path.exists() == (text == "second")
        assert path.read_text() == text
    assert list(path.parent.iterdir()) == [path]


def test_what_is_no_ordinary_file_is_not_replaced(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    with pytest.raises(InputError, match="it is not an ordinary file"), whole_file(pipe):
        pass
    assert pipe.is_fifo()
