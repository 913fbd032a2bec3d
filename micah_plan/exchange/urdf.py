"""Models as URDF, which knows joints, limits and shapes, but no modes, guards or uncertainty.

Each link of the model must have one moving joint over all modes; it may go where any mode allows it. A part's frame
need not lie on its joint's axis, a URDF link's must: a link ``PART_axis`` turns, and the part's link is fixed to it.
Joints are named after the coordinates, with ``_joint`` behind where a part has that name already: programs that look
frames up by name would find two.

Models from URDF: one mode, coordinates named after the joints (or, of a joint ``PART_joint`` that moves PART, after
the part), which stop at their limits.

Links that are fixed to one another are one part, named after the first of them, or, where that has no shape, after the
only one that is fixed to it, as `urdf_write` makes them. So a model of one mode comes back as it was, except for noise,
handles and uncertainty. A mesh becomes the box around it, so that an object of PartNet-Mobility is made of boxes; where
what is drawn of a link has a mesh called ``handle...``, as there, its middle is where a hand holds the part.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform, Rotation

from micah_plan.automaton.graph import BASE
from micah_plan.automaton.hybrid import HybridAutomaton, Link, Part, Primitive
from micah_plan.automaton.joint import IDENTITY, Joint, Vector3, prismatic, revolute
from micah_plan.errors import InputError, located_in
from micah_plan.exchange.bodies import (
    DAMPING,
    DENSITY,
    Inertia,
    MovingPart,
    inertia_of,
    moving_parts,
    roll_pitch_yaw,
    written,
)
from micah_plan.exchange.one_mode import Follows, Moving, coordinate_of, doubts, one_mode
from micah_plan.robot.robot_text import NO_LIMIT, CheckedRobot, check_urdf
from micah_plan.task.body import vector3
from micah_plan.task.mesh_file import load_box
from micah_plan.xml_text import Element, parse_xml, read_xml, write_xml

AXIS_LINK = "_axis"

_HERE = RigidTransform.identity()


def urdf_text(automaton: HybridAutomaton, title: str, density: float = DENSITY) -> str:
    """The text of a URDF of the model.

    Args:
        automaton: each of its links must have one moving joint over all modes.
        title: name of the robot in the file.
        density: of all shapes [kg/m^3].

    Raises:
        InputError: for a part on a screw, with different moving joints in different modes, or that moves with another.
    """
    elements = [_link(BASE, automaton.part(BASE), None)]
    for part in moving_parts(automaton, screws=False):
        elements += _moved(part, density)
    lines = "".join(f"  {write_xml(element)}\n" for element in elements)
    head, _, tail = write_xml(Element("robot", {"name": title}, 0)).partition("</")
    return f'<?xml version="1.0"?>\n{head}\n{lines}</{tail}\n'


def _moved(part: MovingPart, density: float) -> list[Element]:
    """The link of a part with the joint that carries it."""
    joint, parent, child = part.joint, part.parent, part.child
    turn, link = Rotation.from_quat(joint.quaternion), _link(child, part.part, density)
    if not joint.moves:
        return [link, _joint(part.name, "fixed", parent, child, joint.position, joint.quaternion)]
    axis = Element("axis", {"xyz": written(turn.inv().apply(joint.axis))}, 0)
    free = joint.turns and not np.isfinite(part.limits).any()
    low, high = (float(np.clip(end, -NO_LIMIT, NO_LIMIT)) for end in part.limits)
    bounds = {"lower": repr(low), "upper": repr(high), "effort": "100", "velocity": "1"}
    described = [axis] if free else [axis, Element("limit", bounds, 0)]
    described.append(Element("dynamics", {"damping": repr(DAMPING[joint.unit]), "friction": "0"}, 0))
    if part.follows is not None:
        leader, times, offset_at = part.follows
        words = {"joint": leader, "multiplier": repr(times), "offset": repr(offset_at)}
        described = [*described, Element("mimic", words, 0)]
    kind = "continuous" if free else joint.kind
    if joint.slides:
        return [link, _joint(part.name, kind, parent, child, joint.position, joint.quaternion, described)]
    carrier = f"{child}{AXIS_LINK}"
    offset = turn.inv().apply(np.subtract(joint.position, joint.center))
    return [
        _link(carrier, None, None),
        _joint(part.name, kind, parent, carrier, joint.center, joint.quaternion, described),
        link,
        _joint(f"{child}_mount", "fixed", carrier, child, offset, IDENTITY),
    ]


def _joint(
    name: str, kind: str, parent: str, child: str, position: ArrayLike, quaternion: ArrayLike,
    described: Sequence[Element] = (),
) -> Element:  # fmt: skip
    ends = [Element("parent", {"link": parent}, 0), Element("child", {"link": child}, 0)]
    return Element("joint", {"name": name, "type": kind}, 0, [_origin(position, quaternion), *ends, *described])


def _link(name: str, part: Part | None, density: float | None) -> Element:
    """A link with its shapes and, given a density, its inertia."""
    shapes = [] if part is None else [_shape(shape, tag) for shape in part.shapes for tag in ("visual", "collision")]
    if part is not None and density is not None:
        shapes.insert(0, _inertial(inertia_of(part, density)))
    return Element("link", {"name": name}, 0, shapes)


def _inertial(inertia: Inertia) -> Element:
    moments = {f"i{'xyz'[i]}{'xyz'[j]}": repr(float(inertia.moments[i, j])) for i in range(3) for j in range(i, 3)}
    mass = Element("mass", {"value": repr(inertia.mass)}, 0)
    return Element("inertial", {}, 0, [_origin(inertia.center, IDENTITY), mass, Element("inertia", moments, 0)])


def _shape(shape: Primitive, tag: str) -> Element:
    """The shape to draw, with its colour, or to check."""
    if shape.kind == "box":
        solid = {"size": written(shape.size)}
    else:
        solid = dict(zip(("radius", "length"), map(repr, shape.size), strict=False))
    geometry = Element("geometry", {}, 0, [Element(shape.kind, solid, 0)])
    element = Element(tag, {}, 0, [_origin(shape.position, shape.quaternion), geometry])
    if tag == "visual":
        parts = [int(shape.color[i : i + 2], 16) / 255 for i in (1, 3, 5)]
        color = Element("color", {"rgba": f"{written(parts)} 1"}, 0)
        element.children.append(Element("material", {"name": shape.color}, 0, [color]))
    return element


def _origin(position: ArrayLike, quaternion: ArrayLike) -> Element:
    rpy = roll_pitch_yaw(Rotation.from_quat(quaternion))
    return Element("origin", {"xyz": written(position), "rpy": written(rpy)}, 0)


def load_urdf(path: str | Path, packages: Mapping[str, str] | None = None) -> tuple[HybridAutomaton, tuple[str, ...]]:
    """(model of a URDF, its losses and suspicions, one line each).

    Args:
        packages: folder by package name, for meshes; others are looked for among the folders above the file.

    Raises:
        InputError: if it is not URDF, or nothing moves.
    """
    root = parse_xml(read_xml(path, "URDF"), str(path))
    if root.tag != "robot":
        raise InputError(f"expected <robot> (URDF), found <{root.tag[:40]}>", source=path)
    return automaton_of_urdf(root, path, packages or {}, "urdf")


def automaton_of_urdf(
    root: Element, path: str | Path, packages: Mapping[str, str], method: str
) -> tuple[HybridAutomaton, tuple[str, ...]]:
    """`load_urdf` for a parsed root element; `method` is the provenance of the model."""
    checked = check_urdf(root, str(Path(path).parent), packages, is_arm=False)
    with located_in(path):
        return _Tree(checked, str(path), _meshes_of_handles(root, Path(path).parent)).automaton(method)


@dataclass
class _Body:
    """Links that are fixed to one another, as one body."""

    root: str
    poses: dict[str, RigidTransform]
    name: str = ""
    frame: RigidTransform = field(default_factory=RigidTransform.identity)


def _meshes_of_handles(root: Element, folder: Path) -> frozenset[str]:
    """Mesh files that are drawn as handles."""
    drawn = [visual for link in root.all("link") for visual in link.all("visual")]
    handles = [visual for visual in drawn if visual.attributes.get("name", "").lower().startswith("handle")]
    meshes = [mesh for visual in handles for geometry in visual.all("geometry") for mesh in geometry.all("mesh")]
    return frozenset(str((folder / mesh.attributes.get("filename", "")).resolve()) for mesh in meshes)


class _Tree:
    """The links and joints of a checked file as bodies."""

    def __init__(self, checked: CheckedRobot, source: str, handles: frozenset[str]) -> None:
        root = parse_xml(checked.text, source)
        self._links = {link.attributes["name"]: link for link in root.all("link")}
        self._joints: dict[str, list[Element]] = {}
        for joint in root.all("joint"):
            self._joints.setdefault(_end(joint, "parent"), []).append(joint)
        self._colors, self._handles, self._mimics = checked.colors, handles, checked.mimics
        carried = {_end(joint, "child") for joints in self._joints.values() for joint in joints}
        self._root = next(name for name in self._links if name not in carried)
        self._notes: list[str] = list(checked.left_out)

    def automaton(self, method: str) -> tuple[HybridAutomaton, tuple[str, ...]]:
        base = self._body(self._root)
        base.name, base.frame = BASE, _HERE
        bodies, moving = [base], list[Moving]()
        for body in bodies:  # grows: children come after their parents
            carried = [joint for link in body.poses for joint in self._joints.get(link, [])]
            for joint in (joint for joint in carried if joint.attributes["type"] != "fixed"):
                child = self._body(_end(joint, "child"))
                if child.name == BASE:
                    raise InputError("a moving link is called 'base'", remedy="give it another name")
                link = Link(body.name, child.name, len(moving))
                called = joint.attributes["name"]
                name = coordinate_of(called, child.name)
                moving.append(Moving(called, name, link, _read_joint(joint, body, child), _limits(joint)))
                bodies.append(child)
        parts = [self._part(body) for body in bodies]
        followers = {name: Follows(mimic.joint, mimic.multiplier, mimic.offset) for name, mimic in self._mimics.items()}
        automaton = one_mode(moving, parts, followers, method)
        return automaton, (*self._notes, *doubts(moving, parts))

    def _body(self, root: str) -> _Body:
        body, members = _Body(root, {root: _HERE}, root), [root]
        for link in members:  # grows
            for joint in self._joints.get(link, []):
                if joint.attributes["type"] == "fixed":
                    members.append(_end(joint, "child"))
                    body.poses[members[-1]] = body.poses[link] * _pose(joint)
        fixed = [joint for joint in self._joints.get(root, []) if joint.attributes["type"] == "fixed"]
        if len(fixed) == 1 and not self._links[root].all("collision"):
            body.name = _end(fixed[0], "child")
            body.frame = body.poses[body.name]
        return body

    def _part(self, body: _Body) -> Part:
        shapes: list[Primitive] = []
        handle: Vector3 | None = None
        for link, pose in body.poses.items():
            colors, boxes = self._colors.get(link, ()), 0
            for i, shape in enumerate(self._links[link].all("collision")):
                solid = shape.children[-1].children[0]
                color = colors[min(i, len(colors) - 1)] if colors else "#9aa5b1"
                try:
                    shapes += _primitives(solid, body.frame.inv() * pose * _pose(shape), color)
                except InputError as error:
                    self._notes.append(f"link {link}: a mesh is left out, {error.problem}")
                    continue
                boxes += solid.tag == "mesh"
                if handle is None and solid.attributes.get("filename") in self._handles:
                    handle = shapes[-1].position
            if boxes:
                around = (
                    "a mesh became the box around it" if boxes == 1 else f"{boxes} meshes became the boxes around them"
                )
                self._notes.append(f"link {link}: {around}")
        return Part(body.name, tuple(shapes), handle)


def _read_joint(joint: Element, parent: _Body, child: _Body) -> Joint:
    at = parent.frame.inv() * parent.poses[_end(joint, "parent")] * _pose(joint)
    placed = at * child.frame
    axis = joint.first("axis")
    direction = _numbers("1 0 0" if axis is None else axis.attributes.get("xyz", "1 0 0"))
    along = at.rotation.apply(direction)
    quaternion = placed.rotation.as_quat(canonical=True)
    if joint.attributes["type"] == "prismatic":
        return prismatic(along, placed.translation, quaternion)
    return revolute(along, at.translation, placed.translation, quaternion)


def _limits(joint: Element) -> tuple[float, float]:
    """(lower, upper) limits of a joint [rad or m]."""
    limit = joint.first("limit")
    if limit is None:
        return -NO_LIMIT, NO_LIMIT
    return float(limit.attributes["lower"]), float(limit.attributes["upper"])


def _primitives(solid: Element, pose: RigidTransform, color: str) -> list[Primitive]:
    """The shape as solids.

    Raises:
        InputError: for a mesh that cannot be read.
    """

    def one(
        kind: str, size: Sequence[float], along: float = 0.0, middle: Sequence[float] = (0.0, 0.0, 0.0)
    ) -> Primitive:
        x, y, z = pose.apply([middle[0], middle[1], middle[2] + along]).tolist()
        qx, qy, qz, qw = pose.rotation.as_quat(canonical=True).tolist()
        return Primitive(kind, tuple(size), (x, y, z), (qx, qy, qz, qw), color)

    if solid.tag == "box":
        return [one("box", _numbers(solid.attributes["size"]))]
    if solid.tag == "mesh":
        size, middle = load_box(
            solid.attributes["filename"], vector3(np.array(_numbers(solid.attributes.get("scale", "1 1 1"))))
        )
        return [one("box", size, middle=middle)]
    radius = float(solid.attributes["radius"])
    if solid.tag == "sphere":
        return [one("sphere", [radius])]
    length = float(solid.attributes["length"])
    ends = [one("sphere", [radius], along) for along in (-length / 2, length / 2)] if solid.tag == "capsule" else []
    return [one("cylinder", [radius, length]), *ends]


def _end(joint: Element, key: str) -> str:
    element = joint.first(key)
    return "" if element is None else element.attributes["link"]


def _pose(owner: Element) -> RigidTransform:
    """The pose of an <origin> element."""
    origin = owner.first("origin")
    if origin is None:
        return _HERE
    turn = Rotation.from_euler("xyz", _numbers(origin.attributes.get("rpy", "0 0 0")))
    return RigidTransform.from_components(_numbers(origin.attributes.get("xyz", "0 0 0")), turn)


def _numbers(text: str) -> list[float]:
    return [float(word) for word in text.split()]
