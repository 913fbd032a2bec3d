"""The layout of the blocks `scene`, `robot` and `grasp` of a problem file."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from micah_plan.documents.fields import Document, Line, Name, Positive, Quaternion, Vector3
from micah_plan.documents.part_document import IDENTITY, ZERO


class BodyShapeDocument(Document):
    kind: Literal["box", "cylinder", "sphere", "mesh"] = Field(description="Kind of solid; a mesh is its convex hull.")
    size: Annotated[list[Positive], Field(min_length=1, max_length=3)] | None = Field(
        default=None, description="In m. Box: full lengths x, y, z. Cylinder: radius, length along z. Sphere: radius."
    )
    path: Line | None = Field(
        default=None, description="Of a mesh: an .stl or .obj file in the problem file's folder or below it."
    )
    vertices: list[Vector3] | None = Field(default=None, description="Of a mesh: its corners [m] instead of a file.")
    scale: Vector3 = Field(default=(1.0, 1.0, 1.0), description="Of a mesh file: factors per axis.")
    position: Vector3 = Field(default=ZERO, description="Centre in the body's frame [m].")
    quaternion: Quaternion = Field(default=IDENTITY, description="Orientation in the body's frame, scalar last.")
    color: str = Field(default="#9aa5b1", pattern=r"^#[0-9a-fA-F]{6}$", description="Colour as #rrggbb.")


class BodyDocument(Document):
    shapes: Annotated[list[BodyShapeDocument], Field(min_length=1)] = Field(description="Its solids.")
    position: Vector3 = Field(default=ZERO, description="Of the body's frame in the base frame [m].")
    quaternion: Quaternion = Field(default=IDENTITY, description="Its orientation in the base frame, scalar last.")
    mass: Positive | None = Field(
        default=None, description="Of a body that is loose [kg]: in MuJoCo it can be pushed over; default: it is fixed."
    )


class RobotDocument(Document):
    path: Line = Field(description="URDF or MJCF file, relative to this file.")
    tool: Name = Field(description="Frame that holds: a link, body or site of the robot.")
    position: Vector3 = Field(default=ZERO, description="Of the robot's root in the base frame [m].")
    quaternion: Quaternion = Field(default=IDENTITY, description="Its orientation in the base frame, scalar last.")
    held: dict[Name, float] = Field(
        default_factory=dict,
        description="Positions of joints that do not move the tool [rad or m]; default: the middle of their range.",
    )
    rest: dict[Name, float] = Field(
        default_factory=dict, description="Posture to prefer [rad or m]; default: the middle of the ranges."
    )
    packages: dict[Name, Line] = Field(
        default_factory=dict, description="Folders that `package://NAME/` in mesh paths stands for."
    )
    srdf: Line | None = Field(default=None, description="SRDF file with pairs of links that need no check.")
    text: str | None = Field(default=None, description="Content of the file at `path`; plan files carry it.")
    srdf_text: str | None = Field(default=None, description="Content of the file at `srdf`; plan files carry it.")


class GraspDocument(Document):
    part: Name = Field(description="Part that the tool holds.")
    position: Vector3 = Field(default=ZERO, description="Of the tool in the part's frame [m].")
    quaternion: Quaternion = Field(
        default=IDENTITY, description="Orientation of the tool in the part's frame, scalar last."
    )
