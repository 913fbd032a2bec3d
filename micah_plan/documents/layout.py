"""Layouts of files, and values read and written by them.

A layout is a class with a field per key. Its annotation says of what kind the entry is in the file, and marks in
`Annotated` what it means: the name of a coordinate is its number in the value, a list of half-spaces a region. Reading,
writing and the JSON Schema all follow from that.
"""

from __future__ import annotations

import types
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, TypeVar, Union, get_args, get_origin

import numpy as np
from pydantic import BaseModel, ConfigDict, Field
from pydantic.fields import FieldInfo

from micah_plan.documents.located import Located
from micah_plan.errors import InputError

T = TypeVar("T")
Scope = Mapping[str, Sequence[str]]
"""The names that entries may refer to, in order, by what they name: coordinate, input, mode, part, body."""


class Document(BaseModel):
    """Base of every layout: unknown keys are errors, types are not converted, numbers are finite.

    Keys are called like the attributes of the value that the entry describes, wherever both mean the same. Where they
    do not, a layout has a `read` and a `written` of its own, each of which undoes the other.
    """

    # Validators are built when a file is first read with them, and only those that this file needs.
    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False, defer_build=True)

    makes: ClassVar[Callable[..., Any]] = dict
    """The class of the value; a dict if it is the layout around it that makes one."""
    keeps: ClassVar[Collection[str]] = ()
    """Keys to write even where their value is the default."""

    def read(self, at: Located, scope: Scope) -> Any:
        """The value that the entry describes.

        Args:
            at: the place of the entry, for messages.
            scope: the names that it may refer to.

        Raises:
            InputError: for an unknown name, and for what does not agree with itself.
        """
        return type(self).makes(**self.own(at, scope))

    def check(self, at: Located) -> None:
        """Raise an InputError if the entry contradicts itself, whatever names there are."""

    def own(self, at: Located, scope: Scope) -> dict[str, Any]:
        """What the entry says, by key, of all but the format: what marks mean, inner values, tuples for lists."""
        self.check(at)
        return {
            key: _read(_marked(field), getattr(self, key), at.at(key), scope)
            for key, field in type(self).model_fields.items()
            if key != "format"
        }

    @classmethod
    def written(cls, value: Any, scope: Scope) -> Mapping[str, Any]:
        """What to write of a value, by key; keys that are not there are left out."""
        return {key: getattr(value, key) for key in cls.model_fields}


def doc(description: str, default: Any = ..., **further: Any) -> Any:
    """A key of a layout.

    Args:
        description: what it means, with its unit.
        default: what holds where it is left out, a type for what calling it makes; none: the key is required.
        further: as of `pydantic.Field`.
    """
    made = {"default_factory": default} if isinstance(default, type) else {"default": default}
    return Field(**made, description=description, **further)


@dataclass(frozen=True)
class Mark:
    """What an entry means, where its value has something else than the file; put into `Annotated`.

    Attributes:
        read: what an entry at a place means; raises an InputError if that is nothing.
        written: what a file says of it again.
    """

    read: Callable[[Any, Located, Scope], Any]
    written: Callable[[Any, Scope], Any] = lambda value, _: value


def plain(layout: type[Document], value: object, scope: Scope | None = None) -> dict[str, Any]:
    """Plain data of a value as its layout says, in the layout's order and without what is the layout's default.

    Args:
        value: one that the layout describes, or a mapping of what to write under its keys. A mapping in the place of an
            inner value is plain data and taken as it is.
        scope: the names that are written instead of numbers.
    """
    scope = scope or {}
    given = value if isinstance(value, Mapping) else layout.written(value, scope)
    data = {}
    for key, field in layout.model_fields.items():
        if key in given:
            data[key] = _plain(_marked(field), given[key], scope)
            if key not in layout.keeps and not field.is_required():
                default = _plain(field.annotation, field.get_default(call_default_factory=True), scope)
                if data[key] == default:
                    del data[key]
    return data


def _plain(annotation: Any, value: Any, scope: Scope) -> Any:
    """Plain data of a value of one kind of field; numbers become plain Python numbers."""
    kind, marks = _stripped(annotation)
    if value is None or kind is Any:
        return value
    for mark in reversed(marks):
        value = mark.written(value, scope)
    if kind in (float, int, bool):
        return kind(value)
    if isinstance(value, np.ndarray):
        return value.tolist()
    if is_document(kind):
        return value if isinstance(value, Mapping) else plain(kind, value, scope)
    if isinstance(value, Mapping):
        keys, entries = get_args(kind)
        return {_plain(keys, key, scope): _plain(entries, item, scope) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(_of_entries(kind), item, scope) for item in value]
    return value


def _read(annotation: Any, value: Any, at: Located, scope: Scope) -> Any:
    """What an entry of one kind of field means."""
    kind, marks = _stripped(annotation)
    if value is None or kind is Any:
        return value
    if isinstance(value, Document):
        value = value.read(at, scope)
    elif isinstance(value, Mapping):
        keys, entries = get_args(kind)
        value = {
            _read(keys, key, at.at(key), scope): _read(entries, item, at.at(key), scope) for key, item in value.items()
        }
    elif isinstance(value, list | tuple):
        entries = _of_entries(kind)
        numbers = entries in (float, int)
        value = tuple(value if numbers else (_read(entries, item, at.at(i), scope) for i, item in enumerate(value)))
    for mark in marks:
        value = mark.read(value, at, scope)
    return value


def unique(items: Iterable[tuple[T, Any]]) -> dict[T, Any]:
    """Named entries of an automaton as a mapping.

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


def kind_at(kind: Any, path: Sequence[str | int]) -> Any:
    """The kind of value that a layout has at a key path, whatever names its mappings have; None if it can have none."""
    kind, _ = _stripped(kind)
    for key in path:
        if is_document(kind):
            kind = kind.model_fields[key].annotation if key in kind.model_fields else None
        elif get_origin(kind) is dict or (get_origin(kind) in (list, tuple) and str(key).isdigit()):
            kind = _of_entries(kind)
        elif kind is not Any:
            return None
        kind, _ = _stripped(kind)
    return kind


def is_document(kind: Any) -> bool:
    """Whether a kind of value is an entry with a layout of its own."""
    return isinstance(kind, type) and issubclass(kind, Document)


def _of_entries(kind: Any) -> Any:
    """The kind of the entries of a mapping, list or tuple; Any for other kinds."""
    arguments = get_args(kind)
    if get_origin(kind) is dict:
        return arguments[1]
    return arguments[0] if get_origin(kind) in (list, tuple) else Any


def _stripped(annotation: Any) -> tuple[Any, tuple[Mark, ...]]:
    """An annotation without Annotated and `| None`, and the marks that were in it."""
    if get_origin(annotation) is Annotated:
        kind, marks = _stripped(annotation.__origin__)
        return kind, (*marks, *(mark for mark in annotation.__metadata__ if isinstance(mark, Mark)))
    if get_origin(annotation) in (Union, types.UnionType):
        return _stripped(next(kind for kind in get_args(annotation) if kind is not type(None)))
    return annotation, ()


def _marked(field: FieldInfo) -> Any:
    """The annotation of a key as its layout has it; pydantic keeps what is in `Annotated` apart."""
    return Annotated[(field.annotation, *field.metadata)] if field.metadata else field.annotation
