"""Parts, their shapes and handles: in model files, and in files of parts alone (`models/parts/*.yaml`)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from micah_plan.automaton.hybrid import Part, Primitive
from micah_plan.documents.joint import check_unit
from micah_plan.documents.layout import (
    IDENTITY,
    ZERO,
    Color,
    Document,
    Name,
    Quaternion,
    Sizes,
    Vector3,
    doc,
    plain,
    unique,
)
from micah_plan.documents.located import Located
from micah_plan.documents.validation import validated
from micah_plan.documents.yaml_lines import read_yaml_file

_SIZES = {"box": 3, "cylinder": 2, "sphere": 1}


class ShapeDocument(Document):
    kind: Literal["box", "cylinder", "sphere"] = doc("Kind of solid.")
    size: Sizes = doc("In m. Box: full lengths x, y, z. Cylinder: radius, length along z. Sphere: radius.")
    position: Vector3 = doc("Centre in the part's frame [m].", ZERO)
    quaternion: Quaternion = doc("Orientation in the part's frame, scalar last.", IDENTITY)
    color: Color = doc("Colour as #rrggbb.", "#9aa5b1")


class PartDocument(Document):
    handle: Vector3 | None = doc("Where a hand holds it, in its frame [m]; default: its origin.", None)
    shapes: list[ShapeDocument] = doc("Solids to draw and to simulate.", list)


class PartsDocument(Document):
    """Shapes and handles of an object's parts, to be added to a learned model."""

    format: Literal["micah-plan/parts/1"] = doc("Format and version of this file.")
    parts: Annotated[dict[Name, PartDocument], Field(min_length=1)] = doc("By part name; `base` is what does not move.")


def load_parts(path: str | Path) -> tuple[Part, ...]:
    """The parts that a file of parts describes; `learn` adds them to a model.

    Raises:
        InputError: if it cannot be used; one line names file, line, key, what was expected and found, and the remedy.
    """
    located = read_yaml_file(path)
    return parts_of(validated(located, PartsDocument).parts, located.at("parts"))


def parts_of(documents: Mapping[str, PartDocument], located: Located) -> tuple[Part, ...]:
    """The parts under the key `parts` of a file.

    Raises:
        InputError: if a shape has the wrong number of sizes or a quaternion is not of unit length.
    """
    return tuple(
        Part(name, shapes_of(part.shapes, located.at(name, "shapes")), part.handle) for name, part in documents.items()
    )


def parts_data(parts: Sequence[Part]) -> dict[str, Any]:
    """The entry `parts`, which `parts_of` reads back."""
    return unique((part.name, plain(PartDocument, part)) for part in parts)


def shapes_of(documents: Sequence[ShapeDocument], located: Located) -> tuple[Primitive, ...]:
    """The solids of a list; `plain` writes them.

    Raises:
        InputError: if one has the wrong number of sizes or its quaternion is not of unit length.
    """
    for i, shape in enumerate(documents):
        check_sizes(shape.kind, shape.size, located.at(i))
        check_unit(shape.quaternion, located.at(i, "quaternion"))
    return tuple(Primitive(**dict(shape)) for shape in documents)


def check_sizes(kind: str, size: Sequence[float], located: Located) -> None:
    """Raise an InputError unless a solid has as many sizes as its kind needs."""
    if len(size) != _SIZES[kind]:
        problem = f"expected {_SIZES[kind]} sizes of a {kind}, found {len(size)}"
        raise located.at("size").error(problem, "a box has 3, a cylinder 2, a sphere 1")
