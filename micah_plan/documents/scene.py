"""What is around the object and which arm holds it: the entries `scene`, `robot` and `grasp` of a problem file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from micah_plan.automaton.hybrid import HybridAutomaton, Primitive
from micah_plan.documents.joint import check_unit
from micah_plan.documents.layout import (
    IDENTITY,
    ZERO,
    Color,
    Document,
    Line,
    Name,
    Positive,
    Quaternion,
    Sizes,
    Vector3,
    doc,
    plain,
)
from micah_plan.documents.located import Located
from micah_plan.documents.parts import check_sizes
from micah_plan.documents.yaml_lines import LARGEST_TEXT_BYTES
from micah_plan.errors import InputError
from micah_plan.files import contained, read_bytes
from micah_plan.scene.body import Body, Hull, Shape
from micah_plan.scene.mesh_file import convex_corners, load_hull
from micah_plan.scene.robot_description import Grasp, RobotDescription


class BodyShapeDocument(Document):
    kind: Literal["box", "cylinder", "sphere", "mesh"] = doc("Kind of solid; a mesh is its convex hull.")
    size: Sizes | None = doc("In m. Box: full lengths x, y, z. Cylinder: radius, length along z. Sphere: radius.", None)
    path: Line | None = doc("Of a mesh: an .stl or .obj file in the problem file's folder or below it.", None)
    vertices: list[Vector3] | None = doc("Of a mesh: its corners [m] instead of a file.", None)
    scale: Vector3 = doc("Of a mesh file: factors per axis.", (1.0, 1.0, 1.0))
    position: Vector3 = doc("Centre in the body's frame [m].", ZERO)
    quaternion: Quaternion = doc("Orientation in the body's frame, scalar last.", IDENTITY)
    color: Color = doc("Colour as #rrggbb.", "#9aa5b1")


class BodyDocument(Document):
    shapes: Annotated[list[BodyShapeDocument], Field(min_length=1)] = doc("Its solids.")
    position: Vector3 = doc("Of the body's frame in the base frame [m].", ZERO)
    quaternion: Quaternion = doc("Its orientation in the base frame, scalar last.", IDENTITY)
    mass: Positive | None = doc(
        "Of a body that is loose [kg]: in MuJoCo it can be pushed over; default: it is fixed.", None
    )


class RobotDocument(Document):
    path: Line = doc("URDF or MJCF file, relative to this file.")
    tool: Name = doc("Frame that holds: a link, body or site of the robot.")
    position: Vector3 = doc("Of the robot's root in the base frame [m].", ZERO)
    quaternion: Quaternion = doc("Its orientation in the base frame, scalar last.", IDENTITY)
    held: dict[Name, float] = doc(
        "Positions of joints that do not move the tool [rad or m]; default: the middle of their range.", dict
    )
    rest: dict[Name, float] = doc("Posture to prefer [rad or m]; default: the middle of the ranges.", dict)
    packages: dict[Name, Line] = doc("Folders that `package://NAME/` in mesh paths stands for.", dict)
    srdf: Line | None = doc("SRDF file with pairs of links that need no check.", None)
    text: str | None = doc("Content of the file at `path`; plan files carry it.", None)
    srdf_text: str | None = doc("Content of the file at `srdf`; plan files carry it.", None)


class GraspDocument(Document):
    part: Name = doc("Part that the tool holds.")
    position: Vector3 = doc("Of the tool in the part's frame [m].", ZERO)
    quaternion: Quaternion = doc("Orientation of the tool in the part's frame, scalar last.", IDENTITY)


def scene_of(documents: Mapping[str, BodyDocument], located: Located, folder: Path) -> tuple[Body, ...]:
    """The bodies under the key `scene`.

    Args:
        folder: of the file; meshes lie in it or below it.

    Raises:
        InputError: for wrong numbers of sizes, quaternions not of unit length and meshes that cannot be used.
    """
    bodies = []
    for name, document in documents.items():
        check_unit(document.quaternion, located.at(name, "quaternion"))
        shapes = [_shape_of(one, located.at(name, "shapes", i), folder) for i, one in enumerate(document.shapes)]
        bodies.append(Body(name, **dict(document) | {"shapes": tuple(shapes)}))
    return tuple(bodies)


def scene_data(scene: Sequence[Body]) -> dict[str, Any]:
    """The entry of bodies, meshes with their corners, which `scene_of` reads back as the same bodies."""
    return {
        body.name: plain(BodyDocument, {**vars(body), "shapes": [_shape_data(shape) for shape in body.shapes]})
        for body in scene
    }


def robot_of(document: RobotDocument | None, located: Located, folder: Path) -> RobotDescription | None:
    """The robot under the key `robot`, with the content of its files; whether they are a robot is not checked here.

    Raises:
        InputError: if a file cannot be read.
    """
    if document is None:
        return None
    check_unit(document.quaternion, located.at("quaternion"))
    path, srdf, text = folder / document.path, document.srdf_text or "", document.text
    if document.srdf is not None:
        srdf = _text(folder / document.srdf, located.at("srdf"))
    own = {key: tuple(getattr(document, key).items()) for key in ("held", "rest", "packages")}
    return RobotDescription(
        path=document.path,
        text=_text(path, located.at("path")) if text is None else text,
        tool=document.tool,
        position=document.position,
        quaternion=document.quaternion,
        srdf=srdf,
        folder=str(path.parent),
        root=str(folder),
        **own,
    )


def robot_data(robot: RobotDescription) -> dict[str, Any]:
    """The entry of a robot with the content of its files, which `robot_of` reads back; its meshes are not in it."""
    own = {key: dict(getattr(robot, key)) for key in ("held", "rest", "packages")}
    data = plain(RobotDocument, {**vars(robot), **own, "srdf": None, "srdf_text": robot.srdf or None})
    data["text"] = data.pop("text")  # the longest last
    return data


def grasp_of(
    document: GraspDocument | None, robot: RobotDescription | None, automaton: HybridAutomaton, located: Located
) -> Grasp | None:
    """What the robot holds, if there is one.

    Args:
        located: the problem file.

    Raises:
        InputError: for a part that the model does not have, and for a robot without grasp or a grasp without robot.
    """
    if document is None:
        if robot is not None:
            raise located.at("robot").error("a robot without a grasp", "add 'grasp': say what it holds")
        return None
    located = located.at("grasp")
    if robot is None:
        raise located.error("a grasp without a robot", "add 'robot': say which robot holds it")
    check_unit(document.quaternion, located.at("quaternion"))
    located.at("part").number(document.part, [link.child for link in automaton.links], "part")
    return Grasp(**dict(document))


def grasp_data(grasp: Grasp) -> dict[str, Any]:
    """The entry of a grasp, which `grasp_of` reads back."""
    return plain(GraspDocument, grasp)


def _shape_of(document: BodyShapeDocument, located: Located, folder: Path) -> Shape:
    check_unit(document.quaternion, located.at("quaternion"))
    pose = document.position, document.quaternion, document.color
    if document.kind == "mesh":
        return Hull(_vertices_of(document, located, folder), *pose)
    for key in ("path", "vertices"):
        if getattr(document, key) is not None:
            raise located.at(key).error(f"a {document.kind} has no {key}", "write kind: mesh, or leave it out")
    if document.size is None:
        raise located.error("missing key 'size'", "add it")
    check_sizes(document.kind, document.size, located)
    return Primitive(document.kind, document.size, *pose)


def _vertices_of(document: BodyShapeDocument, located: Located, folder: Path) -> tuple[tuple[float, float, float], ...]:
    if (document.path is None) == (document.vertices is None):
        raise located.error("expected either 'path' or 'vertices' of a mesh", "name a mesh file")
    if document.size is not None:
        raise located.at("size").error("a mesh has no size", "give a scale instead")
    with located.at("vertices" if document.path is None else "path").locating_errors():
        if document.path is None:
            return convex_corners(np.array(document.vertices, dtype=float).reshape(-1, 3))
        return load_hull(contained(document.path, folder), document.scale)


def _shape_data(shape: Shape) -> dict[str, Any]:
    kind = {"kind": "mesh"} if isinstance(shape, Hull) else {}
    return plain(BodyShapeDocument, {**vars(shape), **kind}, keep={"color"})


def _text(path: Path, located: Located) -> str:
    try:
        return read_bytes(path, LARGEST_TEXT_BYTES).decode("utf-8")
    except InputError as error:
        raise located.error(f"{path}: {error.problem}", error.remedy) from None
    except UnicodeDecodeError:
        raise located.error(f"{path}: expected UTF-8 text", "give a URDF or MJCF file") from None
