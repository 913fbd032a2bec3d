"""Models as MJCF (MuJoCo's XML): nested bodies on hinges and slides, with handles as sites and a motor per coordinate.

MuJoCo has no screw: it is a hinge and a slide that an equality joins. Joints are damped a little, so that the object
comes to rest, and there is no gravity: the base frame of a learned model is seldom level.
Source: MuJoCo documentation, "XML reference".

**Reading.** Models from MJCF, compiled by MuJoCo itself: one mode, whose coordinates stop at the limits of the joints.

A body with joints is a part; bodies without are fixed to the one around them. Coordinates have the names of the joints,
in MuJoCo's own coordinates, and an equality of joints ties one coordinate to the other. A site called ``PART_handle``,
or the first of a part in whose name ``handle`` stands, is where a hand holds it. A mesh becomes the box around it.
Source: MuJoCo documentation, "XML reference" and "Computation".
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform, Rotation

from micah_plan.automaton.graph import BASE
from micah_plan.automaton.hybrid import HybridAutomaton, Link, Part, Primitive
from micah_plan.automaton.joint import Vector3, prismatic, revolute
from micah_plan.errors import InputError, located_in, shown
from micah_plan.exchange.bodies import DAMPING, DENSITY, MovingPart, inertia_of, moving_parts, written
from micah_plan.exchange.one_mode import Follows, Moving, coordinate_of, doubts, one_mode
from micah_plan.mujoco_library import import_mujoco
from micah_plan.robot.robot_text import MJCF_ROOTS, NO_LIMIT, check_mjcf
from micah_plan.task.body import vector3
from micah_plan.xml_text import Element, parse_xml, read_xml, with_includes, write_xml

_SCALAR_FIRST = [3, 0, 1, 2]


def mjcf_text(automaton: HybridAutomaton, title: str, density: float = DENSITY) -> str:
    """The text of an MJCF file of the model.

    Args:
        automaton: each of its links must have one moving joint over all modes.
        title: name of the model in the file.
        density: of all shapes [kg/m^3].

    Raises:
        InputError: for a part with different moving joints in different modes, or that moves with another.
    """
    bodies = {BASE: Element("body", {"name": BASE}, 0, _solids(automaton.part(BASE)))}
    root = bodies[BASE]
    equalities, motors = list[Element](), list[Element]()
    for part in moving_parts(automaton, screws=True):
        bodies[part.child] = _body(part, density)
        bodies[part.parent].children.append(bodies[part.child])
        if part.joint.climbs:
            pitch = {"joint1": f"{part.name}_slide", "joint2": part.name, "polycoef": f"0 {part.joint.pitch!r} 0 0 0"}
            equalities.append(Element("joint", pitch, 0))
        if part.joint.moves:
            motors.append(Element("motor", {"name": part.name, "joint": part.name}, 0))
    content = [
        Element("compiler", {"angle": "radian", "autolimits": "true"}, 0),
        Element("option", {"gravity": "0 0 0", "integrator": "implicitfast"}, 0),
        Element("worldbody", {}, 0, [root]),
        *([Element("equality", {}, 0, equalities)] if equalities else []),
        *([Element("actuator", {}, 0, motors)] if motors else []),
    ]
    return f'<?xml version="1.0"?>\n{write_xml(Element("mujoco", {"model": title}, 0, content))}\n'


def _body(part: MovingPart, density: float) -> Element:
    joint = part.joint
    inertia = inertia_of(part.part, density)
    moments = inertia.moments
    full = (*np.diag(moments), moments[0, 1], moments[0, 2], moments[1, 2])
    inertial = {"pos": written(inertia.center), "mass": repr(inertia.mass), "fullinertia": written(full)}
    children = [*_joints(part), Element("inertial", inertial, 0), *_solids(part.part)]
    if part.part.handle is not None:
        site = {"name": f"{part.child}_handle", "pos": written(part.part.handle), "size": "0.01"}
        children.append(Element("site", site, 0))
    placed = {"name": part.child, "pos": written(joint.position), "quat": _quat(joint.quaternion)}
    return Element("body", placed, 0, children)


def _joints(part: MovingPart) -> list[Element]:
    """In the frame of the part, as MJCF has them."""
    joint = part.joint
    if not joint.moves:
        return []
    back = Rotation.from_quat(joint.quaternion).inv()
    axis = written(back.apply(joint.axis))
    center = written(back.apply(np.subtract(joint.center, joint.position)))
    attributes = {"name": part.name, "axis": axis, "damping": repr(DAMPING[joint.unit])}
    if all(map(math.isfinite, part.limits)):
        attributes["range"] = written(part.limits)
    if joint.slides:
        return [Element("joint", {"type": "slide", **attributes}, 0)]
    elements = [Element("joint", {"type": "hinge", "pos": center, **attributes}, 0)]
    if joint.climbs:
        elements.insert(0, Element("joint", {"name": f"{part.name}_slide", "type": "slide", "axis": axis}, 0))
    return elements


def _solids(part: Part) -> list[Element]:
    """Shapes that meet nothing: parts overlap where a joint holds them."""
    return [_solid(shape) for shape in part.shapes]


def _solid(shape: Primitive) -> Element:
    size = [length / 2 for length in shape.size] if shape.kind == "box" else list(shape.size)
    if shape.kind == "cylinder":
        size[1] /= 2
    color = [int(shape.color[i : i + 2], 16) / 255 for i in (1, 3, 5)]
    place = {"pos": written(shape.position), "quat": _quat(shape.quaternion), "rgba": f"{written(color)} 1"}
    meets = {"contype": "0", "conaffinity": "0", "mass": "0"}
    return Element("geom", {"type": shape.kind, "size": written(size), **place, **meets}, 0)


def _quat(quaternion: ArrayLike) -> str:
    return written(np.asarray(quaternion, dtype=float)[_SCALAR_FIRST])


_HERE = RigidTransform.identity()


def load_mjcf(path: str | Path) -> tuple[HybridAutomaton, tuple[str, ...]]:
    """The model that an MJCF file describes, and what of the file is not in it or looks like a mistake, one line each.

    Raises:
        InputError: if it is no MJCF, MuJoCo refuses it, nothing moves, or something moves on a ball joint.
        MissingDependencyError: if MuJoCo is not installed.
    """
    root = parse_xml(read_xml(path, "MJCF"), str(path))
    if root.tag != "mujoco":
        raise InputError(f"expected <mujoco> (MJCF), found <{root.tag[:40]}>", source=path)
    folder = str(Path(path).parent)
    checked = check_mjcf(with_includes(root, folder, MJCF_ROOTS), folder)
    mujoco = import_mujoco("an object in MJCF")
    with located_in(path):
        try:
            compiled = mujoco.MjModel.from_xml_string(checked.text)
        except (ValueError, RuntimeError) as error:
            said = " ".join(str(error).split())[:160]
            raise InputError(f"cannot be read as an object: {said}", remedy="correct the file") from None
        notes = ["left out: <tendon>, which may tie joints"] if root.all("tendon") else []
        return _Tree(mujoco, compiled, notes).automaton()


@dataclass
class _Part:
    """A part that is being put together."""

    name: str
    shapes: list[Primitive] = field(default_factory=list)
    handle: Vector3 | None = None


class _Tree:
    """The bodies of a compiled file as parts.

    Attributes:
        parts: base first.
        moving: the joints between them.
        carried: of each body the number of its part, and its pose in that.
    """

    def __init__(self, mujoco: Any, compiled: Any, notes: list[str]) -> None:
        self._mujoco, self._compiled, self._notes = mujoco, compiled, notes
        self.parts, self.moving = [_Part(BASE)], list[Moving]()
        self.carried: list[tuple[int, RigidTransform]] = [(0, _HERE)]

    def automaton(self) -> tuple[HybridAutomaton, tuple[str, ...]]:
        for body in range(1, self._compiled.nbody):
            self._add_body(body)
        for geom in range(self._compiled.ngeom):
            self._add_shape(geom)
        for site in range(self._compiled.nsite):
            self._add_handle(site)
        parts = [Part(part.name, tuple(part.shapes), part.handle) for part in self.parts]
        automaton = one_mode(self.moving, parts, self._followers(), "mjcf")
        return automaton, (*self._notes, *doubts(self.moving, parts))

    def _add_body(self, body: int) -> None:
        compiled, name = self._compiled, self._body_name(body)
        part, place = self.carried[compiled.body_parentid[body]]
        place = place * _pose(compiled.body_pos[body], compiled.body_quat[body])
        first, number = int(compiled.body_jntadr[body]), int(compiled.body_jntnum[body])
        for joint in range(first, first + number):
            if int(compiled.jnt_type[joint]) == int(self._mujoco.mjtJoint.mjJNT_FREE):
                self._notes.append(f"the free joint of {name} is left out: the base frame is where the file puts it")
                continue
            is_last = joint == first + number - 1
            self._add_joint(joint, part, place, name if is_last else f"{name}_{joint - first}")
            part, place = len(self.parts) - 1, _HERE
        self.carried.append((part, place))

    def _add_joint(self, joint: int, parent: int, place: RigidTransform, child: str) -> None:
        """A part on a joint; where its coordinate has the value that the file was drawn at, it is at `place`."""
        compiled, kinds = self._compiled, self._mujoco.mjtJoint
        called = self._joint_name(joint)
        if child == BASE:
            raise InputError("a moving body is called 'base'", remedy="give it another name")
        if int(compiled.jnt_type[joint]) == int(kinds.mjJNT_BALL):
            raise InputError(f"joint {shown(called)} is a ball", remedy="use hinges, whose axes meet")
        drawn_at = float(compiled.qpos0[compiled.jnt_qposadr[joint]])
        along = place.rotation.apply(compiled.jnt_axis[joint])
        if int(compiled.jnt_type[joint]) == int(kinds.mjJNT_SLIDE):
            at = place.translation - drawn_at * along
            slide = prismatic(along, at, place.rotation.as_quat(canonical=True))
        else:
            back = Rotation.from_rotvec(-drawn_at * along)
            anchor = place.apply(compiled.jnt_pos[joint])
            at = anchor + back.apply(place.translation - anchor)
            slide = revolute(along, anchor, at, (back * place.rotation).as_quat(canonical=True))
        low, high = compiled.jnt_range[joint].tolist() if compiled.jnt_limited[joint] else (-NO_LIMIT, NO_LIMIT)
        self.parts.append(_Part(child))
        link = Link(self.parts[parent].name, child, len(self.moving))
        self.moving.append(Moving(called, coordinate_of(called, child), link, slide, (low, high)))

    def _followers(self) -> dict[str, Follows]:
        """Joints that an equality makes follow others; of those that close loops a note."""
        compiled, followers = self._compiled, dict[str, Follows]()
        for i in np.flatnonzero(compiled.eq_active0).tolist():
            if int(compiled.eq_type[i]) != int(self._mujoco.mjtEq.mjEQ_JOINT):
                kind = self._mujoco.mjtEq(int(compiled.eq_type[i])).name.removeprefix("mjEQ_").lower()
                self._notes.append(f"left out: an equality ({kind}), which may close a loop")
                continue
            first, second = int(compiled.eq_obj1id[i]), int(compiled.eq_obj2id[i])
            shift, times, *curved = compiled.eq_data[i, :5].tolist()
            name = self._joint_name(first)
            if second < 0 or any(curved):
                problem = f"the equality of joint {shown(name)} is no straight line"
                raise InputError(problem, remedy="fix the body, or give polycoef two numbers")
            start, of_other = (float(compiled.qpos0[compiled.jnt_qposadr[joint]]) for joint in (first, second))
            followers[name] = Follows(self._joint_name(second), times, start + shift - times * of_other)
        return followers

    def _add_shape(self, geom: int) -> None:
        """A solid that collides, or is drawn where nothing of its body collides."""
        compiled, body = self._compiled, int(self._compiled.geom_bodyid[geom])
        collide = (compiled.geom_contype != 0) | (compiled.geom_conaffinity != 0)
        if not collide[geom] and collide[compiled.geom_bodyid == body].any():
            return
        number, place = self.carried[body]
        shape = self._shape(geom, place * _pose(compiled.geom_pos[geom], compiled.geom_quat[geom]))
        if shape is not None:
            self.parts[number].shapes.append(shape)

    def _shape(self, geom: int, pose: RigidTransform) -> Primitive | None:
        compiled, kinds = self._compiled, self._mujoco.mjtGeom
        kind, (a, b, c) = kinds(int(compiled.geom_type[geom])), compiled.geom_size[geom].tolist()
        owner = self._body_name(int(compiled.geom_bodyid[geom]))
        if kind == kinds.mjGEOM_MESH:
            mesh = int(compiled.geom_dataid[geom])
            first = int(compiled.mesh_vertadr[mesh])
            vertices = np.array(compiled.mesh_vert[first : first + int(compiled.mesh_vertnum[mesh])], dtype=float)
            low, high = vertices.min(axis=0), vertices.max(axis=0)
            pose = pose * RigidTransform.from_translation((low + high) / 2)
            self._notes.append(f"body {owner}: a mesh became the box around it")
            return _solid_of_geom("box", (high - low).tolist(), pose, compiled.geom_rgba[geom])
        if kind == kinds.mjGEOM_CAPSULE:  # its round ends are as long as they are wide
            return _solid_of_geom("cylinder", [a, 2 * (a + b)], pose, compiled.geom_rgba[geom])
        sizes = {
            kinds.mjGEOM_SPHERE: ("sphere", [a]),
            kinds.mjGEOM_CYLINDER: ("cylinder", [a, 2 * b]),
            kinds.mjGEOM_BOX: ("box", [2 * a, 2 * b, 2 * c]),
            kinds.mjGEOM_ELLIPSOID: ("box", [2 * a, 2 * b, 2 * c]),
        }
        if kind not in sizes:
            self._notes.append(f"left out: a {kind.name.removeprefix('mjGEOM_').lower()} of {owner}")
            return None
        return _solid_of_geom(*sizes[kind], pose, compiled.geom_rgba[geom])

    def _add_handle(self, site: int) -> None:
        compiled = self._compiled
        number, place = self.carried[int(compiled.site_bodyid[site])]
        part, name = self.parts[number], str(compiled.site(site).name)
        if name == f"{part.name}_handle" or ("handle" in name.lower() and part.handle is None):
            part.handle = vector3(place.apply(compiled.site_pos[site]))

    def _joint_name(self, joint: int) -> str:
        return str(self._compiled.joint(joint).name) or f"joint_{joint}"

    def _body_name(self, body: int) -> str:
        return str(self._compiled.body(body).name) or f"body_{body}"


def _solid_of_geom(kind: str, size: list[float], pose: RigidTransform, rgba: Any) -> Primitive:
    color = "#" + "".join(f"{round(255 * float(share)):02x}" for share in rgba[:3])
    turn = pose.rotation.as_quat(canonical=True).tolist()
    return Primitive(kind, tuple(size), vector3(pose.translation), (turn[0], turn[1], turn[2], turn[3]), color)


def _pose(position: Any, quaternion: Any) -> RigidTransform:
    """A pose from MuJoCo's position and quaternion, whose scalar comes first."""
    return RigidTransform.from_components(np.array(position), Rotation.from_quat(np.roll(quaternion, -1)))
