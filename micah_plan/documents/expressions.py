"""Affine expressions and half-spaces as a person writes them: ``door >= 1.2``, ``0.5*x + 2*z - input x > 0.1``.

    half-space := sum (">=" | ">" | "<=" | "<") sum
    sum        := ["+" | "-"] term {("+" | "-") term}
    term       := number ["*" variable] | variable
    variable   := ["input"] name

A name that is no plain identifier, or is ``input``, is written in double quotes. Numbers are written by repr, so that
reading returns the very same floats.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Annotated, Any

from pydantic import Field, PlainValidator
from pydantic_core import PydanticCustomError

from micah_plan.automaton.region import HalfSpace, Region
from micah_plan.documents.fields import checked_name
from micah_plan.documents.layout import Mark, Scope
from micah_plan.documents.located import Located
from micah_plan.errors import InputError, choices, shown

INPUT = "input"
_LONGEST = 4000
_TOKEN = re.compile(
    r"""\s*(?:(?P<number>(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][+-]?\d+)?)
    |(?P<name>[^\W\d]\w*)|(?P<quoted>"(?:[^"\\]|\\.)*")|(?P<operator>>=|<=|[-+*<>]))\s*""",
    re.VERBOSE,
)
_IDENTIFIER = re.compile(r"[^\W\d]\w*")
_END = ("end", "")


@dataclass(frozen=True)
class Affine:
    """a'x + b'u + constant, and whether a constant was written (``0.0`` counts)."""

    a: tuple[float, ...]
    b: tuple[float, ...]
    constant: float = 0.0
    has_constant: bool = False


def parse_affine(text: str, scope: Scope) -> Affine:
    """Parse an affine expression.

    Raises:
        InputError: if it is not one or uses an unknown name; the file and place are left to the caller.
    """
    return _affine(text, tuple(scope["coordinate"]), tuple(scope["input"]))


@lru_cache(maxsize=1024)  # as of half-spaces
def _affine(text: str, coordinates: tuple[str, ...], inputs: tuple[str, ...]) -> Affine:
    parser = _Parser(text, {"coordinate": coordinates, "input": inputs})
    expression = parser.sum()
    parser.end("+ or -")
    return expression


def parse_half_space(text: str, scope: Scope, name: str | None = None) -> HalfSpace:
    """Parse a half-space from one comparison; without a name it gets the canonical one.

    Raises:
        InputError: as for `parse_affine`, and if no variable has a weight.
    """
    return _half_space(text, tuple(scope["coordinate"]), tuple(scope["input"]), name)


@lru_cache(maxsize=4096)  # the modes on both sides of a boundary write it in the same way
def _half_space(text: str, coordinates: tuple[str, ...], inputs: tuple[str, ...], name: str | None) -> HalfSpace:
    scope = {"coordinate": coordinates, "input": inputs}
    parser = _Parser(text, scope)
    total = parser.sum()
    operator = parser.comparison()
    right = parser.sum()
    parser.end("the end (one comparison per entry)")
    sign = 1.0 if operator[0] == ">" else -1.0
    a = tuple(sign * (p - q) + 0.0 for p, q in zip(total.a, right.a, strict=True))
    b = tuple(sign * (p - q) + 0.0 for p, q in zip(total.b, right.b, strict=True))
    c = sign * (right.constant - total.constant)
    if not any((*a, *b)):
        raise parser.error("expected a variable with a weight other than 0", f"use {', '.join(_listed(scope))}")
    if not all(map(math.isfinite, (*a, *b, c))):
        raise parser.error("a number is too large", "use SI units")
    half_space = HalfSpace(a, b, c + 0.0, strict=len(operator) == 1)  # + 0.0: no -0.0 in what people see
    return replace(half_space, name=canonical_name(half_space, scope) if name is None else name)


def half_space_text(half_space: HalfSpace, scope: Scope) -> str:
    """The text that `parse_half_space` reads back unchanged."""
    return _comparison(half_space, scope, _exact)


def canonical_name(half_space: HalfSpace, scope: Scope) -> str:
    """The name that the builders of `automaton.region` give, with numbers rounded for reading."""
    return _comparison(half_space, scope, lambda value: f"{value:g}")


def short_text(half_space: HalfSpace, scope: Scope) -> str:
    """The exact expression for messages: limits can be copied from it without rounding."""
    return _comparison(half_space, scope, short_number)


def short_number(value: float) -> str:
    """The exact text of a number, without needless digits (``0`` and ``1.2``, not ``0.0``)."""
    rounded = f"{value:g}"
    return rounded if float(rounded) == value else _exact(value)


def affine_text(a: Sequence[float], b: Sequence[float], constant: float | None, scope: Scope) -> str:
    """The expression that `parse_affine` reads back unchanged; ``0.0`` if it is zero."""
    text = _sum(a, b, scope, _exact)
    if not text or not constant:
        return text or _exact(constant or 0.0)
    return f"{text} {'-' if constant < 0 else '+'} {_exact(abs(constant))}"


class _Parser:
    """Recursive descent over the tokens of one expression: (kind, text), at the end ("end", "")."""

    def __init__(self, text: str, scope: Scope) -> None:
        if len(text) > _LONGEST:
            raise InputError(f"expected at most {_LONGEST} characters, found {len(text)}")
        self._text = text
        self._variables = _listed(scope)
        self._coordinates = len(scope["coordinate"])
        self._rest = self._tokens()
        self._next = next(self._rest, _END)

    def _tokens(self) -> Iterator[tuple[str, str]]:
        position = 0
        while position < len(self._text):
            match = _TOKEN.match(self._text, position)
            if match is None:
                remainder = self._text[position:].strip() or self._text
                allowed = "use names, numbers, + - * and one of >= > <= <"
                raise self.error(f"cannot read {shown(remainder[:20])}", allowed)
            kind = str(match.lastgroup)
            yield kind, match.group(kind)
            position = match.end()

    def error(self, problem: str, remedy: str | None = None) -> InputError:
        return InputError(f"{problem} in {shown(self._text)}", remedy=remedy)

    def _take(self) -> tuple[str, str]:
        token, self._next = self._next, next(self._rest, _END)
        return token

    def end(self, expected: str) -> None:
        if self._next != _END:
            raise self.error(f"expected {expected}, found {shown(self._next[1])}")

    def comparison(self) -> str:
        kind, text = self._take()
        if kind != "operator" or text not in (">=", ">", "<=", "<"):
            text_shown = shown(text) if text else "the end"
            raise self.error(f"expected one of >= > <= <, found {text_shown}", "write it like 'door >= 1.2'")
        return text

    def sum(self) -> Affine:
        weights, constants = [0.0] * len(self._variables), list[float]()
        sign: float | None = self._sign() or 1.0
        while sign is not None:
            weight, index = self._term()
            if index is None:
                constants.append(sign * weight)
            else:
                weights[index] += sign * weight
            sign = self._sign()
        n = self._coordinates
        return Affine(tuple(weights[:n]), tuple(weights[n:]), sum(constants, 0.0), bool(constants))

    def _sign(self) -> float | None:
        """1 or -1 if a sign follows, else None."""
        if self._next[1] not in ("+", "-"):
            return None
        return 1.0 if self._take()[1] == "+" else -1.0

    def _term(self) -> tuple[float, int | None]:
        """(weight, variable index) of a term, with None for a constant."""
        if self._next[0] != "number":
            return 1.0, self._variable()
        value = float(self._take()[1])
        if not math.isfinite(value):
            raise self.error("a number is too large", "use SI units")
        if self._next[1] != "*":
            return value, None
        self._take()
        return value, self._variable()

    def _variable(self) -> int:
        """The index of the variable that follows, with inputs behind coordinates."""
        kind, text = self._take()
        is_input = (kind, text) == ("name", INPUT)
        if is_input:
            kind, text = self._take()
        if kind not in ("name", "quoted"):
            text_shown = shown(text) if text else "the end"
            raise self.error(f"expected a variable or a number, found {text_shown}")
        try:
            name = _written(str(json.loads(text)) if kind == "quoted" else text)
        except ValueError:
            raise self.error(f"cannot read the quoted name {shown(text)}") from None
        variable = f"{INPUT} {name}" if is_input else name
        if variable not in self._variables:
            raise self.error(f"unknown variable {shown(variable)}", choices(variable, self._variables))
        return self._variables.index(variable)


def _exact(value: float) -> str:
    return repr(float(value))


def _listed(scope: Scope) -> tuple[str, ...]:
    """The variables as expressions write them, coordinates before inputs."""
    return _names_written(tuple(scope["coordinate"]), tuple(scope["input"]))


@lru_cache(maxsize=16)  # one for all of the thousands of expressions of a file
def _names_written(coordinates: tuple[str, ...], inputs: tuple[str, ...]) -> tuple[str, ...]:
    return (*map(_written, coordinates), *(f"{INPUT} {_written(name)}" for name in inputs))


def _written(name: str) -> str:
    """A name as expressions write it."""
    if name != INPUT and _IDENTIFIER.fullmatch(name):
        return name
    return json.dumps(name, ensure_ascii=False)


def _sum(a: Sequence[float], b: Sequence[float], scope: Scope, number: Callable[[float], str]) -> str:
    text = ""
    for weight, name in zip((*a, *b), _listed(scope), strict=True):
        if weight == 0.0:
            continue
        term = name if abs(weight) == 1.0 else f"{number(abs(weight))}*{name}"
        if text:
            text += f" {'-' if weight < 0 else '+'} {term}"
        else:
            text = f"-{term}" if weight < 0 else term
    return text


def _comparison(half_space: HalfSpace, scope: Scope, number: Callable[[float], str]) -> str:
    a, b, c, strict = half_space.a, half_space.b, half_space.c, half_space.strict
    weights = [w for w in (*a, *b) if w != 0.0]
    upper = weights == [-1.0]  # a single coordinate or input from above reads better as "door < 1.2"
    if upper:
        a, b, c = tuple(-w for w in a), tuple(-w for w in b), -c
    total = _sum(a, b, scope, number)
    operator = ("<" if upper else ">") + ("" if strict else "=")
    return f"{total} {operator} {number(c + 0.0)}"


def _half_space_entry(value: Any) -> tuple[str, str | None]:
    """(text, name or None) of ``door >= 1.2`` or ``latched: door >= 1.2``."""
    if isinstance(value, str):
        return value, None
    if isinstance(value, dict) and len(value) == 1:
        ((name, text),) = value.items()
        if isinstance(name, str) and isinstance(text, str):
            return text, checked_name(name)
    raise PydanticCustomError("half_space", "expected a half-space such as 'door >= 1.2' or 'name: door >= 1.2'")


def _expression(value: Any) -> str:
    """The text of an expression, which may be a bare number in the file."""
    if isinstance(value, str):
        return value
    if isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value):
        return repr(float(value))
    raise PydanticCustomError("expression", "expected an expression such as 1.2 or 'door + 0.1'")


def _affine_of(text: str, at: Located, scope: Scope) -> Affine:
    with at.locating_errors():
        return parse_affine(text, scope)


def _affine_entry(value: Affine, scope: Scope) -> str | float:
    """The text of an expression, or the number that it is."""
    is_number = not any((*value.a, *value.b))
    return value.constant if is_number else affine_text(value.a, value.b, value.constant, scope)


def _region_of(entries: Sequence[tuple[str, str | None]], at: Located, scope: Scope) -> Region:
    half_spaces = []
    for i, (text, name) in enumerate(entries):
        with at.at(i).locating_errors():
            half_spaces.append(parse_half_space(text, scope, name))
    return Region(tuple(half_spaces))


def _region_entries(region: Region, scope: Scope) -> list[str | dict[str, str]]:
    """The entries of a region; names only where they are not the canonical ones."""
    sizes = len(scope["coordinate"]), len(scope["input"])
    entries: list[str | dict[str, str]] = []
    for half_space in region.half_spaces:
        if (len(half_space.a), len(half_space.b)) != sizes:
            raise InputError(f"automaton: half-space '{half_space.name}' has weights of another state or input size")
        text = half_space_text(half_space, scope)
        own_name = half_space.name not in ("", canonical_name(half_space, scope))
        entries.append({half_space.name: text} if own_name else text)
    return entries


Expression = Annotated[
    str, PlainValidator(_expression, json_schema_input_type=str | float), Mark(_affine_of, _affine_entry)
]
HalfSpaceEntry = Annotated[
    Any, PlainValidator(_half_space_entry, json_schema_input_type=str | Annotated[dict[str, str], Field(max_length=1)])
]
RegionEntries = Annotated[list[HalfSpaceEntry], Mark(_region_of, _region_entries)]
