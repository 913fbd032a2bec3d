"""What layouts of files are made of: kinds of field, the keys that a layout allows, and values written by a layout."""

from __future__ import annotations

import types
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Literal, Union, get_args, get_origin

import numpy as np
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, GetCoreSchemaHandler
from pydantic_core import PydanticCustomError, core_schema

from micah_plan.errors import InputError

_LONGEST_NAME = 100


class Document(BaseModel):
    """Base of every layout: unknown keys are errors, types are not converted, numbers are finite.

    Keys are called like the attributes of the values that they become, wherever both mean the same. Then
    ``Value(**dict(document))`` reads an entry and `plain` writes it.
    """

    # Validators are built when a file is first read with them, and only those that this file needs.
    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False, defer_build=True)


def doc(description: str, default: Any = ..., **further: Any) -> Any:
    """A key of a layout.

    Args:
        description: what it means, with its unit.
        default: what holds where it is left out, a type for what calling it makes; none: the key is required.
        further: as of `pydantic.Field`.
    """
    made = {"default_factory": default} if isinstance(default, type) else {"default": default}
    return Field(**made, description=description, **further)


def _printable(value: str) -> str:
    if not value.isprintable():
        raise PydanticCustomError("printable", "expected printable characters on one line")
    return value


def checked_name(value: str) -> str:
    """The name, if it is one; else the error that a validator may raise."""
    if not value or value != value.strip() or not value.isprintable() or len(value) > _LONGEST_NAME:
        raise PydanticCustomError("name", "expected a name of 1 to 100 printable characters without spaces around it")
    return value


@dataclass(frozen=True)
class Listed:
    """Marks a tuple of any length that is a list in the file, of at least and at most so many entries."""

    least: int | None = None
    most: int | None = None

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> core_schema.CoreSchema:
        entry = handler.generate_schema(get_args(source)[0])
        entries = core_schema.list_schema(entry, min_length=self.least, max_length=self.most)
        return core_schema.no_info_after_validator_function(tuple, entries)


Name = Annotated[str, AfterValidator(checked_name)]
Line = Annotated[str, AfterValidator(_printable)]
Positive = Annotated[float, Field(gt=0)]
NonNegative = Annotated[float, Field(ge=0)]
Probability = Annotated[float, Field(ge=0, le=1)]
Count = Annotated[int, Field(ge=0)]
# Not strict about tuple or list: files have lists, values have tuples. What is in them stays strict.
Vector3 = Annotated[tuple[float, float, float], Field(strict=False)]
Quaternion = Annotated[tuple[float, float, float, float], Field(strict=False)]
Names = Annotated[tuple[Name, ...], Listed()]
Lines = Annotated[tuple[Line, ...], Listed()]
Row = Annotated[tuple[float, ...], Listed(1)]
Matrix = Annotated[tuple[Row, ...], Listed(1)]
Sizes = Annotated[tuple[Positive, ...], Listed(1, 3)]
Color = Annotated[str, Field(pattern=r"^#[0-9a-fA-F]{6}$")]
Unit = Literal["rad", "m"]

ZERO: Vector3 = (0.0, 0.0, 0.0)
IDENTITY: Quaternion = (0.0, 0.0, 0.0, 1.0)


def plain(layout: type[Document], value: object, keep: Collection[str] = ()) -> dict[str, Any]:
    """Plain data of a value as its layout says, in the layout's order and without what is the layout's default.

    Args:
        value: its attributes are called like the layout's keys, or it is a mapping of them. What an inner layout
            describes may be a value as well; a mapping in its place is plain data and taken as it is.
        keep: keys to write even where their value is the default.
    """
    given = value if isinstance(value, Mapping) else {key: getattr(value, key) for key in layout.model_fields}
    data = {}
    for key, field in layout.model_fields.items():
        if key in given:
            data[key] = _plain(field.annotation, given[key])
            if key not in keep and not field.is_required():
                default = _plain(field.annotation, field.get_default(call_default_factory=True))
                if data[key] == default:
                    del data[key]
    return data


def _plain(annotation: Any, value: Any) -> Any:
    """Plain data of a value of one kind of field; numbers become plain Python numbers."""
    kind = _stripped(annotation)
    if value is None or (is_document(kind) and isinstance(value, Mapping)):
        return value
    if kind in (float, int, bool):
        return kind(value)
    if isinstance(value, np.ndarray):
        return value.tolist()
    if is_document(kind):
        return plain(kind, value)
    if isinstance(value, Mapping):
        return {key: _plain(_of_entries(kind), item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(_of_entries(kind), item) for item in value]
    return value


def unique(items: Iterable[tuple[str, Any]]) -> dict[str, Any]:
    """Named entries of an automaton as a mapping.

    Raises:
        InputError: if a name is used twice.
    """
    result: dict[str, Any] = {}
    for name, value in items:
        if name in result:
            raise InputError(f"automaton: the name '{name}' is used twice", remedy="names are unique")
        result[name] = value
    return result


def kind_at(kind: Any, path: Sequence[str | int]) -> Any:
    """The kind of value that a layout has at a key path, whatever names its mappings have; None if it can have none."""
    kind = _stripped(kind)
    for key in path:
        if is_document(kind):
            kind = kind.model_fields[key].annotation if key in kind.model_fields else None
        elif get_origin(kind) is dict or (get_origin(kind) in (list, tuple) and str(key).isdigit()):
            kind = _of_entries(kind)
        elif kind is not Any:
            return None
        kind = _stripped(kind)
    return kind


def dotted_paths(kind: Any, prefix: str = "") -> Iterator[str]:
    """The dotted paths of all values that a layout has, without those below mappings and lists."""
    kind = _stripped(kind)
    if is_document(kind):
        for name, field in kind.model_fields.items():
            yield prefix + name
            yield from dotted_paths(field.annotation, f"{prefix}{name}.")


def is_document(kind: Any) -> bool:
    """Whether a kind of value is an entry with a layout of its own."""
    return isinstance(kind, type) and issubclass(kind, Document)


def _of_entries(kind: Any) -> Any:
    """The kind of the entries of a mapping, list or tuple; Any for other kinds."""
    arguments = get_args(kind)
    if get_origin(kind) is dict:
        return arguments[1]
    return arguments[0] if get_origin(kind) in (list, tuple) else Any


def _stripped(annotation: Any) -> Any:
    """An annotation without Annotated and `| None`."""
    if get_origin(annotation) is Annotated:
        return _stripped(get_args(annotation)[0])
    if get_origin(annotation) in (Union, types.UnionType):
        return _stripped(next(kind for kind in get_args(annotation) if kind is not type(None)))
    return annotation
