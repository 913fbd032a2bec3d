"""MJCF files compiled by MuJoCo, as Pinocchio models with solids.

MJCF can express one thing in many ways: orientations as quaternions, axes and angles or Euler angles in a chosen order,
classes of defaults, degrees for hinges but not for slides, frames within frames, reference positions. Only MuJoCo's own
compiler handles them all; its result is a tree of bodies, each with a pose, joints and solids.
"""

from __future__ import annotations

from typing import Any

import coal
import numpy as np
import pinocchio as pin
from scipy.spatial.transform import Rotation

from micah_plan.errors import InputError
from micah_plan.mujoco_library import import_mujoco
from micah_plan.robot.robot_text import NO_LIMIT
from micah_plan.robot.solids import convex

_NO_SHIFT = pin.SE3.Identity()
# Half the side of the block whose upper face represents an endless floor [m].
_FLOOR = 50.0


def mjcf_arm(text: str, source: str) -> tuple[Any, Any, frozenset[str]]:
    """Model, collision geometry, and joints coupled by equalities.

    Joints have their names and limits as in the file, in MuJoCo's coordinates. Bodies and sites are frames. Solids that
    collide with nothing (contype and conaffinity 0) are left out.

    Raises:
        InputError: if MuJoCo refuses the file, or a solid is of a kind that is not read.
        MissingDependencyError: if MuJoCo is not installed.
    """
    mujoco = import_mujoco("an arm in MJCF")
    try:
        compiled = mujoco.MjModel.from_xml_string(text)
    except (ValueError, RuntimeError) as error:
        message = " ".join(str(error).split())[:160]
        raise InputError(f"cannot be read as a robot: {message}", source=source, remedy="correct the file") from None
    arm = _Arm(mujoco, compiled, source)
    coupled = np.flatnonzero(compiled.eq_type == int(mujoco.mjtEq.mjEQ_JOINT))
    followers = frozenset(arm.joint_name(int(compiled.eq_obj1id[i])) for i in coupled)
    return arm.model, arm.geometry, followers


class _Arm:
    """Builds Pinocchio's model of a compiled file, body by body.

    Attributes:
        model, geometry: built so far.
        carried: of each body the number of the joint that moves it, and its pose in that joint's frame.
    """

    def __init__(self, mujoco: Any, compiled: Any, source: str) -> None:
        self._mujoco, self._compiled, self._source = mujoco, compiled, source
        self.model, self.geometry = pin.Model(), pin.GeometryModel()
        self.carried: list[tuple[int, Any]] = [(0, pin.SE3.Identity())]
        for body in range(1, compiled.nbody):
            self._add_body(body)
        for site in range(compiled.nsite):
            joint, place = self.carried[compiled.site_bodyid[site]]
            place = place * _pose(compiled.site_pos[site], compiled.site_quat[site])
            self._add_frame(compiled.site(site).name or f"site_{site}", joint, place, pin.FrameType.OP_FRAME)
        for geom in np.flatnonzero((compiled.geom_contype != 0) | (compiled.geom_conaffinity != 0)).tolist():
            self._add_solid(geom)

    def joint_name(self, joint: int) -> str:
        """The joint's name, or one from its body."""
        compiled, body = self._compiled, int(self._compiled.jnt_bodyid[joint])
        number = joint - int(compiled.body_jntadr[body])
        return str(compiled.joint(joint).name or f"{self._body_name(body)}_joint_{number}")

    def _body_name(self, body: int) -> str:
        return str(self._compiled.body(body).name or f"body_{body}")

    def _add_body(self, body: int) -> None:
        """A body with its joints, in their order."""
        compiled, first = self._compiled, int(self._compiled.body_jntadr[body])
        number, place = self.carried[compiled.body_parentid[body]]
        place = place * _pose(compiled.body_pos[body], compiled.body_quat[body])
        for joint in range(first, first + int(compiled.body_jntnum[body])):
            anchor = pin.SE3(np.eye(3), compiled.jnt_pos[joint].copy())
            own, back, ends = self._joint(joint)
            number = self.model.addJoint(number, own, place * anchor * back, self.joint_name(joint), *ends)
            self.model.addJointFrame(number)
            place = anchor.inverse()
        self._add_frame(self._body_name(body), number, place, pin.FrameType.BODY)
        self.carried.append((number, place))

    def _joint(self, joint: int) -> tuple[Any, Any, list[Any]]:
        """(joint model, transform from the drawn pose to position 0, limits) of a joint."""
        compiled, kinds = self._compiled, self._mujoco.mjtJoint
        kind, axis = kinds(int(compiled.jnt_type[joint])), compiled.jnt_axis[joint].copy()
        if kind == kinds.mjJNT_FREE:
            return pin.JointModelFreeFlyer(), pin.SE3.Identity(), []
        if kind == kinds.mjJNT_BALL:
            return pin.JointModelSpherical(), pin.SE3.Identity(), []
        rest = float(compiled.qpos0[compiled.jnt_qposadr[joint]])
        low, high = compiled.jnt_range[joint] if compiled.jnt_limited[joint] else (-NO_LIMIT, NO_LIMIT)
        ends = [np.array([value]) for value in (NO_LIMIT, NO_LIMIT, low, high)]
        if kind == kinds.mjJNT_SLIDE:
            return pin.JointModelPrismaticUnaligned(axis), pin.SE3(np.eye(3), -rest * axis), ends
        back = Rotation.from_rotvec(-rest * axis).as_matrix()
        return pin.JointModelRevoluteUnaligned(axis), pin.SE3(back, np.zeros(3)), ends

    def _add_frame(self, name: str, joint: int, place: Any, kind: Any) -> None:
        self.model.addFrame(pin.Frame(name, joint, self._frame_of(joint), place, kind), False)

    def _frame_of(self, joint: int) -> int:
        """The frame of a joint; the first is that of the world."""
        return int(self.model.getFrameId(self.model.names[joint], pin.FrameType.JOINT)) if joint else 0

    def _add_solid(self, geom: int) -> None:
        compiled, body = self._compiled, int(self._compiled.geom_bodyid[geom])
        joint, place = self.carried[body]
        shape, down = self._shape(geom)
        place = place * _pose(compiled.geom_pos[geom], compiled.geom_quat[geom]) * down
        link = self._body_name(body)
        number = sum(str(item.name).rpartition("_")[0] == link for item in self.geometry.geometryObjects)
        solid = pin.GeometryObject(f"{link}_{number}", joint, self._frame_of(joint), place, shape)
        self.geometry.addGeometryObject(solid)

    def _shape(self, geom: int) -> tuple[Any, Any]:
        """The shape of a solid, and its middle in the solid's frame."""
        compiled, kinds = self._compiled, self._mujoco.mjtGeom
        kind, (a, b, c), middle = kinds(int(compiled.geom_type[geom])), compiled.geom_size[geom].tolist(), _NO_SHIFT
        if kind == kinds.mjGEOM_PLANE:
            side = 2 * _FLOOR
            return coal.Box(side, side, side), pin.SE3(np.eye(3), np.array([0.0, 0.0, -_FLOOR]))
        if kind == kinds.mjGEOM_MESH:
            mesh = int(compiled.geom_dataid[geom])
            rows = slice(compiled.mesh_vertadr[mesh], compiled.mesh_vertadr[mesh] + compiled.mesh_vertnum[mesh])
            return convex(np.array(compiled.mesh_vert[rows], dtype=float)), middle
        primitives = {
            kinds.mjGEOM_SPHERE: lambda: coal.Sphere(a),
            kinds.mjGEOM_CAPSULE: lambda: coal.Capsule(a, 2 * b),
            kinds.mjGEOM_CYLINDER: lambda: coal.Cylinder(a, 2 * b),
            kinds.mjGEOM_BOX: lambda: coal.Box(2 * a, 2 * b, 2 * c),
            kinds.mjGEOM_ELLIPSOID: lambda: coal.Ellipsoid(a, b, c),
        }
        if kind in primitives:
            return primitives[kind](), middle
        link = self._body_name(int(compiled.geom_bodyid[geom]))
        problem = f"a solid of {link} is a {kind.name.removeprefix('mjGEOM_').lower()}, which is not read"
        remedy = "use primitives or meshes, or set its contype and conaffinity to 0"
        raise InputError(problem, source=self._source, remedy=remedy)


def _pose(position: Any, quaternion: Any) -> Any:
    """A pose from MuJoCo's position and scalar-first quaternion."""
    return pin.SE3(Rotation.from_quat(np.roll(quaternion, -1)).as_matrix(), np.array(position, dtype=float))
