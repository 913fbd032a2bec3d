"""The surroundings and the arm: entries `scene`, `robot` and `grasp` of a problem file."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field

from micah_plan.automaton.hybrid import Primitive
from micah_plan.automaton.joint import IDENTITY
from micah_plan.documents.fields import (
    ITEMS,
    ZERO,
    Color,
    Line,
    Name,
    PartName,
    Positive,
    Quaternion,
    Sizes,
    Vector3,
)
from micah_plan.documents.layout import Document, Scope, doc
from micah_plan.documents.located import Located
from micah_plan.documents.parts import check_solid_sizes
from micah_plan.documents.yaml_lines import LARGEST_TEXT_BYTES
from micah_plan.errors import InputError, choices, pip_install, shown
from micah_plan.files import contained, read_bytes
from micah_plan.task.body import Body, Hull, Shape
from micah_plan.task.mesh_file import convex_corners, load_hull
from micah_plan.task.named_robots import is_name, named_robots
from micah_plan.task.robot_description import Grasp, RobotDescription
from micah_plan.xml_text import Element, parse_xml, write_xml


class BodyShapeDocument(Document):
    always_written = ("color",)

    kind: Literal["box", "cylinder", "sphere", "mesh"] = doc("Kind of solid; a mesh is its convex hull.")
    size: Sizes | None = doc("In m. Box: full lengths x, y, z. Cylinder: radius, length along z. Sphere: radius.", None)
    path: Line | None = doc("Mesh: an .stl or .obj file in the problem file's folder or below it.", None)
    vertices: list[Vector3] | None = doc("Mesh: its corners [m] instead of a file.", None)
    scale: Vector3 = doc("Mesh file: scale factors per axis.", (1.0, 1.0, 1.0))
    position: Vector3 = doc("Centre in the body's frame [m].", ZERO)
    quaternion: Quaternion = doc("Orientation in the body's frame, scalar last.", IDENTITY)
    color: Color = doc("Colour as #rrggbb.", "#9aa5b1")

    def read(self, at: Located, scope: Scope) -> Shape:
        values = self.meanings(at, scope)
        pose = {key: values[key] for key in ("position", "quaternion", "color")}
        if self.kind == "mesh":
            return Hull(self._vertices(at), **pose)
        for key in ("path", "vertices"):
            if values[key] is not None:
                raise at.at(key).error(f"a {self.kind} has no {key}", "write kind: mesh, or leave it out")
        if self.size is None:
            raise at.error("missing key 'size'", "add it")
        check_solid_sizes(self.kind, self.size, at)
        return Primitive(self.kind, self.size, **pose)

    def _vertices(self, at: Located) -> tuple[tuple[float, float, float], ...]:
        if (self.path is None) == (self.vertices is None):
            raise at.error("expected either 'path' or 'vertices' of a mesh", "name a mesh file")
        if self.size is not None:
            raise at.at("size").error("a mesh has no size", "give a scale instead")
        with at.at("vertices" if self.path is None else "path").locating_errors():
            if self.path is None:
                return convex_corners(np.array(self.vertices, dtype=float).reshape(-1, 3))
            return load_hull(contained(self.path, at.folder), self.scale)

    @classmethod
    def written(cls, value: Shape, scope: Scope) -> Mapping[str, Any]:
        """Meshes are written as their corners."""
        return {**vars(value), **({"kind": "mesh"} if isinstance(value, Hull) else {})}


class BodyDocument(Document):
    shapes: Annotated[list[BodyShapeDocument], Field(min_length=1)] = doc("Its solids.")
    position: Vector3 = doc("Position of the body's frame in the base frame [m].", ZERO)
    quaternion: Quaternion = doc("Its orientation in the base frame, scalar last.", IDENTITY)
    mass: Positive | None = doc(
        "Mass of a loose body [kg]: in MuJoCo it can be pushed over; default: it is fixed.", None
    )

    def read(self, at: Located, scope: Scope) -> Body:
        return Body(at.name, **self.meanings(at, scope))


class RobotDocument(Document):
    renamed: ClassVar = {"held": "locked"}

    path: Line = doc(
        "URDF or MJCF file, relative to this file; or a robot of the extra `robots` by name: `panda`, `ur5_robot`."
    )
    tool: Name = doc("Frame that holds the part: a link, body or site of the robot.")
    position: Vector3 = doc("Position of the robot's root in the base frame [m].", ZERO)
    quaternion: Quaternion = doc("Its orientation in the base frame, scalar last.", IDENTITY)
    held: Annotated[dict[Name, float], ITEMS] = doc(
        "Positions of joints that do not move the tool [rad or m]; default: the middle of their range.", dict
    )
    rest: Annotated[dict[Name, float], ITEMS] = doc(
        "Posture to prefer [rad or m]; default: the middle of the ranges.", dict
    )
    packages: Annotated[dict[Name, Line], ITEMS] = doc("Folders that `package://NAME/` in mesh paths stands for.", dict)
    srdf: Line | None = doc("SRDF file with pairs of links that need no check.", None)
    text: str | None = doc("Content of the file at `path`; plan files carry it.", None)
    srdf_text: str | None = doc("Content of the file at `srdf`; plan files carry it.", None)

    def read(self, at: Located, scope: Scope) -> RobotDescription:
        """The robot with the content of its files, unvalidated."""
        values = self.meanings(at, scope)
        path, srdf, text = _robot_file(self.path, at), values.pop("srdf_text") or "", values.pop("text")
        if self.srdf is not None:
            srdf = _text(at.folder / self.srdf, at.at("srdf"))
        with at.at("srdf").locating_errors():
            srdf = _pairs(srdf, self.srdf or "srdf_text")
        text = _text(path, at.at("path")) if text is None else text
        values |= {"text": text, "srdf": srdf, "folder": str(path.parent), "root": str(at.folder)}
        return RobotDescription(**values)

    @classmethod
    def written(cls, value: RobotDescription, scope: Scope) -> Mapping[str, Any]:
        """The robot's data with the content of its files except for the meshes."""
        return {**vars(value), "held": value.locked, "srdf": None, "srdf_text": value.srdf or None}


class GraspDocument(Document):
    makes = Grasp

    part: PartName = doc("Part that the tool holds.")
    position: Vector3 = doc("Position of the tool in the part's frame [m].", ZERO)
    quaternion: Quaternion = doc("Orientation of the tool in the part's frame, scalar last.", IDENTITY)


def _robot_file(path: str, at: Located) -> Path:
    """The path of the file, or of the installed robot of this name."""
    beside = at.folder / path
    if not is_name(path) or beside.exists():
        return beside
    robots = named_robots()
    if path in robots:
        return robots[path]
    problem = f"there is no file {shown(path)} next to this one, and no robot of that name"
    if robots:
        raise at.at("path").error(problem, choices(path, robots))
    raise at.at("path").error(problem, f"robots by name need a package: {pip_install('robots')}")


def _pairs(srdf: str, source: str) -> str:
    """The used part of an SRDF, which alone goes into plans."""
    if not srdf:
        return ""
    root = parse_xml(srdf, source)
    if root.tag != "robot":
        raise root.error(f"expected an SRDF with the root <robot>, found <{root.tag}>", "name the SRDF of the robot")
    links = ("link1", "link2")
    pairs = [{key: element.attributes.get(key, "") for key in links} for element in root.all("disable_collisions")]
    return write_xml(Element("robot", {}, 1, [Element("disable_collisions", pair, 1) for pair in pairs]))


def _text(path: Path, located: Located) -> str:
    try:
        return read_bytes(path, LARGEST_TEXT_BYTES).decode("utf-8")
    except InputError as error:
        raise located.error(f"{path}: {error.problem}", error.remedy) from None
    except UnicodeDecodeError:
        raise located.error(f"{path}: expected UTF-8 text", "give a URDF or MJCF file") from None
