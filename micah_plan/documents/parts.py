"""Parts with shapes and handles: in model files, and in files of parts alone (`models/parts/*.yaml`)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from micah_plan.automaton.hybrid import Part, Primitive
from micah_plan.automaton.joint import IDENTITY
from micah_plan.documents.fields import BY_NAME, ZERO, Color, Name, Quaternion, Sizes, Vector3
from micah_plan.documents.layout import Document, Scope, doc
from micah_plan.documents.located import Located
from micah_plan.documents.validation import validated
from micah_plan.documents.yaml_lines import read_yaml_file

_SIZES = {"box": 3, "cylinder": 2, "sphere": 1}


class ShapeDocument(Document):
    makes = Primitive

    kind: Literal["box", "cylinder", "sphere"] = doc("Kind of solid.")
    size: Sizes = doc("In m. Box: full lengths x, y, z. Cylinder: radius, length along z. Sphere: radius.")
    position: Vector3 = doc("Centre in the part's frame [m].", ZERO)
    quaternion: Quaternion = doc("Orientation in the part's frame, scalar last.", IDENTITY)
    color: Color = doc("Colour as #rrggbb.", "#9aa5b1")

    def check(self, at: Located) -> None:
        check_solid_sizes(self.kind, self.size, at)


class PartDocument(Document):
    handle: Vector3 | None = doc("Where a hand holds it, in its frame [m]; default: its origin.", None)
    shapes: list[ShapeDocument] = doc("Solids to draw and to simulate.", list)

    def read(self, at: Located, scope: Scope) -> Part:
        return Part(at.name, **self.meanings(at, scope))


class PartsDocument(Document):
    """Shapes and handles of an object's parts, to be added to a learned model."""

    format: Literal["micah-plan/parts/1"] = doc("Format and version of this file.")
    parts: Annotated[dict[Name, PartDocument], Field(min_length=1), BY_NAME] = doc(
        "By part name; `base` is what does not move."
    )


def load_parts(path: str | Path) -> tuple[Part, ...]:
    """The parts that a file of parts describes; `learn` adds them to a model.

    Raises:
        InputError: if it cannot be used; one line with file, line, key, expected and found content, and the remedy.
    """
    located = read_yaml_file(path)
    parts: tuple[Part, ...] = validated(located, PartsDocument).meanings(located, {})["parts"]
    return parts


def check_solid_sizes(kind: str, size: Sequence[float], located: Located) -> None:
    """Raise an InputError unless a solid has as many sizes as its kind needs."""
    if len(size) != _SIZES[kind]:
        problem = f"expected {_SIZES[kind]} sizes of a {kind}, found {len(size)}"
        raise located.at("size").error(problem, "a box has 3, a cylinder 2, a sphere 1")
