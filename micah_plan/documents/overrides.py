"""Values put into the plain data of a file in place of its own, by dotted key."""

from __future__ import annotations

import copy
from dataclasses import replace
from typing import Any

from micah_plan.documents.located import KeyPath, Located
from micah_plan.errors import InputError, shown


def overridden(located: Located, key: str, value: Any) -> Located:
    """The data with another value at a dotted key such as ``start.std.door`` or ``goal.modes.0``.

    Keys that are not there are added (a layout that does not know them says so when it is validated); entries of lists
    must be there.

    Raises:
        InputError: if there is a plain value on the way.
    """
    data = copy.deepcopy(located.data)
    current, path = data, list[str | int]()
    names = key.split(".")
    for depth, name in enumerate(names):
        entry: str | int = name
        if isinstance(current, list):
            entry = _index(located, key, name, len(current))
        elif not isinstance(current, dict):
            raise InputError(f"cannot override {shown(key)}: '{names[depth - 1]}' has no keys", source=located.source)
        path.append(entry)
        if depth == len(names) - 1:
            current[entry] = copy.deepcopy(value)
        else:
            current = current.setdefault(name, {}) if isinstance(current, dict) else current[entry]
    return replace(located, data=data, places=_without(located, tuple(path)))


def _index(located: Located, key: str, name: str, length: int) -> int:
    if name.isascii() and name.isdigit() and int(name[:9]) < length:
        return int(name)
    problem = f"cannot override {shown(key)}: expected one of the {length} entries, found {shown(name)}"
    raise InputError(problem, source=located.source, remedy="count from 0, or give the whole list")


def _without(located: Located, path: KeyPath) -> dict[KeyPath, tuple[int, int]]:
    """The places of all that is not at or below a key path."""
    return {place: at for place, at in located.places.items() if place[: len(path)] != path}
