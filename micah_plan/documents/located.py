"""Plain data together with where each of its values stands in its file."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

from micah_plan.errors import InputError, shown

KeyPath = tuple[str | int, ...]
_LONGEST_PATH = 120
_LONGEST_LIST = 200


@dataclass(frozen=True)
class Located:
    """What a file holds.

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

    def place(self, path: Iterable[str | int]) -> tuple[int, int] | None:
        """Line and column of a key path, or of what comes closest above it; None if there are no lines."""
        full = (*self.prefix, *path)
        return next((self.places[full[:i]] for i in range(len(full), -1, -1) if full[:i] in self.places), None)

    def where(self, path: Iterable[str | int]) -> str:
        """The line, column and key of a key path, as messages write them."""
        path = tuple(path)
        place, full = self.place(path), (*self.prefix, *path)
        at = [] if place is None else [line_and_column(place)]
        return ", ".join(at + ([f"key '{dotted(full)}'"] if full else []))

    def error(self, path: Iterable[str | int], problem: str, remedy: str | None = None) -> InputError:
        """An error about the value at a key path, to be raised."""
        path = tuple(path)
        return InputError(problem, source=self.source, where=self.where(path), remedy=remedy, position=self.place(path))

    def unknown(self, path: Iterable[str | int], what: str, name: str, allowed: Iterable[str]) -> InputError:
        """An error about a name that does not exist, with the names that do and the nearest of them."""
        return self.error(path, f"unknown {what} {shown(name)}", remedy=choices(name, allowed))


def line_and_column(place: tuple[int, int]) -> str:
    """A place in a text as messages write it."""
    return f"line {place[0]}, column {place[1]}"


def dotted(path: Iterable[str | int]) -> str:
    """A key path as messages write it: ``modes.shut.joints.door``, on one line and of readable length."""
    text = " ".join("".join(c if c.isprintable() else "?" for c in ".".join(map(str, path))).split())
    return text if len(text) <= _LONGEST_PATH else text[: _LONGEST_PATH - 3] + "..."


def choices(name: str, allowed: Iterable[str]) -> str:
    """The remedy for an unknown name: ``did you mean 'door'? choose one of door, drawer``."""
    names = list(allowed)
    if not names:
        return "none is allowed here"
    listed = ", ".join(names)
    listed = listed if len(listed) <= _LONGEST_LIST else listed[: _LONGEST_LIST - 3] + "..."
    near = nearest(name, names)
    return (f"did you mean '{near}'? " if near is not None else "") + f"choose one of {listed}"


def nearest(name: str, allowed: Iterable[str]) -> str | None:
    """The allowed name that looks most like this one, if any does."""
    near = difflib.get_close_matches(name[:_LONGEST_PATH], list(allowed), n=1)
    return near[0] if near else None
