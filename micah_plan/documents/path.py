"""Constraints and costs on the path: the entry `path` of a problem file. It names functions, and never brings one."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated, Any

from pydantic import AfterValidator, WithJsonSchema
from pydantic_core import PydanticCustomError

from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.documents.layout import Document, Name, Names, checked_name, doc
from micah_plan.documents.located import Located
from micah_plan.task.path import PathConstraint, check_constraint


def _argument(value: object) -> float | str:
    if isinstance(value, str):
        return checked_name(value)
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise PydanticCustomError("argument", "expected a finite number or a name")
    return float(value)


# Not a union of kinds: errors would be told twice, at places that the file does not have.
_SCHEMA = WithJsonSchema({"anyOf": [{"type": "number"}, {"type": "string", "maxLength": 100}]})
Argument = Annotated[Any, AfterValidator(_argument), _SCHEMA]


class PathDocument(Document):
    name: Name = doc("Of a path function: stay_above, stay_below, keep_away, or one that Python code has registered.")
    arguments: dict[Name, Argument] = doc("What it takes: numbers, or names of coordinates and inputs.", dict)
    modes: Names = doc("Modes in which it holds; empty: all.", tuple)


def path_of(
    documents: Sequence[PathDocument], automaton: HybridAutomaton, located: Located
) -> tuple[PathConstraint, ...]:
    """What is under the key `path`.

    Raises:
        InputError: for a function that is not registered, and for arguments or modes that do not fit it or the model.
    """
    found = []
    for i, document in enumerate(documents):
        constraint = PathConstraint(document.name, tuple(document.arguments.items()), document.modes)
        with located.at(i).locating_errors():
            check_constraint(constraint, automaton)
        found.append(constraint)
    return tuple(found)


def path_data(constraints: Sequence[PathConstraint]) -> list[dict[str, Any]]:
    """The entry of constraints, which `path_of` reads back."""
    return [{"name": one.name, "arguments": dict(one.arguments), "modes": list(one.modes)} for one in constraints]
