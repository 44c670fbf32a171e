"""Read YAML and JSON documents, validate them, say on which line a fault stands, and write files whole.

JSON is read by the same YAML 1.2 reader, so both kinds of file get line numbers from one place.
"""

from __future__ import annotations

import contextlib
import datetime
import difflib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar, get_origin

from pydantic import BaseModel, ConfigDict, ValidationError
from pydantic_core import ErrorDetails
from ruamel.yaml import YAML
from ruamel.yaml.comments import CommentedMap, CommentedSeq, TaggedScalar
from ruamel.yaml.constructor import DuplicateKeyError
from ruamel.yaml.error import MarkedYAMLError, YAMLError

from malipp_field.errors import InputError

Location = tuple[str | int, ...]
ModelT = TypeVar("ModelT", bound=BaseModel)


class StrictModel(BaseModel):
    """A frozen record of a file format: unknown keys, wrong types and infinities are refused."""

    model_config = ConfigDict(
        extra="forbid", frozen=True, strict=True, allow_inf_nan=False, populate_by_name=True
    )


class ContentError(ValueError):
    """A value that has the right type but cannot be right where it stands.

    Raised by validators that look at a whole document; `Document.validate` adds file and line.
    """

    def __init__(self, location: Location, problem: str) -> None:
        self.location, self.problem = location, problem
        super().__init__(problem)


@dataclass(frozen=True)
class Document:
    """Plain data together with the line on which every key stands."""

    source: str
    data: Any
    lines: dict[Location, int]

    def error(self, location: Location, problem: str) -> InputError:
        """Return an error that points at ``location``, or at the nearest parent that has a line."""
        known = location
        while known not in self.lines and known:
            known = known[:-1]
        return InputError(self.source, self.lines.get(known), dotted(location), problem)

    def validate(self, model: type[ModelT]) -> ModelT:
        """Return the document as ``model``.

        Raises
        ------
        InputError
            With file, line, key and what would be right, for the first fault found.
        """
        try:
            return model.model_validate(self.data)
        except ValidationError as fault:
            details = min(fault.errors(), key=_urgency)
            cause = details.get("ctx", {}).get("error")
            if isinstance(cause, ContentError):
                raise self.error(cause.location, cause.problem) from None
            location = self._in_document(details["loc"])
            raise self.error(location, _in_words(details, model, location)) from None

    def _in_document(self, location: Location) -> Location:
        """Drop what pydantic adds to a path (names of union members) and keys that are missing."""
        kept: Location = ()
        for part in location:
            if (*kept, part) in self.lines:
                kept = (*kept, part)
        return (*kept, location[-1]) if location and location[-1] not in kept[-1:] else kept


def read_document(path: Path) -> Document:
    """Read a YAML or JSON file.

    Raises
    ------
    InputError
        When the file cannot be read, is not UTF-8, or is not well-formed.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise InputError(str(path), None, "", "no such file") from None
    except UnicodeDecodeError:
        raise InputError(str(path), None, "", "not a text file in UTF-8") from None
    except OSError as fault:
        raise InputError(str(path), None, "", fault.strerror or str(fault)) from None
    return parse_document(text, str(path))


def parse_document(text: str, source: str) -> Document:
    """Parse YAML or JSON text; see `read_document`."""
    try:
        raw = YAML(typ="rt", pure=True).load(text)
    except DuplicateKeyError as fault:
        line = fault.problem_mark.line + 1 if fault.problem_mark else None
        problem = str(fault.problem).split(" with value")[0]
        raise InputError(source, line, "", f"{problem}; each key may stand once") from None
    except MarkedYAMLError as fault:
        mark = fault.problem_mark or fault.context_mark
        problem = _YAML_PROBLEMS.get(str(fault.problem), str(fault.problem))
        raise InputError(source, mark.line + 1 if mark else None, "", problem) from None
    except YAMLError as fault:
        raise InputError(source, None, "", str(fault).splitlines()[0]) from None
    lines: dict[Location, int] = {}
    return Document(source, _plain(raw, (), lines), lines)


@contextlib.contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Give a temporary path to write to; it takes the place of ``path`` when the context ends well.

    A reader never sees half a file, a fault leaves what was there before and nothing beside it, and a device
    or pipe is never replaced by a file.

    Raises
    ------
    InputError
        When the file cannot be written.
    """
    partial = path.with_name(path.name + ".partial")
    if path.exists() and not path.is_file():
        raise InputError(str(path), None, "", "cannot be written: it is not an ordinary file")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        partial.touch()
        yield partial
        partial.replace(path)
    except OSError as fault:
        raise InputError(str(path), None, "", f"cannot be written: {fault.strerror}") from None
    finally:
        with contextlib.suppress(OSError):
            partial.unlink(missing_ok=True)


def dotted(location: Location) -> str:
    """Return a path of keys and indices as a person would write it: ``team.robots[0].id``."""
    text = ""
    for part in location:
        text += f"[{part}]" if isinstance(part, int) else f".{part}" if text else part
    return text


def suggest(word: str, choices: list[str]) -> str:
    """Return ``; did you mean 'x'?`` when one of ``choices`` is close to ``word``, else nothing."""
    close = difflib.get_close_matches(word, choices, n=1)
    return f"; did you mean '{close[0]}'?" if close else ""


def _plain(node: Any, location: Location, lines: dict[Location, int]) -> Any:
    """Return the round-trip tree of ruamel.yaml as plain data, noting the line of each key."""
    if isinstance(node, CommentedMap):
        lines.setdefault(location, node.lc.line + 1)
        for key in node:
            lines[(*location, key)] = node.lc.key(key)[0] + 1
        return {key: _plain(value, (*location, key), lines) for key, value in node.items()}
    if isinstance(node, CommentedSeq):
        lines.setdefault(location, node.lc.line + 1)
        for index in range(len(node)):
            lines[(*location, index)] = node.lc.item(index)[0] + 1
        return [_plain(value, (*location, index), lines) for index, value in enumerate(node)]
    if isinstance(node, bool) or node is None:
        return node
    if isinstance(node, str):
        # JSON may escape a character beyond 16 bits as two; YAML reads them one by one.
        return node.encode("utf-16", "surrogatepass").decode("utf-16", "replace")
    for plain in (int, float):  # ruamel.yaml's scalars remember how they were written
        if isinstance(node, plain):
            return plain(node)
    return node


_YAML_PROBLEMS = {"but found another document": "a second document begins here; a file holds one"}

_EXPECTED = {
    "float_type": "a number", "int_type": "a whole number", "string_type": "text",
    "bool_type": "true or false",
    "list_type": "a list", "dict_type": "a mapping", "model_type": "a mapping of keys",
    "model_attributes_type": "a mapping of keys", "tuple_type": "a list", "finite_number": "a finite number",
    "string_pattern_mismatch": "a name of letters, digits, '_', '.' and '-', without blanks",
}  # fmt: skip


def _urgency(details: ErrorDetails) -> int:
    """Put a file of another format first, then unknown keys: they often make a known one "missing"."""
    if details["type"] == "literal_error" and details["loc"] == ("format",):
        return 0
    return 1 if details["type"] == "extra_forbidden" else 2


def _in_words(details: ErrorDetails, model: type[BaseModel], location: Location) -> str:
    """Return what is wrong and what would be right, in one sentence."""
    kind, value = details["type"], details["input"]
    if kind == "missing":
        return "is missing"
    if kind == "extra_forbidden":
        known = _known_keys(model, location[:-1])
        near = suggest(str(location[-1]), known)
        return f"unknown key{near or ('; known here: ' + ', '.join(known) if known else '')}"
    if kind in _EXPECTED:
        hint = (
            "; write it in quotes"
            if kind == "string_type" and isinstance(value, int | float | datetime.date)
            else ""
        )
        return f"expected {_EXPECTED[kind]}, found {_shown(value)}{hint}"
    if kind == "too_short":
        least, found = details["ctx"]["min_length"], details["ctx"]["actual_length"]
        return f"at least {least} item{'s' * (least > 1)} needed, found {found}"
    if kind.startswith("union_tag"):
        return _of_which_kind(details["ctx"])
    message = details["msg"].removeprefix("Value error, ").removeprefix("Input ")
    return message if kind == "value_error" else f"{message}, found {_shown(value)}"


def _of_which_kind(context: Mapping[str, Any]) -> str:
    """Return what is wrong with the key that says which kind of mapping it is."""
    key = context["discriminator"]
    if "tag" not in context:
        return f"{key} is missing"
    return f"expected {key} to be {context['expected_tags']}; found '{context['tag']}'"


def _shown(value: Any) -> str:
    if isinstance(value, dict):
        return "a mapping"
    if isinstance(value, list):
        return "a list"
    if isinstance(value, TaggedScalar):
        return f"a value with the tag {value.tag.value}"
    if isinstance(value, datetime.date):
        return str(value)
    text = "nothing" if value is None else repr(value)
    return text if len(text) <= 60 else text[:57] + "..."


def _known_keys(model: type[BaseModel], location: Location) -> list[str]:
    """Return the keys that ``model`` allows at ``location``, as they are written in a file."""
    current: Any = model
    named = False  # the next part is a name that the file gives, such as a robot's under vehicles
    for part in location:
        if isinstance(part, int) or named:
            named = False
            continue
        if not (isinstance(current, type) and issubclass(current, BaseModel)):
            return []
        fields = {field.alias or name: field for name, field in current.model_fields.items()}
        if part not in fields:
            return []
        annotation = fields[str(part)].annotation
        current, named = _model_inside(annotation), get_origin(annotation) is dict
    if not (isinstance(current, type) and issubclass(current, BaseModel)):
        return []
    return [field.alias or name for name, field in current.model_fields.items()]


def _model_inside(annotation: Any) -> Any:
    """Return the only pydantic model within ``tuple[Model, ...]``, ``Model | None`` and the like."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    inside = [_model_inside(argument) for argument in getattr(annotation, "__args__", ())]
    models = [found for found in inside if found is not None]
    return models[0] if len(models) == 1 else None
