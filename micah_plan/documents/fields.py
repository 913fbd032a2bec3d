"""Shared entries of layouts: bounded numbers, names, lists as tuples, and references by name."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Literal, TypeVar, get_args

import numpy as np
from pydantic import AfterValidator, Field, GetCoreSchemaHandler
from pydantic_core import PydanticCustomError, core_schema

from micah_plan.arrays import EQUAL, TINY
from micah_plan.documents.layout import Mark, Scope, unique
from micah_plan.documents.located import Located
from micah_plan.errors import InputError
from micah_plan.quantities import LARGEST

T = TypeVar("T")
_LONGEST_NAME = 100
_UNIT_TOLERANCE = 1e-3
# Beyond these a number is a mistake of units or of keys, not a place, a spread or a quantity in SI units.
LARGEST_STD = 1e3
_LARGEST_QUANTITY = 1e12

ITEMS = Mark(lambda mapping, *_: tuple(mapping.items()), lambda pairs, _: unique(pairs))
"""A mapping; in the value a tuple of (key, entry)."""
BY_NAME = Mark(lambda mapping, *_: tuple(mapping.values()), lambda values, _: unique((v.name, v) for v in values))
"""A mapping of entries whose values know their name; in the value a tuple of them."""
NonNegative = Annotated[float, Field(ge=0, le=_LARGEST_QUANTITY)]
# Configurations and positions, distances and spreads, each in m or rad.
Place = Annotated[float, Field(ge=-LARGEST, le=LARGEST)]
StdOrZero = Annotated[float, Field(ge=0, le=LARGEST_STD)]
Probability = Annotated[float, Field(ge=0, le=1)]
Count = Annotated[int, Field(ge=0)]
# Not strict about tuple or list: files have lists, values have tuples. What is in them stays strict.
Vector3 = Annotated[tuple[Place, Place, Place], Field(strict=False)]
Digest = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
Color = Annotated[str, Field(pattern=r"^#[0-9a-fA-F]{6}$")]
Unit = Literal["rad", "m"]

ZERO: tuple[float, float, float] = (0.0, 0.0, 0.0)


def _printable(value: str) -> str:
    if not value.isprintable():
        raise PydanticCustomError("printable", "expected printable characters on one line")
    return value


def checked_name(value: str) -> str:
    """The name if valid; else the error for a validator to raise."""
    if not value or value != value.strip() or not value.isprintable() or len(value) > _LONGEST_NAME:
        raise PydanticCustomError("name", "expected a name of 1 to 100 printable characters without spaces around it")
    return value


def _above_rounding(value: float) -> float:
    if value < TINY:
        raise PydanticCustomError("tiny", "expected a number >= 1e-12, smaller ones are lost in rounding")
    return value


@dataclass(frozen=True)
class Listed:
    """Marks a tuple of any length as a list in the file, with a minimum and maximum number of entries."""

    least: int | None = None
    most: int | None = None

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> core_schema.CoreSchema:
        entry = handler.generate_schema(get_args(source)[0])
        entries = core_schema.list_schema(entry, min_length=self.least, max_length=self.most)
        return core_schema.no_info_after_validator_function(tuple, entries)


def named(what: str) -> Mark:
    """An entry that is a name of the scope."""
    return Mark(lambda name, at, scope: at.named(name, scope[what], what))


def numbered(what: str) -> Mark:
    """An entry that is a name of the scope, stored as its index."""
    return Mark(lambda name, at, scope: at.number(name, scope[what], what), lambda number, scope: scope[what][number])


def each(what: str, entry: str = "value", default: object = None) -> Mark:
    """A mapping with an entry for every name of the scope, stored as a tuple in their order.

    Args:
        default: the entry of a name that is left out; None: none may be.
    """

    def read(entries: Mapping[str, Any], at: Located, scope: Scope) -> tuple[Any, ...]:
        others = {} if default is None else dict.fromkeys(scope[what], default)
        return at.in_order({**others, **entries}, scope[what], what, entry)

    def written(values: Sequence[Any], scope: Scope) -> dict[str, Any]:
        if len(values) != len(scope[what]):
            problem = f"automaton: expected one {entry} per {what}, {len(scope[what])}, found {len(values)}"
            raise InputError(problem, remedy="check its values")
        return dict(zip(scope[what], values, strict=True))

    return Mark(read, written)


def of_unit_length(vector: Sequence[float], at: Located, _: Scope | None = None) -> Sequence[float]:
    """The vector if its length is 1 within a thousandth; else an InputError."""
    length = float(np.linalg.norm(vector))
    if abs(length - 1.0) > _UNIT_TOLERANCE:
        raise at.error(f"expected unit length, found length {length:.6g}", "normalise it")
    return vector


def check_covariance(rows: Sequence[Sequence[float]], at: Located) -> None:
    """Raise an InputError unless a square matrix is a covariance: symmetric, no variance below 0, none too large."""
    matrix = np.array(rows, dtype=float)
    scale = float(np.abs(matrix).max())
    if scale > LARGEST**2:
        raise at.error(f"expected variances of at most {LARGEST**2:g}, found {scale:g}", "give it in m and rad")
    symmetric = np.abs(matrix - matrix.T).max() <= EQUAL * scale
    lowest = 0.0 if scale == 0.0 else float(np.linalg.eigvalsh(matrix / scale)[0])
    if not symmetric or lowest < -EQUAL:
        found = f"the eigenvalue {lowest * scale:.3g}" if symmetric else "one that is not symmetric"
        problem = f"expected a symmetric positive semi-definite matrix, found {found}"
        raise at.error(problem, "correct it or leave the covariance out")


Name = Annotated[str, AfterValidator(checked_name)]
Line = Annotated[str, AfterValidator(_printable)]
Positive = Annotated[float, Field(gt=0, le=_LARGEST_QUANTITY), AfterValidator(_above_rounding)]
Distance = Annotated[float, Field(gt=0, le=LARGEST), AfterValidator(_above_rounding)]
Std = Annotated[float, Field(gt=0, le=LARGEST_STD), AfterValidator(_above_rounding)]
Quaternion = Annotated[tuple[float, float, float, float], Field(strict=False), Mark(of_unit_length)]
Names = Annotated[tuple[Name, ...], Listed()]
Lines = Annotated[tuple[Line, ...], Listed()]
Row = Annotated[tuple[float, ...], Listed(1)]
Matrix = Annotated[tuple[Row, ...], Listed(1)]
Sizes = Annotated[tuple[Distance, ...], Listed(1, 3)]
ModeName = Annotated[Name, named("mode")]
ModeNames = Annotated[tuple[ModeName, ...], Listed()]
PartName = Annotated[Name, named("part")]
CoordinateName = Annotated[Name, numbered("coordinate")]
EachCoordinate = Annotated[dict[Name, T], each("coordinate")]
EachInput = Annotated[dict[Name, T], each("input")]
