"""Release paths of the arm: down until the object stands, and away with the gripper open."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import RigidTransform

from micah_plan.arrays import Floats
from micah_plan.errors import InputError
from micah_plan.robot.along_plan import problem_clearance, tool_path
from micah_plan.robot.clearance import clearance_model
from micah_plan.robot.load_arm import load_arm
from micah_plan.robot.tool_path import ArmFailure, ToolPath, follow
from micah_plan.task.body import Body, Shape, vector3
from micah_plan.task.contact_poses import settled_poses
from micah_plan.task.deadline import Deadline
from micah_plan.task.plan import ArmTrajectory
from micah_plan.task.problem import Problem
from micah_plan.task.release import Rest
from micah_plan.task.robot_description import RobotDescription


def lowered(
    problem: Problem, mode: str, states: Floats, start: Floats, deadline: Deadline
) -> ArmTrajectory | ArmFailure:
    """The arm along states (K, n) on the way down; the object may touch its support.

    Args:
        start: (J,) joints that the arm is at, nearly.

    Raises:
        TimeLimitError: if it passes before there is a trajectory.
    """
    if problem.hold is None or problem.release is None:
        raise InputError("the problem has no release", remedy="add 'release' to a problem with 'hold'")
    path = tool_path(problem, [mode] * len(states), states)
    grip = problem.hold.grip
    meet = frozenset((part, problem.release.support) for part in (grip.held.name, grip.moving.name))
    touching = path.touching or [frozenset()] * len(states)
    path = replace(path, touching=[pairs | meet for pairs in touching])
    return follow(problem_clearance(problem), path, deadline=deadline, start=start)


def withdrawn(
    problem: Problem, rest: Rest, contact: Floats, displacements: Floats, start: Floats, deadline: Deadline
) -> ArmTrajectory | ArmFailure:
    """The arm withdrawing with the gripper open from a standing object.

    Args:
        contact: (n,) state in which it was released.
        displacements: (W, 3) of the hand [m].
        start: (J,) joints that the arm is at, nearly.

    Raises:
        TimeLimitError: if it passes before there is a trajectory.
    """
    if problem.robot is None or problem.grasp is None or problem.hold is None:
        raise InputError("the problem has no robot with a grasp", source=problem.source or None, remedy="add them")
    lowered_poses = settled_poses(problem, rest.mode, contact)
    poses = rest.poses(lowered_poses, np.array(contact[:3]))
    grip = problem.hold.grip
    standing = [_body(part.name, part.shapes, poses[part.name]) for part in (grip.held, grip.moving)]
    model = clearance_model(load_arm(with_open_gripper(problem)), (*problem.scene, *standing))
    begin = (lowered_poses[problem.grasp.part] * problem.grasp.pose).as_matrix()
    tool = np.tile(begin, (len(displacements) + 1, 1, 1))
    tool[1:, :3, 3] += np.cumsum(displacements, axis=0)
    return follow(model, ToolPath(RigidTransform.from_matrix(tool)), deadline=deadline, start=start)


def with_open_gripper(problem: Problem) -> RobotDescription:
    """The robot with its fingers in the open position.

    Raises:
        InputError: if the problem has no robot, or names no joints of the gripper.
    """
    robot, release = problem.robot, problem.release
    if robot is None or release is None:
        raise InputError("the problem has no robot that could release the object", remedy="add 'robot' and 'release'")
    if not release.fingers:
        text = "release.fingers: a robot releases by joints that open its gripper, found none"
        raise InputError(text, source=problem.source or None, remedy="name them, with where they are when open")
    return replace(robot, locked=tuple({**dict(robot.locked), **dict(release.fingers)}.items()))


def _body(name: str, shapes: tuple[Shape, ...], pose: RigidTransform) -> Body:
    x, y, z, w = pose.rotation.as_quat(canonical=True).tolist()
    return Body(name, shapes, vector3(pose.translation), (x, y, z, w))
