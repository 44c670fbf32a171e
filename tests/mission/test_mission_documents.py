"""Documents: plain data, the line of every key, and one clear line for what is not well-formed."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import Field

from malipp_field.documents import StrictModel, dotted, parse_document, read_document, suggest
from malipp_field.errors import InputError

YAML = """\
# a comment
name: quarry
site:
  nodes:
    - {id: a, x_m: 1}
    - id: b
      x_m: 2
"""


class Inner(StrictModel):
    x_m: float
    label: str = ""


class Outer(StrictModel):
    name: str
    rows: tuple[Inner, ...] = Field(default=(), strict=False)
    flag: bool = False
    count: int = 0


@pytest.mark.parametrize(
    ("location", "line"),
    [
        (("name",), 2), (("site",), 3), (("site", "nodes"), 4), (("site", "nodes", 0), 5),
        (("site", "nodes", 0, "x_m"), 5), (("site", "nodes", 1), 6), (("site", "nodes", 1, "x_m"), 7),
    ],
)  # fmt: skip
def test_lines_of_yaml(location: tuple[str | int, ...], line: int) -> None:
    assert parse_document(YAML, "m.yaml").lines[location] == line


def test_lines_of_json() -> None:
    document = parse_document(
        '{\n "name": "x",\n "rows": [\n  {"x_m": 1.0},\n  {"x_m": "far"}\n ]\n}', "p.json"
    )
    assert (document.lines["name",], document.lines["rows", 1], document.lines["rows", 1, "x_m"]) == (2, 5, 5)
    with pytest.raises(InputError) as caught:
        document.validate(Outer)
    assert str(caught.value) == "p.json:5: rows[1].x_m: expected a number, found 'far'"


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("no", "no"), ("yes", "yes"), ("on", "on"), ("true", True), ("1e-4", 1e-4), ("1.0e+3", 1000.0),
        ("0o17", 15), ("010", 10), ("12:30", "12:30"), ("~", None), ("'7'", "7"), ("-.5", -0.5),
    ],
)  # fmt: skip
def test_yaml_1_2_scalars(text: str, value: object) -> None:
    found = parse_document(f"key: {text}\n", "m.yaml").data["key"]
    assert (found, type(found)) == (value, type(value))


@given(
    st.recursive(
        st.none() | st.booleans() | st.integers(-(10**12), 10**12)
        | st.floats(-1e9, 1e9, allow_nan=False) | st.text("abc é\U0001f916\"\\#:- ", max_size=8),
        lambda inner: st.lists(inner, max_size=3)
        | st.dictionaries(st.text("xyz", min_size=1), inner, max_size=3),
        max_leaves=8,
    )
)  # fmt: skip
def test_json_reads_as_json(data: object) -> None:
    document = parse_document(json.dumps({"data": data}, indent=1), "p.json")
    assert document.data == {"data": data}


@pytest.mark.parametrize(
    ("text", "line", "words"),
    [
        ("a: 1\nb: 2\na: 3\n", 3, 'found duplicate key "a"; each key may stand once'),
        ("a:\n  b: 1\n  c: 2\n  b: 3\n", 4, 'duplicate key "b"'),
        ('{\n "a": 1,\n "a": 2}', 3, 'duplicate key "a"'),
        ("a: [1, 2\nb: 3\n", 2, "expected ',' or ']'"),
        ("a: 1\n\tb: 2\n", 2, "cannot start any token"),
        ("a: *nowhere\n", 1, "undefined alias"),
        ("a: 1\n---\nb: 2\n", 2, "a second document begins here; a file holds one"),
    ],
)
def test_what_is_not_well_formed(text: str, line: int, words: str) -> None:
    with pytest.raises(InputError) as caught:
        parse_document(text, "m.yaml")
    assert caught.value.line == line
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"nothing\.yaml: no such file"):
        read_document(tmp_path / "nothing.yaml")
    with pytest.raises(InputError, match=r"Is a directory"):
        read_document(tmp_path)
    binary = tmp_path / "b.yaml"
    binary.write_bytes(b"\xff\xfe\x00name")
    with pytest.raises(InputError, match="not a text file in UTF-8"):
        read_document(binary)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("name: [1]\n", "m:1: name: expected text, found a list"),
        ("name: 5\n", "m:1: name: expected text, found 5; write it in quotes"),
        (
            "name: 2026-11-22\n",
            "m:1: name: expected text, found 2026-11-22; write it in quotes",
        ),
        ("name: !colour red\n", "m:1: name: expected text, found a value with the tag !colour"),
        ("name: x\ncount: 1.5\n", "m:2: count: expected a whole number, found 1.5"),
        ("name: x\nflag: no\n", "m:2: flag: expected true or false, found 'no'"),
        ("name: x\nrows: 3\n", "m:2: rows: expected a list, found 3"),
        ("name: x\nrows:\n- 3\n", "m:3: rows[0]: expected a mapping of keys, found 3"),
        ("name: x\nrows:\n- {x_m: .inf}\n", "m:3: rows[0].x_m: expected a finite number, found inf"),
        ("name: x\nrows:\n- {label: a}\n", "m:3: rows[0].x_m: is missing"),
        ("nam: x\n", "m:1: nam: unknown key; did you mean 'name'?"),
        ("name: x\nrows:\n- {x_m: 1, zz: 2}\n", "m:3: rows[0].zz: unknown key; known here: x_m, label"),
        ("- 1\n", "m:1: expected a mapping of keys, found a list"),
        ("", "m: expected a mapping of keys, found nothing"),
    ],
)
def test_what_does_not_validate(text: str, message: str) -> None:
    with pytest.raises(InputError) as caught:
        parse_document(text, "m").validate(Outer)
    assert str(caught.value) == message


def test_paths_and_suggestions() -> None:
    assert dotted(("team", "robots", 0, "id")) == "team.robots[0].id"
    assert suggest("scuot", ["carrier", "scout"]) == "; did you mean 'scout'?"
    assert suggest("zebra", ["carrier", "scout"]) == ""
