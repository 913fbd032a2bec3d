"""A robot in a MuJoCo world: its file loaded by MuJoCo, motors at its joints, and the arm as a carrier."""

from __future__ import annotations

from collections.abc import Callable, Collection
from functools import partial
from typing import Any

import numpy as np

from micah_plan.arrays import Floats
from micah_plan.errors import InputError
from micah_plan.execution import messages
from micah_plan.execution.mujoco.core import Carrier, PhysicalPlant
from micah_plan.execution.mujoco.parameters import PhysicalParameters
from micah_plan.execution.mujoco.world import ARM_MEETS, ARM_TYPE, OBJECT, World, add_finger_motor
from micah_plan.robot.along_plan import start_posture
from micah_plan.robot.arm import Arm
from micah_plan.robot.inverse_kinematics import next_pose
from micah_plan.robot.load_arm import check_robot, load_arm
from micah_plan.robot.robot_text import NO_LIMIT
from micah_plan.robot.solids import mesh_hulls
from micah_plan.task.problem import Problem
from micah_plan.task.robot_description import Grasp, RobotDescription
from micah_plan.xml_text import Element, parse_xml, write_xml

# Prefix of all names of the robot in the world.
_ROBOT = "robot/"
# Links that state neither mass nor solids would have none.
_LEAST_MASS, _LEAST_INERTIA = 1e-3, 1e-6
# The tool cannot follow a command if it would end further than this from there [m or rad].
_NOT_REACHED = 0.002


def attach_arm(
    scene: World,
    hand: Any,
    problem: Problem,
    parameters: PhysicalParameters,
    posture: Floats | None,
    fingers: Collection[str] = (),
) -> Callable[[PhysicalPlant], Carrier]:
    """Add a problem's robot to a world, with a position-controlled motor at each joint of its arm.

    The motors compensate the robot's own weight, as those of real arms do, within the efforts of its file.

    Args:
        hand: body of another world that the robot's tool grasps.
        posture: (J,) joints of the arm near which it starts; None: one is sought.
        fingers: joints besides the arm's that get motors with the force of a grip, instead of being locked.

    Returns:
        The carrier of a plant in this world.

    Raises:
        InputError: if MuJoCo cannot use the robot's file, or the arm cannot start.
    """
    description, grasp = problem.robot, problem.grasp
    if description is None or grasp is None:
        raise InputError("the problem has no robot with a grasp", source=problem.source or None, remedy="add them")
    arm, mujoco, world = load_arm(description), scene.mujoco, scene.spec
    robot = _read(mujoco, description, arm)
    for body in robot.bodies:
        body.gravcomp = 1.0
    for geom in robot.geoms:
        geom.contype, geom.conaffinity = ARM_TYPE, ARM_MEETS
    for name in arm.joints:
        joint = robot.joint(name)
        joint.actgravcomp = True
        joint.armature = max(joint.armature, parameters.rotor_inertia)
        if not 0 < joint.actfrcrange[1] < NO_LIMIT:
            joint.actfrcrange = [-parameters.joint_effort, parameters.joint_effort]
        motor = robot.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        motor.set_to_position(kp=float(joint.actfrcrange[1]) / parameters.joint_deflection)
    for name in fingers:
        add_finger_motor(robot, name, parameters)
    for name, value in arm.locked:
        if name in fingers:
            continue
        locked = robot.add_equality(name1=name, type=mujoco.mjtEq.mjEQ_JOINT, objtype=mujoco.mjtObj.mjOBJ_JOINT)
        locked.data = [value, *[0.0] * (len(locked.data) - 1)]
    stands = world.worldbody.add_frame(pos=description.position, quat=np.roll(description.quaternion, 1))
    world.attach(robot, prefix=_ROBOT, frame=stands)
    in_tool, link = grasp.pose.inv(), world.body(_ROBOT + description.tool)
    hand.pos, hand.quat = in_tool.translation, np.roll(in_tool.rotation.as_quat(), 1)
    frame = world.site(_ROBOT + description.tool) if link is None else link.add_frame()
    frame.attach_body(hand, OBJECT, "")
    return partial(ArmCarrier, arm=arm, grasp=grasp, posture=start_posture(problem) if posture is None else posture)


class ArmCarrier(Carrier):
    """Moves the hand by the arm's joints with continuous inverse kinematics at constant orientation."""

    def __init__(self, plant: PhysicalPlant, arm: Arm, grasp: Grasp, posture: Floats) -> None:
        """Args: posture: (J,) start of the search for initial joints."""
        super().__init__(plant, [_ROBOT + name for name in arm.joints])
        self._arm, self._posture = arm, posture
        self._grasp, self._from_tool = grasp.pose.as_matrix(), grasp.pose.inv().as_matrix()
        self._locked = {int(plant.model.joint(_ROBOT + name).qposadr[0]): value for name, value in arm.locked}

    @property
    def joints(self) -> Floats:
        return np.array(self._plant.data.qpos[self._address])

    def put(self, place: Floats) -> None:
        self._lock()
        super().put(place)
        self._damp()

    def put_like(self, carrier: Carrier) -> None:
        self._lock()
        super().put_like(carrier)
        self._damp()

    def _lock(self) -> None:
        for address, value in self._locked.items():
            self._plant.data.qpos[address] = value

    def _place(self, joints: Floats) -> Floats:
        return np.asarray((self._arm.matrix(joints) @ self._from_tool)[:3, 3])

    def _reached(self, place: Floats, near: Floats | None, posture: Floats | None, /) -> Floats:
        target = self._grasp.copy()
        target[:3, 3] += place
        limits = self._arm.lower, self._arm.upper
        q = np.clip(self._posture if near is None else near, *limits)
        wish = np.zeros(self._arm.n) if posture is None else posture - q
        reached = next_pose(self._arm, target, q, wish, limits)
        if np.abs(reached.error).max() > _NOT_REACHED and not self.complaint:
            stopped = [name for name, at in zip(self._arm.joints, reached.stopped, strict=True) if at]
            self.complaint = messages.tool_behind(float(np.linalg.norm(reached.error[3:])), stopped)
        return reached.q

    def _damp(self) -> None:
        """Set critical damping of every joint for its inertia in this posture."""
        mujoco, model, data = self._plant.mujoco, self._plant.model, self._plant.data
        mujoco.mj_forward(model, data)
        for name, motor in zip(self._arm.joints, self._motors, strict=True):
            dof, inertia = int(model.joint(_ROBOT + name).dofadr[0]), np.zeros(model.nv)
            mujoco.mj_mulM(model, data, inertia, np.eye(model.nv)[dof])
            model.actuator_biasprm[motor, 2] = -2 * np.sqrt(model.actuator_gainprm[motor, 0] * inertia[dof])


def _read(mujoco: Any, description: RobotDescription, arm: Arm) -> Any:
    checked = check_robot(description)
    root = parse_xml(checked.text, description.path)
    if checked.kind == "urdf":  # its meshes have whole paths
        options = Element("compiler", {"strippath": "false"}, root.line)
        root.children.append(Element("mujoco", {}, root.line, [options]))
    hulls = mesh_hulls(arm)
    try:
        spec = mujoco.MjSpec.from_string(write_xml(root))
        for mesh in spec.meshes:  # the hulls that planning has, for any format of the file
            hull = hulls.get((mesh.file, tuple(mesh.scale)))
            if hull is not None:
                mesh.file, mesh.scale, mesh.uservert = "", np.ones(3), hull.ravel()
        # Links that are fixed to each other are merged otherwise, and the tool with them.
        spec.compiler.fusestatic = False
        spec.compiler.balanceinertia = True
        spec.compiler.boundmass, spec.compiler.boundinertia = _LEAST_MASS, _LEAST_INERTIA
        spec.compile()
    except ValueError as error:
        message = " ".join(str(error).split())[:160]
        raise InputError(f"MuJoCo cannot use the robot: {message}", source=description.path) from None
    return spec
