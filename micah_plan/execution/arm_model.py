"""A robot in a MuJoCo world: its file read by MuJoCo, motors at the joints of the arm, its tool ready to hold."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform

from micah_plan.errors import InputError
from micah_plan.execution.held_mjcf import ARM_MEETS, ARM_TYPE
from micah_plan.execution.held_parameters import HeldParameters
from micah_plan.robot.arm import Arm
from micah_plan.robot.load_arm import check_robot
from micah_plan.robot.robot_text import NO_LIMIT
from micah_plan.robot.solids import mesh_hulls
from micah_plan.robot.xml_text import Element, parse_xml, write_xml
from micah_plan.scene.robot_description import RobotDescription

PREFIX = "robot/"
# Links that state neither mass nor solids would have none.
_LEAST_MASS, _LEAST_INERTIA = 1e-3, 1e-6


def attach_arm(mujoco: Any, world: Any, description: RobotDescription, arm: Arm, parameters: HeldParameters) -> None:
    """Put the robot into a world (MjSpec), with a position-controlled motor at each joint of its arm.

    The motors bear the robot's own weight, as those of real arms do, within the efforts that its file states. All
    names get `PREFIX`.

    Raises:
        InputError: if MuJoCo cannot use the robot's file.
    """
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
    for name, value in arm.locked:
        locked = robot.add_equality(name1=name, type=mujoco.mjtEq.mjEQ_JOINT, objtype=mujoco.mjtObj.mjOBJ_JOINT)
        locked.data = [value, *[0.0] * (len(locked.data) - 1)]
    stands = world.worldbody.add_frame(pos=description.position, quat=np.roll(description.quaternion, 1))
    world.attach(robot, prefix=PREFIX, frame=stands)


def fix_to_tool(world: Any, tool: str, body: Any, pose: RigidTransform, prefix: str) -> None:
    """Fix a body of another MjSpec to the tool of the robot in a world, at a pose in the tool's frame."""
    body.pos, body.quat = pose.translation, np.roll(pose.rotation.as_quat(), 1)
    link = world.body(PREFIX + tool)
    holder = world.site(PREFIX + tool) if link is None else link.add_frame()
    holder.attach_body(body, prefix, "")


def _read(mujoco: Any, description: RobotDescription, arm: Arm) -> Any:
    checked = check_robot(description)
    root = parse_xml(checked.text, description.path)
    if checked.kind == "urdf":  # its meshes have whole paths
        options = Element("compiler", {"strippath": "false"}, root.line)
        root.children.append(Element("mujoco", {}, root.line, [options]))
    hulls = mesh_hulls(arm)
    try:
        spec = mujoco.MjSpec.from_string(write_xml(root))
        for mesh in spec.meshes:  # the hulls that planning has, whatever the format of the file
            hull = hulls.get((mesh.file, tuple(mesh.scale)))
            if hull is not None:
                mesh.file, mesh.scale, mesh.uservert = "", np.ones(3), hull.ravel()
        # Links that are fixed to each other are merged otherwise, and the tool with them.
        spec.compiler.fusestatic = False
        spec.compiler.balanceinertia = True
        spec.compiler.boundmass, spec.compiler.boundinertia = _LEAST_MASS, _LEAST_INERTIA
        spec.compile()
    except ValueError as error:
        said = " ".join(str(error).split())[:160]
        raise InputError(f"MuJoCo cannot use the robot: {said}", source=description.path) from None
    return spec
