"""The layout of the block `hold` of a problem file: how a hand holds the object, and what it may touch."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from micah_plan.documents.fields import Document, Name, Positive, Vector3
from micah_plan.documents.part_document import ShapeDocument


class HeldPartDocument(Document):
    name: Name = Field(description="Of the part.")
    shapes: Annotated[list[ShapeDocument], Field(min_length=1)] = Field(
        description="Its solids in the hinge frame, with the joint at the datum: y along the hinge, the moving part "
        "turns from x towards z as the joint's coordinate grows."
    )


class ReachDocument(Document):
    lower: Vector3 = Field(description="Lower corner [m].")
    upper: Vector3 = Field(description="Upper corner [m].")


class ContactDocument(Document):
    body: Name = Field(description="Body of the scene.")
    face: Literal["+x", "-x", "+y", "-y", "+z", "-z"] = Field(description="Which side of it, by where it looks.")


class HoldDocument(Document):
    held: HeldPartDocument = Field(description="The part in the hand.")
    moving: HeldPartDocument = Field(description="The part that swings.")
    point: Vector3 = Field(description="Where the hand is, in the hinge frame [m]; its position is the state x, y, z.")
    rotation: Vector3 = Field(
        default=(0.0, 0.0, 0.0), description="Rotation vector from the hinge frame to the base frame [rad]."
    )
    travel: Positive = Field(description="How far the joint opens from the datum [rad or m].")
    pivots: bool = Field(default=False, description="Whether the held part may turn in the hand when pressed on.")
    datum: float | None = Field(
        default=None, description="Configuration at which shapes are given [rad or m]; default: where it latches."
    )
    coordinate: Name = Field(default="theta", description="Name of the joint's coordinate in this problem.")
    reach: ReachDocument = Field(description="Where the hand may go.")
    contacts: list[ContactDocument] = Field(
        default_factory=list, description="Faces that the moving part may touch; anything else is to be kept clear of."
    )
