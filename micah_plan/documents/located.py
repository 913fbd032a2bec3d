"""Plain data together with where each of its values stands in its file."""

from __future__ import annotations

import copy
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeVar

from micah_plan.errors import InputError, choices, shown

T = TypeVar("T")
KeyPath = tuple[str | int, ...]
_LONGEST_PATH = 120


@dataclass(frozen=True)
class Located:
    """The data of a file, or of one place in it.

    Attributes:
        data: dicts, lists, strings, numbers, booleans and None.
        source: the file.
        places: (line, column), both from 1, of the value at each key path; empty if the format has no useful lines.
        prefix: key path of `data` within the file.
    """

    data: Any
    source: str
    places: Mapping[KeyPath, tuple[int, int]] = field(default_factory=dict)
    prefix: KeyPath = ()

    def at(self, *path: str | int) -> Located:
        """The entry at a key path below this place; None if absent."""
        data = self.data
        for key in path:
            try:
                data = data[key]
            except (LookupError, TypeError):
                data = None
        return Located(data, self.source, self.places, (*self.prefix, *path))

    def place(self) -> tuple[int, int] | None:
        """Line and column of this place, or of its closest parent; None if unknown."""
        above = (self.prefix[:i] for i in range(len(self.prefix), -1, -1))
        return next((self.places[path] for path in above if path in self.places), None)

    def where(self) -> str:
        """The line, column and key of this place, as messages write them."""
        place = self.place()
        at = [] if place is None else [line_and_column(place)]
        return ", ".join(at + ([f"key '{dotted(self.prefix)}'"] if self.prefix else []))

    def error(self, problem: str, remedy: str | None = None) -> InputError:
        """An error about the value at this place, to be raised."""
        return InputError(problem, source=self.source, where=self.where(), remedy=remedy, position=self.place())

    @contextmanager
    def locating_errors(self) -> Iterator[None]:
        """Add this place to InputErrors raised within the context."""
        try:
            yield
        except InputError as error:
            raise self.error(error.problem, error.remedy) from None

    @property
    def folder(self) -> Path:
        """The folder that the file lies in."""
        return Path(self.source).parent

    @property
    def name(self) -> str:
        """The last key of this place."""
        return str(self.prefix[-1])

    def named(self, name: str, names: Sequence[str], what: str) -> str:
        """A name checked against the existing ones.

        Raises:
            InputError: if it is none of them; the message states the kind of names.
        """
        if name not in names:
            raise self.error(f"unknown {what} {shown(name)}", choices(name, names))
        return name

    def number(self, name: str, names: Sequence[str], what: str) -> int:
        """As `named`, but the index of the name."""
        return names.index(self.named(name, names, what))

    def in_order(self, values: Mapping[str, T], names: Sequence[str], what: str, entry: str = "value") -> tuple[T, ...]:
        """Entries in the order of the names, each required once.

        Raises:
            InputError: for an unknown or a missing name.
        """
        for name in values:
            self.at(name).named(name, names, what)
        missing = [name for name in names if name not in values]
        if missing:
            raise self.error(f"missing {entry} of {what} {', '.join(map(repr, missing))}", f"give every one a {entry}")
        return tuple(values[name] for name in names)


def overridden(located: Located, key: str, value: Any) -> Located:
    """The data with another value at a dotted key such as ``start.std.door`` or ``goal.modes.0``.

    Missing keys are added (unknown ones are reported by validation); entries of lists must exist.

    Raises:
        InputError: if the path leads through a plain value.
    """
    data = copy.deepcopy(located.data)
    current, path = data, list[str | int]()
    names = key.split(".")
    for depth, name in enumerate(names):
        entry: str | int = name
        if isinstance(current, list):
            entry = _entry(located, key, name, len(current))
        elif not isinstance(current, dict):
            raise InputError(f"cannot override {shown(key)}: '{names[depth - 1]}' has no keys", source=located.source)
        path.append(entry)
        if depth == len(names) - 1:
            current[entry] = copy.deepcopy(value)
        else:
            current = current.setdefault(name, {}) if isinstance(current, dict) else current[entry]
    places = {place: at for place, at in located.places.items() if place[: len(path)] != tuple(path)}
    return replace(located, data=data, places=places)


def _entry(located: Located, key: str, name: str, length: int) -> int:
    """The index in a list that a key names."""
    if name.isascii() and name.isdigit() and int(name[:9]) < length:
        return int(name)
    problem = f"cannot override {shown(key)}: expected one of the {length} entries, found {shown(name)}"
    raise InputError(problem, source=located.source, remedy="count from 0, or give the whole list")


def line_and_column(place: tuple[int, int]) -> str:
    """A place in a text as messages write it."""
    return f"line {place[0]}, column {place[1]}"


def dotted(path: Iterable[str | int]) -> str:
    """A key path as messages write it: ``modes.shut.joints.door``, on one line and of readable length."""
    text = " ".join("".join(c if c.isprintable() else "?" for c in ".".join(map(str, path))).split())
    return text if len(text) <= _LONGEST_PATH else text[: _LONGEST_PATH - 3] + "..."
