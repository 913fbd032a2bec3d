"""Validation of located data against a document, reporting all errors in file order."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeVar, get_args

from pydantic import ValidationError
from pydantic_core import ErrorDetails

from micah_plan.documents.fields import LARGEST_STD
from micah_plan.documents.layout import Document, is_document, kind_at
from micah_plan.documents.located import KeyPath, Located
from micah_plan.errors import InputError, choices, nearest, shown, together

D = TypeVar("D", bound=Document)

_EXPECTED: Mapping[str, str] = {
    "float_type": "a number",
    "finite_number": "a finite number",
    "int_type": "an integer",
    "bool_type": "true or false",
    "string_type": "text",
    "dict_type": "a mapping of names to values",
    "model_type": "a mapping of keys to values",
    "list_type": "a list",
    "tuple_type": "a list",
    "greater_than": "a number > {gt:g}",
    "greater_than_equal": "a number >= {ge:g}",
    "less_than": "a number < {lt:g}",
    "less_than_equal": "a number <= {le:g}",
    "literal_error": "{expected}",
    "too_long": "at most {max_length} entries",
    "too_short": "at least {min_length} entries",
    "string_pattern_mismatch": "text of the form {pattern}",
}


def validated(located: Located, document: type[D]) -> D:
    """The document that the data describes.

    Raises:
        InputError: for the first violation in the file, naming line, column, key, what was expected and found, and the
            number of further violations, which it carries.
    """
    if "format" in document.model_fields:  # what is part of a file has none of its own
        check_format(located, document)
    try:
        return document.model_validate(located.data)
    except ValidationError as error:
        raise together(_violations(located, document, error.errors(include_url=False))) from None


def check_format(located: Located, document: type[Document]) -> None:
    """Raise an InputError unless the file states the document's format and version."""
    (expected,) = get_args(document.model_fields["format"].annotation)
    kind = expected.split("/")[1]
    data, stated = located.data, f"says 'format: {expected}'"
    if not isinstance(data, dict):
        remedy = f"a {kind} file is a mapping of keys to values and {stated}"
        raise located.error(f"expected a {kind}, found {_found(data)}", remedy)
    if "format" not in data:
        raise located.error("missing key 'format'", f"a {kind} file {stated}")
    at = located.at("format")
    if at.data == expected:
        return
    match str(at.data).split("/"):
        case ["micah-plan", other, _] if other != kind:
            raise at.error(f"expected a {kind} file, found a {shown(other)[1:-1]} file", f"give a {kind} file")
        case ["micah-plan", _, _]:
            remedy = "use the version of micah-plan that wrote it, or write the file again"
        case _:
            remedy = f"a {kind} file {stated}"
    raise at.error(f"expected {expected}, found {shown(at.data)}", remedy)


def _violations(located: Located, document: type[Document], details: list[ErrorDetails]) -> list[InputError]:
    def order(detail: ErrorDetails) -> tuple[bool, tuple[int, int]]:
        # A missing key is often present with a typo: the unknown key is more informative.
        return detail["type"] == "missing", located.at(*_path(detail)).place() or (0, 0)

    return [located.at(*_path(detail)).error(*_explained(detail, document)) for detail in sorted(details, key=order)]


def _path(detail: ErrorDetails) -> KeyPath:
    return tuple(part for part in detail["loc"] if part != "[key]")


def _explained(detail: ErrorDetails, document: type[Document]) -> tuple[str, str | None]:
    """(problem, remedy) of a validation error."""
    kind, path, context = detail["type"], _path(detail), detail.get("ctx") or {}
    if kind == "extra_forbidden":
        owner = kind_at(document, path[:-1])
        keys = owner.model_fields if is_document(owner) else ()
        return f"unknown key {shown(path[-1])}", choices(str(path[-1]), keys)
    if kind == "missing":
        if isinstance(path[-1], int):
            return "too few entries, this one is missing", "complete the list"
        return f"missing key '{path[-1]}'", "add it"
    value = _found(detail["input"])
    if kind in _EXPECTED:
        return f"expected {_EXPECTED[kind].format(**context)}, found {value}", _near(detail)
    return f"{detail['msg']}, found {value}", None


def _near(detail: ErrorDetails) -> str | None:
    if detail["type"] in ("less_than_equal", "greater_than_equal"):
        (limit,) = (detail.get("ctx") or {}).values()
        return "use SI units: m, rad, s, kg, N" if isinstance(limit, float) and abs(limit) >= LARGEST_STD else None
    if detail["type"] == "string_type" and isinstance(detail["input"], int | float):
        return "put it in quotes"
    if detail["type"] != "literal_error" or not isinstance(detail["input"], str):
        return None
    allowed = [word for i, word in enumerate(str((detail.get("ctx") or {})["expected"]).split("'")) if i % 2]
    near = nearest(detail["input"], allowed)
    return None if near is None else f"did you mean '{near}'?"


def _found(value: Any) -> str:
    if value is None:
        return "nothing"
    if isinstance(value, dict):
        return "a mapping"
    if isinstance(value, list):
        return f"a list of {len(value)}"
    return shown(value)
