"""Differences between two models, place by place in terms of their files."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.documents.model import model_data


@dataclass(frozen=True)
class Difference:
    """One place of a model file that differs.

    Attributes:
        place: keys from the top of the file, joined by dots; parts of a list by their names, or by number.
        before, after: the values as in the file; None where missing.
    """

    place: str
    before: Any
    after: Any

    def __str__(self) -> str:
        if self.before is None:
            return f"+ {self.place}: {_shown(self.after)}"
        if self.after is None:
            return f"- {self.place}: {_shown(self.before)}"
        return f"~ {self.place}: {_shown(self.before)} -> {_shown(self.after)}"


def differences(before: HybridAutomaton, after: HybridAutomaton) -> tuple[Difference, ...]:
    """All differences between the files of two models, in file order."""
    return tuple(_between("", model_data(before), model_data(after)))


def _between(place: str, before: Any, after: Any) -> Iterator[Difference]:
    if isinstance(before, Mapping) and isinstance(after, Mapping):
        for key in dict.fromkeys([*before, *after]):
            inner = f"{place}.{key}" if place else str(key)
            yield from _between(inner, before.get(key), after.get(key))
    elif _is_list_of_parts(before) and _is_list_of_parts(after):
        yield from _between(place, _by_name(before), _by_name(after))
    elif before != after:
        yield Difference(place, before, after)


def _is_list_of_parts(value: Any) -> bool:
    return isinstance(value, list | tuple) and all(isinstance(item, Mapping) for item in value)


def _by_name(parts: Sequence[Mapping[str, Any]]) -> dict[str, Mapping[str, Any]]:
    """Parts of a list by name; numbered where names are missing or repeated."""
    named: dict[str, Mapping[str, Any]] = {}
    for number, part in enumerate(parts, start=1):
        key = str(part.get("name", number))
        named[key if key not in named else f"{key} ({number})"] = part
    return named


def _shown(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, Mapping):
        return ", ".join(f"{key} {_shown(inner)}" for key, inner in value.items())
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_shown(inner) for inner in value) + "]"
    return str(value)
