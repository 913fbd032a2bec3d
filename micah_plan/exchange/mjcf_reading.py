"""Models from MJCF, compiled by MuJoCo itself: one mode, whose coordinates stop at the limits of the joints.

A body with joints is a part; bodies without are fixed to the one around them. Coordinates have the names of the joints,
in MuJoCo's own coordinates, and an equality of joints ties one coordinate to the other. A site called ``PART_handle``,
or the first of a part in whose name ``handle`` stands, is where a hand holds it. A mesh becomes the box around it.
Source: MuJoCo documentation, "XML reference" and "Computation".
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from micah_plan.automaton.graph import BASE
from micah_plan.automaton.hybrid import HybridAutomaton, Link, Part, Primitive
from micah_plan.automaton.joint import Vector3, prismatic, revolute
from micah_plan.errors import InputError, located_in, shown
from micah_plan.exchange.one_mode import Follows, Moving, coordinate_of, doubts, one_mode
from micah_plan.mujoco_library import import_mujoco
from micah_plan.robot.robot_text import MJCF_ROOTS, NO_LIMIT, check_mjcf
from micah_plan.task.body import vector3
from micah_plan.xml_text import parse_xml, read_xml, with_includes

_HERE = RigidTransform.identity()


def load_mjcf(path: str | Path) -> tuple[HybridAutomaton, tuple[str, ...]]:
    """(model of an MJCF file, its losses and suspicions, one line each).

    Raises:
        InputError: if it is not MJCF, MuJoCo refuses it, nothing moves, or something moves on a ball joint.
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
            message = " ".join(str(error).split())[:160]
            raise InputError(f"cannot be read as an object: {message}", remedy="correct the file") from None
        notes = ["left out: <tendon>, which may tie joints"] if root.all("tendon") else []
        return _Tree(mujoco, compiled, notes).automaton()


@dataclass
class _Part:
    """A part under construction."""

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
        """Add a part on a joint; at the drawn value of its coordinate it is at `place`."""
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
        """Joints coupled by equalities; other equalities are noted."""
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
        """Add a solid that collides, or a visual one of a body without collision shapes."""
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
        """Set a part's handle at a site with `handle` in its name."""
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
    """A pose from MuJoCo's position and scalar-first quaternion."""
    return RigidTransform.from_components(np.array(position), Rotation.from_quat(np.roll(quaternion, -1)))
