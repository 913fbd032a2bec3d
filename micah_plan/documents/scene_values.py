"""The blocks `scene`, `robot` and `grasp` of a problem file as values, and back."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from micah_plan.automaton.hybrid import HybridAutomaton, Primitive
from micah_plan.automaton.joint import IDENTITY
from micah_plan.documents.located import KeyPath, Located
from micah_plan.documents.part_values import check_sizes, check_unit
from micah_plan.documents.scene_document import BodyDocument, BodyShapeDocument, GraspDocument, RobotDocument
from micah_plan.documents.yaml_lines import LARGEST_TEXT_BYTES
from micah_plan.errors import InputError
from micah_plan.files import contained, read_bytes
from micah_plan.scene.body import Body, Hull, Shape
from micah_plan.scene.mesh_file import convex_corners, load_hull
from micah_plan.scene.robot_description import Grasp, RobotDescription

ZERO = (0.0, 0.0, 0.0)


def scene_of(documents: Mapping[str, BodyDocument], located: Located, folder: Path) -> tuple[Body, ...]:
    """The bodies under the key `scene`.

    Args:
        folder: of the file; meshes lie in it or below it.

    Raises:
        InputError: for wrong numbers of sizes, quaternions not of unit length and meshes that cannot be used.
    """
    bodies = []
    for name, document in documents.items():
        path: KeyPath = ("scene", name)
        check_unit(located, document.quaternion, (*path, "quaternion"))
        shapes = [_shape(shape, located, (*path, "shapes", i), folder) for i, shape in enumerate(document.shapes)]
        bodies.append(Body(name, tuple(shapes), document.position, document.quaternion, document.mass))
    return tuple(bodies)


def robot_of(document: RobotDocument | None, located: Located, folder: Path) -> RobotDescription | None:
    """The robot under the key `robot`, with the content of its files; whether they are a robot is not checked here.

    Raises:
        InputError: if a file cannot be read.
    """
    if document is None:
        return None
    check_unit(located, document.quaternion, ("robot", "quaternion"))
    srdf = document.srdf_text or ""
    if document.srdf is not None:
        srdf = _text(folder / document.srdf, located, ("robot", "srdf"))
    text = document.text
    return RobotDescription(
        path=document.path,
        text=_text(folder / document.path, located, ("robot", "path")) if text is None else text,
        tool=document.tool,
        position=document.position,
        quaternion=document.quaternion,
        held=tuple(document.held.items()),
        rest=tuple(document.rest.items()),
        packages=tuple(document.packages.items()),
        srdf=srdf,
        folder=str((folder / document.path).parent),
        root=str(folder),
    )


def grasp_of(
    document: GraspDocument | None, robot: RobotDescription | None, automaton: HybridAutomaton, located: Located
) -> Grasp | None:
    """The grasp under the key `grasp`.

    Raises:
        InputError: for a part that the model does not have, and for a robot without grasp or a grasp without robot.
    """
    if document is None:
        if robot is not None:
            raise located.error(("robot",), "a robot without a grasp", "add 'grasp': say what it holds")
        return None
    if robot is None:
        raise located.error(("grasp",), "a grasp without a robot", "add 'robot': say which robot holds it")
    check_unit(located, document.quaternion, ("grasp", "quaternion"))
    parts = [link.child for link in automaton.links]
    if document.part not in parts:
        raise located.unknown(("grasp", "part"), "part", document.part, parts)
    return Grasp(document.part, document.position, document.quaternion)


def scene_data(scene: Sequence[Body]) -> dict[str, Any]:
    """The plain data of bodies, meshes with their corners; `scene_of` gives the same bodies again."""
    return {body.name: _body_data(body) for body in scene}


def _body_data(body: Body) -> dict[str, Any]:
    loose = {} if body.mass is None else {"mass": body.mass}
    return {"shapes": [_shape_data(shape) for shape in body.shapes], **_pose_data(body), **loose}


def robot_data(robot: RobotDescription) -> dict[str, Any]:
    """The plain data of a robot with the content of its file; its meshes are not in it."""
    data: dict[str, Any] = {"path": robot.path, "tool": robot.tool, **_pose_data(robot)}
    for key in ("held", "rest", "packages"):
        if getattr(robot, key):
            data[key] = dict(getattr(robot, key))
    return {**data, **({"srdf_text": robot.srdf} if robot.srdf else {}), "text": robot.text}


def grasp_data(grasp: Grasp) -> dict[str, Any]:
    """The plain data of a grasp."""
    return {"part": grasp.part, **_pose_data(grasp)}


def _shape(shape: BodyShapeDocument, located: Located, path: KeyPath, folder: Path) -> Shape:
    check_unit(located, shape.quaternion, (*path, "quaternion"))
    pose = shape.position, shape.quaternion, shape.color
    if shape.kind == "mesh":
        return Hull(_vertices(shape, located, path, folder), *pose)
    for key in ("path", "vertices"):
        if getattr(shape, key) is not None:
            raise located.error((*path, key), f"a {shape.kind} has no {key}", "write kind: mesh, or leave it out")
    if shape.size is None:
        raise located.error(path, "missing key 'size'", "add it")
    check_sizes(shape.kind, shape.size, located, path)
    return Primitive(shape.kind, tuple(shape.size), *pose)


def _vertices(
    shape: BodyShapeDocument, located: Located, path: KeyPath, folder: Path
) -> tuple[tuple[float, float, float], ...]:
    if (shape.path is None) == (shape.vertices is None):
        raise located.error(path, "expected either 'path' or 'vertices' of a mesh", "name a mesh file")
    if shape.size is not None:
        raise located.error((*path, "size"), "a mesh has no size", "give a scale instead")
    key = "vertices" if shape.path is None else "path"
    try:
        if shape.path is None:
            return convex_corners(np.array(shape.vertices, dtype=float).reshape(-1, 3))
        return load_hull(contained(shape.path, folder), shape.scale)
    except InputError as error:
        raise located.error((*path, key), error.problem, error.remedy) from None


def _text(path: Path, located: Located, key: KeyPath) -> str:
    try:
        return read_bytes(path, LARGEST_TEXT_BYTES).decode("utf-8")
    except InputError as error:
        raise located.error(key, f"{path}: {error.problem}", error.remedy) from None
    except UnicodeDecodeError:
        raise located.error(key, f"{path}: expected UTF-8 text", "give a URDF or MJCF file") from None


def _pose_data(item: Body | RobotDescription | Grasp | Shape) -> dict[str, Any]:
    """Position and orientation, where they are not those of the frame that they refer to."""
    data = {}
    if item.position != ZERO:
        data["position"] = list(item.position)
    if item.quaternion != IDENTITY:
        data["quaternion"] = list(item.quaternion)
    return data


def _shape_data(shape: Shape) -> dict[str, Any]:
    if isinstance(shape, Hull):
        own: dict[str, Any] = {"kind": "mesh", "vertices": [list(vertex) for vertex in shape.vertices]}
    else:
        own = {"kind": shape.kind, "size": list(shape.size)}
    return {**own, **_pose_data(shape), "color": shape.color}
