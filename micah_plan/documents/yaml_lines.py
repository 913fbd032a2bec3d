"""YAML text <-> plain data with the line and column of every value. The only importer of PyYAML and ruamel.yaml.

YAML 1.2 with its core schema (so ``1e-3`` is a number and ``on`` a string), without features that a hostile file could
use: no tags, directives or second documents, and bounds on size, number of values and depth. A value with an anchor
(``&name``) is written once and used wherever its alias (``*name``) stands; aliases count as if they were written out.
The reader works on the parser's events and stops at the first that is not allowed, before anything is built from it.
libyaml parses, as PyYAML binds it, twenty times faster than a parser in Python; ruamel.yaml writes, since it keeps
comments with their keys.
"""

from __future__ import annotations

import io
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import yaml
from ruamel.yaml import YAML
from ruamel.yaml.comments import CommentedMap, CommentedSeq
from ruamel.yaml.scalarstring import DoubleQuotedScalarString
from yaml import events
from yaml.error import MarkedYAMLError, YAMLError

from micah_plan.documents.located import KeyPath, Located, line_and_column
from micah_plan.errors import InputError, shown
from micah_plan.files import read_bytes

LARGEST_TEXT_BYTES = 4 * 1024 * 1024
MOST_VALUES = 300_000
"""Values of a text, and of what its aliases stand for: a model of some four thousand modes."""
DEEPEST = 24
_LINE_WIDTH = 120

# PyYAML may be built without libyaml: the same events, slower.
_PARSER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)

# What files of these endings hold; they are given in the wrong place.
_OTHERS = {
    **dict.fromkeys((".csv", ".tum", ".npz", ".parquet", ".mcap", ".bag", ".db3"), "a recording"),
    ".urdf": "a URDF, which `micah-plan convert` makes a model of",
    ".sdf": "an SDF file, which `micah-plan convert` makes a model of",
}
_INTEGER = re.compile(r"[-+]?[0-9]{1,30}")
_FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")
_NOT_TEXT = (
    (
        re.compile(r"[\x00-\x08\x0b\x0c\x0e-\x1f\x7f]"),
        "expected text, found a control character",
        "is it a binary file?",
    ),
    (re.compile(r"^ *\t", re.MULTILINE), "tab in the indentation", "indent with spaces"),
)
_SPECIAL: Mapping[str, bool | float | None] = {
    **dict.fromkeys(("", "~", "null", "Null", "NULL"), None),
    **dict.fromkeys(("true", "True", "TRUE"), True),
    **dict.fromkeys(("false", "False", "FALSE"), False),
    **dict.fromkeys((".inf", ".Inf", ".INF", "+.inf", "+.Inf", "+.INF"), float("inf")),
    **dict.fromkeys(("-.inf", "-.Inf", "-.INF"), float("-inf")),
    **dict.fromkeys((".nan", ".NaN", ".NAN"), float("nan")),
}


def read_yaml_file(path: str | Path, until: str | None = None) -> Located:
    """As `read_yaml`, of a file.

    Raises:
        InputError: also if the file cannot be read.
    """
    return read_yaml(read_bytes(path, LARGEST_TEXT_BYTES), str(path), until)


def read_yaml(content: bytes, source: str, until: str | None = None) -> Located:
    """The mapping that a YAML file holds.

    Args:
        content: of the file, UTF-8.
        source: the file's name, for messages.
        until: a key at which reading stops.

    Raises:
        InputError: if it is not YAML, not a mapping, or uses what the module's docstring excludes.
    """
    suffix = Path(source).suffix.lower()
    if suffix in _OTHERS:
        problem = f"expected a YAML file, found {_OTHERS[suffix]} ({suffix})"
        raise InputError(problem, source=source, remedy="give a model, problem or other YAML file")
    text = _decoded(content, source)
    try:
        return _Reader(_events(text, source), source, until).document()
    except MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        message = " ".join(str(error.problem or error.context or "cannot be parsed").split())
        problem, remedy = f"not valid YAML: {message}", "correct the syntax"
        # libyaml has one more line behind a text without a line break at its end.
        place = None if mark is None else min(_place(mark), _end_of(text))
        raise _error(source, place, problem, remedy) from None
    except (YAMLError, ValueError) as error:
        message = " ".join(str(error).split())[:120]
        raise InputError(f"not valid YAML: {message}", source=source, remedy="correct the syntax") from None


def write_yaml(data: Mapping[str, Any], header: str = "", comments: Mapping[KeyPath, str] | None = None) -> str:
    """YAML text of plain data, lists of scalars on one line, floats exact.

    Args:
        data: dicts with string keys, lists, strings, finite numbers, booleans and None.
        header: lines of comment at the top.
        comments: remarks at the end of the line of a key, by key path.
    """
    writer = YAML()
    writer.version = None
    writer.width = _LINE_WIDTH
    writer.allow_unicode = True
    writer.indent(mapping=2, sequence=4, offset=2)
    writer.representer.ignore_aliases = lambda *_: True
    root = _commented(data, (), comments or {})
    stream = io.StringIO()
    stream.writelines(f"# {line}\n" for line in header.splitlines())
    writer.dump(root, stream)
    return stream.getvalue()


def _decoded(content: bytes, source: str) -> str:
    if len(content) > LARGEST_TEXT_BYTES:
        raise InputError(f"expected at most {LARGEST_TEXT_BYTES // 1024 // 1024} MiB of YAML", source=source)
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        place = _end_of(content[: error.start].decode("latin-1"))
        problem = f"expected UTF-8 text, found the byte 0x{content[error.start]:02x}"
        raise _error(source, place, problem, "save it as UTF-8 text") from None
    for pattern, problem, remedy in _NOT_TEXT:
        match = pattern.search(text)
        if match is not None:
            raise _error(source, _end_of(text[: match.end() - 1]), problem, remedy)
    return text


def _end_of(text: str) -> tuple[int, int]:
    """(line, column) of the position after a text, both from 1."""
    return text.count("\n") + 1, len(text) - text.rfind("\n")


def _events(text: str, source: str) -> Iterator[events.Event]:
    """The parser's events that are allowed, bounded in number."""
    for count, event in enumerate(yaml.parse(text, Loader=_PARSER)):
        problem = _forbidden(event)
        if problem is not None:
            raise _error(source, _place(event.start_mark), problem, "write the value out")
        if count > MOST_VALUES:
            problem = f"expected at most {MOST_VALUES} values"
            raise _error(source, _place(event.start_mark), problem, "leave out what is not needed")
        yield event


def _error(source: str, place: tuple[int, int] | None, problem: str, remedy: str | None) -> InputError:
    where = None if place is None else line_and_column(place)
    return InputError(problem, source=source, where=where, remedy=remedy, position=place)


def _forbidden(event: events.Event) -> str | None:
    if isinstance(event, events.DocumentStartEvent) and (event.version or event.tags):
        return "directives (%YAML, %TAG) are not allowed"
    tag = None if isinstance(event, events.DocumentStartEvent) else getattr(event, "tag", None)
    return None if tag is None else f"tags are not allowed, found {shown(str(tag))}"


class _Reader:
    """Builds data from events; one recursive descent of bounded depth."""

    def __init__(self, parsed: Iterator[events.Event], source: str, until: str | None) -> None:
        self._events = parsed
        self._source = source
        self._until = until
        self._places: dict[KeyPath, tuple[int, int]] = {}
        # Where the value of each anchor is, and how many values aliases have stood for.
        self._anchors: dict[str, tuple[KeyPath, Any]] = {}
        self._expanded = 0

    def document(self) -> Located:
        event = self._next()
        if not isinstance(event, events.DocumentStartEvent):
            raise InputError("expected keys and values, found nothing", source=self._source, remedy="is it empty?")
        first = self._next()
        if not isinstance(first, events.MappingStartEvent):
            kind = "a list" if isinstance(first, events.SequenceStartEvent) else "a single value"
            remedy = "start it with 'format: ...'"
            raise self._error(first, f"expected a mapping of keys to values, found {kind}", remedy)
        self._places[()] = _place(first.start_mark)
        data = self._value(first, ())
        for event in () if self._until in data else self._events:
            if isinstance(event, events.DocumentStartEvent):
                raise self._error(event, "expected one document, found a second", "put it into a file of its own")
        return Located(data, self._source, self._places)

    def _next(self) -> events.Event:
        event = next(self._events)
        return next(self._events) if isinstance(event, events.StreamStartEvent) else event

    def _error(self, event: events.Event, problem: str, remedy: str | None = None) -> InputError:
        return _error(self._source, _place(event.start_mark), problem, remedy)

    def _value(self, event: events.Event, path: KeyPath) -> Any:
        if isinstance(event, events.AliasEvent):
            if event.anchor not in self._anchors:
                problem = f"the alias {shown('*' + event.anchor)} refers to nothing before it"
                raise self._error(event, problem, f"write '&{event.anchor}' before the value that it means")
            return self._resolved_alias(event, *self._anchors[event.anchor], path)
        value = self._parsed(event, path)
        if isinstance(event, events.NodeEvent) and event.anchor is not None:
            self._anchors[event.anchor] = path, value
        return value

    def _resolved_alias(self, event: events.Event, origin: KeyPath, value: Any, path: KeyPath) -> Any:
        """A copy of the value that an alias at a path refers to, with the places of the original."""
        self._check_depth(event, path)
        self._expanded += 1
        if self._expanded > MOST_VALUES:
            raise self._error(event, f"aliases stand for more than {MOST_VALUES} values", "write out what is needed")
        self._places.setdefault(path, self._places[origin])
        if isinstance(value, dict):
            return {key: self._resolved_alias(event, (*origin, key), item, (*path, key)) for key, item in value.items()}
        if isinstance(value, list):
            return [self._resolved_alias(event, (*origin, i), item, (*path, i)) for i, item in enumerate(value)]
        return value

    def _check_depth(self, event: events.Event, path: KeyPath) -> None:
        if len(path) > DEEPEST:
            raise self._error(event, f"expected at most {DEEPEST} levels", "use fewer levels")

    def _parsed(self, event: events.Event, path: KeyPath) -> Any:
        """The value that starts at an event."""
        self._check_depth(event, path)
        if isinstance(event, events.ScalarEvent):
            return _scalar(event)
        if isinstance(event, events.SequenceStartEvent):
            items: list[Any] = []
            while not isinstance(event := self._next(), events.SequenceEndEvent):
                here = (*path, len(items))
                self._places[here] = _place(event.start_mark)
                items.append(self._value(event, here))
            return items
        entries: dict[str, Any] = {}
        while not isinstance(key := self._next(), events.MappingEndEvent):
            if not isinstance(key, events.ScalarEvent):
                raise self._error(key, "expected a name as key, found a list or mapping", "quote braces and brackets")
            here = (*path, key.value)
            if key.value in entries:
                first = self._places[here][0]
                raise self._error(key, f"duplicate key {shown(key.value)}, first on line {first}", "keep one of them")
            self._places[here] = _place(key.start_mark)
            entries[key.value] = self._value(self._next(), here)
            if here == (self._until,):
                break
        return entries


def _place(mark: Any) -> tuple[int, int]:
    """Line and column, both from 1, of a mark that the parser made."""
    return mark.line + 1, mark.column + 1


def _scalar(event: events.ScalarEvent) -> Any:
    text: str = event.value
    if not event.implicit[0]:  # quoted
        return text
    if text in _SPECIAL:
        return _SPECIAL[text]
    if _INTEGER.fullmatch(text):
        return int(text)
    return float(text) if _FLOAT.fullmatch(text) else text


def _commented(value: Any, path: KeyPath, comments: Mapping[KeyPath, str]) -> Any:
    if isinstance(value, Mapping):
        mapping = CommentedMap((key, _commented(item, (*path, key), comments)) for key, item in value.items())
        for key in value:
            remark = comments.get((*path, key))
            if remark is not None:
                mapping.yaml_add_eol_comment(remark, key)
        return mapping
    if isinstance(value, list | tuple):
        sequence = CommentedSeq(_commented(item, (*path, i), comments) for i, item in enumerate(value))
        if not any(isinstance(item, Mapping | list | tuple) for item in value) and not _has_long_text(value):
            sequence.fa.set_flow_style()
        return sequence
    if isinstance(value, str) and value.startswith("?"):
        return DoubleQuotedScalarString(value)  # bare in a list, it would read back as a key
    return value


def _has_long_text(items: list[Any] | tuple[Any, ...]) -> bool:
    return sum(len(item) for item in items if isinstance(item, str)) > _LINE_WIDTH // 2
