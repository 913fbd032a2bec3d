"""The kinds of field that model, problem and plan files are made of."""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, PlainValidator
from pydantic_core import PydanticCustomError

_LONGEST_NAME = 100
_A_NAME = "expected a name of 1 to 100 printable characters without spaces around it"


class Document(BaseModel):
    """Base of everything read from a file: unknown keys are errors, types are not converted, numbers are finite."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)


def _printable(value: str) -> str:
    if not value.isprintable():
        raise PydanticCustomError("printable", "expected printable characters on one line")
    return value


def _name(value: str) -> str:
    if not value or value != value.strip() or not value.isprintable() or len(value) > _LONGEST_NAME:
        raise PydanticCustomError("name", _A_NAME)
    return value


def _half_space_entry(value: Any) -> tuple[str, str | None]:
    """(text, name or None) of ``door >= 1.2`` or ``latched: door >= 1.2``."""
    if isinstance(value, str):
        return value, None
    if isinstance(value, dict) and len(value) == 1:
        ((name, text),) = value.items()
        if isinstance(name, str) and isinstance(text, str):
            return text, _name(name)
    raise PydanticCustomError("half_space", "expected a half-space such as 'door >= 1.2' or 'name: door >= 1.2'")


def _expression(value: Any) -> str:
    """The text of an expression, which may be a bare number in the file."""
    if isinstance(value, str):
        return value
    if isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value):
        return repr(float(value))
    raise PydanticCustomError("expression", "expected an expression such as 1.2 or 'door + 0.1'")


Name = Annotated[str, AfterValidator(_name)]
Line = Annotated[str, AfterValidator(_printable)]
Positive = Annotated[float, Field(gt=0)]
NonNegative = Annotated[float, Field(ge=0)]
# Not strict about tuple or list (files have lists); their numbers stay strict.
Vector3 = Annotated[tuple[float, float, float], Field(strict=False)]
Quaternion = Annotated[tuple[float, float, float, float], Field(strict=False)]
Row = Annotated[list[float], Field(min_length=1)]
Matrix = Annotated[list[Row], Field(min_length=1)]
Unit = Literal["rad", "m"]
Expression = Annotated[str, PlainValidator(_expression, json_schema_input_type=str | float)]
HalfSpaceEntry = Annotated[
    Any, PlainValidator(_half_space_entry, json_schema_input_type=str | Annotated[dict[str, str], Field(max_length=1)])
]
RegionEntries = list[HalfSpaceEntry]
