"""Layouts of files, and values read and written by them.

A layout is a class with a field per key. Its annotation is the kind of the entry in the file, and marks in `Annotated`
are its meaning: the name of a coordinate is its number in the value, a list of half-spaces a region. Reading, writing
and the JSON Schema all follow from that.
"""

from __future__ import annotations

import types
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from typing import Annotated, Any, ClassVar, TypeVar, Union, get_args, get_origin

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from micah_plan.documents.located import Located
from micah_plan.errors import InputError

T = TypeVar("T")
Scope = Mapping[str, Sequence[str]]
"""The names that entries may refer to, in order, by what they name: coordinate, input, mode, part, body."""


class Document(BaseModel):
    """Base of every layout: unknown keys are errors, types are not converted, numbers are finite.

    Keys are called like the attributes of the value that the entry describes, or as in `renamed`, wherever both mean
    the same. Where they do not, a layout has its own `read` and `written`, which are inverses.
    """

    # Validators are built when a file is first read with them, and only those that this file needs.
    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False, defer_build=True)

    makes: ClassVar[Callable[..., Any]] = dict
    """The class of the value; a dict if it is the layout around it that makes one."""
    always_written: ClassVar[Collection[str]] = ()
    """Keys to write even where their value is the default."""
    renamed: ClassVar[Mapping[str, str]] = {}
    """What the value calls keys that older files made permanent."""

    def read(self, at: Located, scope: Scope) -> Any:
        """The value that the entry describes.

        Args:
            at: the place of the entry, for messages.
            scope: the names that it may refer to.

        Raises:
            InputError: for an unknown name or inconsistent entries.
        """
        return type(self).makes(**self.meanings(at, scope))

    def check(self, at: Located) -> None:
        """Raise an InputError if the entry is inconsistent in itself."""

    def meanings(self, at: Located, scope: Scope) -> dict[str, Any]:
        """The entry as attributes, without the format: marks applied, inner entries as values."""
        self.check(at)
        meant = {key: kind for key, kind in _kinds(type(self)).items() if kind.is_converted}
        entries = {key: value for key, value in self if key != "format"}
        entries |= {key: _read(kind, entries[key], at.at(key), scope) for key, kind in meant.items()}
        return {self.renamed.get(key, key): value for key, value in entries.items()}

    def meaning(self, key: str, at: Located, scope: Scope) -> Any:
        """One key's value, as in `meanings`."""
        return _read(_kinds(type(self))[key], getattr(self, key), at.at(key), scope)

    @classmethod
    def written(cls, value: Any, scope: Scope) -> Mapping[str, Any]:
        """Keys and values to write for a value; absent keys are omitted."""
        return {key: getattr(value, cls.renamed.get(key, key)) for key in cls.model_fields}


def doc(description: str, default: Any = ..., **further: Any) -> Any:
    """A key of a layout with its description and default.

    Args:
        description: its meaning, with its unit.
        default: value of a missing key, a type for the result of calling it; none: the key is required.
        further: as of `pydantic.Field`.
    """
    made = {"default_factory": default} if isinstance(default, type) else {"default": default}
    return Field(**made, description=description, **further)


@dataclass(frozen=True)
class Mark:
    """Conversion of an entry whose value differs from its text in the file; put into `Annotated`.

    Attributes:
        read: meaning of an entry at a place; raises an InputError if it has none.
        written: the inverse.
    """

    read: Callable[[Any, Located, Scope], Any]
    written: Callable[[Any, Scope], Any] = lambda value, _: value


@dataclass(frozen=True)
class _Kind:
    """The kind of an entry, from its annotation.

    Attributes:
        type: without Annotated and `| None`.
        marks: of Annotated.
        keys, entries: of a mapping, `entries` also of a list; None for others.
    """

    type: Any
    marks: tuple[Mark, ...] = ()
    keys: _Kind | None = None
    entries: _Kind | None = None

    @cached_property
    def is_converted(self) -> bool:
        """Whether the value of such an entry differs from its text in the file."""
        inner = any(kind is not None and kind.is_converted for kind in (self.keys, self.entries))
        return inner or bool(self.marks) or is_document(self.type)


def _kind(annotation: Any, marks: tuple[Mark, ...] = ()) -> _Kind:
    origin, arguments = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        found = tuple(mark for mark in annotation.__metadata__ if isinstance(mark, Mark))
        return _kind(annotation.__origin__, (*found, *marks))
    if origin in (Union, types.UnionType):
        return _kind(next(kind for kind in arguments if kind is not type(None)), marks)
    keys = _kind(arguments[0]) if origin is dict else None
    entries = _kind(arguments[keys is not None]) if origin in (dict, list, tuple) else None
    return _Kind(annotation, marks, keys, entries)


@cache
def _kinds(layout: type[Document]) -> dict[str, _Kind]:
    """The kinds of all keys; pydantic stores the metadata of `Annotated` separately."""
    return {
        key: _kind(field.annotation, tuple(mark for mark in field.metadata if isinstance(mark, Mark)))
        for key, field in layout.model_fields.items()
    }


@cache
def _left_out(layout: type[Document]) -> dict[str, Any]:
    """Plain data of each key's default, at which the key is omitted."""
    fields = {key: field for key, field in layout.model_fields.items() if key not in layout.always_written}
    return {
        key: _plain(replace(_kinds(layout)[key], marks=()), field.get_default(call_default_factory=True), {})
        for key, field in fields.items()
        if not field.is_required()
    }


def plain_data(layout: type[Document], value: object, scope: Scope | None = None) -> dict[str, Any]:
    """Plain data of a value in the layout's order, without entries equal to their defaults.

    Args:
        value: one that the layout describes, or a mapping of values by key. A mapping in the place of an inner value is
            plain data and used as it is.
        scope: the names that are written instead of numbers.
    """
    scope, left_out = scope or {}, _left_out(layout)
    mapping = value if isinstance(value, Mapping) else layout.written(value, scope)
    data = {key: _plain(kind, mapping[key], scope) for key, kind in _kinds(layout).items() if key in mapping}
    return {key: item for key, item in data.items() if key not in left_out or item != left_out[key]}


def _plain(kind: _Kind, value: Any, scope: Scope) -> Any:
    """Plain data of a value of one kind; numbers become plain Python numbers."""
    if value is None:
        return None
    for mark in reversed(kind.marks):
        value = mark.written(value, scope)
    if kind.type in (float, int, bool):
        return kind.type(value)
    if isinstance(value, np.ndarray):
        return value.tolist()
    if is_document(kind.type):
        return value if isinstance(value, Mapping) else plain_data(kind.type, value, scope)
    if isinstance(value, Mapping) and kind.keys and kind.entries:
        return {_plain(kind.keys, key, scope): _plain(kind.entries, item, scope) for key, item in value.items()}
    if isinstance(value, list | tuple) and kind.entries:
        return [_plain(kind.entries, item, scope) for item in value]
    return value


def _read(kind: _Kind, value: Any, at: Located, scope: Scope) -> Any:
    """The value of an entry of one kind; the entry itself where they are the same."""
    if value is None or not kind.is_converted:
        return value
    if isinstance(value, Document):
        value = value.read(at, scope)
    elif isinstance(value, Mapping) and kind.keys and kind.entries:
        places = [(key, item, at.at(key)) for key, item in value.items()]
        value = {
            _read(kind.keys, key, place, scope): _read(kind.entries, item, place, scope) for key, item, place in places
        }
    elif isinstance(value, list | tuple) and kind.entries:
        value = tuple(_read(kind.entries, item, at.at(i), scope) for i, item in enumerate(value))
    for mark in kind.marks:
        value = mark.read(value, at, scope)
    return value


def unique(items: Iterable[tuple[T, Any]]) -> dict[T, Any]:
    """Named entries of an automaton as a mapping, refusing repeated names.

    Raises:
        InputError: if a name is used twice.
    """
    result: dict[T, Any] = {}
    for name, value in items:
        if name in result:
            what = "the name" if isinstance(name, str) else "coordinate number"
            raise InputError(f"automaton: {what} {name!r} is used twice", remedy="names are unique")
        result[name] = value
    return result


def kind_at(layout: type[Document], path: Sequence[str | int]) -> Any:
    """The type of value at a key path, for any names in mappings; None if there cannot be one."""
    kind: _Kind | None = _Kind(layout)
    for key in path:
        if kind is None or kind.type is Any:
            break
        if is_document(kind.type):
            kind = _kinds(kind.type).get(str(key))
        else:
            kind = kind.entries if kind.keys or str(key).isdigit() else None
    return None if kind is None else kind.type


def is_document(kind: Any) -> bool:
    """Whether an entry has a layout of its own."""
    return isinstance(kind, type) and issubclass(kind, Document)
