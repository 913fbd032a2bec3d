"""The layout of parts: shapes and handles, in model files and in files of parts, `format: micah-plan/parts/1`."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from micah_plan.documents.fields import Document, Name, Positive, Quaternion, Vector3

IDENTITY: Quaternion = (0.0, 0.0, 0.0, 1.0)
ZERO: Vector3 = (0.0, 0.0, 0.0)


class ShapeDocument(Document):
    kind: Literal["box", "cylinder", "sphere"] = Field(description="Kind of solid.")
    size: Annotated[list[Positive], Field(min_length=1, max_length=3)] = Field(
        description="In m. Box: full lengths x, y, z. Cylinder: radius, length along z. Sphere: radius."
    )
    position: Vector3 = Field(default=ZERO, description="Centre in the part's frame [m].")
    quaternion: Quaternion = Field(default=IDENTITY, description="Orientation in the part's frame, scalar last.")
    color: str = Field(default="#9aa5b1", pattern=r"^#[0-9a-fA-F]{6}$", description="Colour as #rrggbb.")


class PartDocument(Document):
    handle: Vector3 | None = Field(
        default=None, description="Where a hand holds it, in its frame [m]; default: its origin."
    )
    shapes: list[ShapeDocument] = Field(default_factory=list, description="Solids to draw and to simulate.")


class PartsDocument(Document):
    """Shapes and handles of an object's parts, to be added to a learned model."""

    format: Literal["micah-plan/parts/1"] = Field(description="Format and version of this file.")
    parts: Annotated[dict[Name, PartDocument], Field(min_length=1)] = Field(
        description="By part name; `base` is what does not move."
    )
