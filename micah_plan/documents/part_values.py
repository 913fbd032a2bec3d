"""Documents of parts -> parts with their shapes, in model files and in files of parts alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from micah_plan.automaton.hybrid import Part, Primitive
from micah_plan.documents.located import KeyPath, Located
from micah_plan.documents.part_document import PartDocument, ShapeDocument

_UNIT_TOLERANCE = 1e-3
_SIZES = {"box": 3, "cylinder": 2, "sphere": 1}


def parts_of(documents: Mapping[str, PartDocument], located: Located) -> tuple[Part, ...]:
    """The parts under the key `parts` of a file.

    Raises:
        InputError: if a shape has the wrong number of sizes or a quaternion is not of unit length.
    """
    return tuple(
        Part(
            name,
            tuple(shape_of(shape, located, ("parts", name, "shapes", i)) for i, shape in enumerate(part.shapes)),
            part.handle,
        )
        for name, part in documents.items()
    )


def check_unit(located: Located, vector: Sequence[float], path: KeyPath) -> None:
    """Raise an InputError unless a vector has unit length within a thousandth."""
    length = float(np.linalg.norm(vector))
    if abs(length - 1.0) > _UNIT_TOLERANCE:
        raise located.error(path, f"expected unit length, found length {length:.6g}", "normalise it")


def check_sizes(kind: str, size: Sequence[float], located: Located, path: KeyPath) -> None:
    """Raise an InputError unless a solid has as many sizes as its kind needs."""
    if len(size) != _SIZES[kind]:
        problem = f"expected {_SIZES[kind]} sizes of a {kind}, found {len(size)}"
        raise located.error((*path, "size"), problem, "a box has 3, a cylinder 2, a sphere 1")


def shape_of(shape: ShapeDocument, located: Located, path: KeyPath) -> Primitive:
    """The solid that an entry describes.

    Raises:
        InputError: if it has the wrong number of sizes or its quaternion is not of unit length.
    """
    check_sizes(shape.kind, shape.size, located, path)
    check_unit(located, shape.quaternion, (*path, "quaternion"))
    return Primitive(shape.kind, tuple(shape.size), shape.position, shape.quaternion, shape.color)
