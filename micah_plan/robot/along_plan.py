"""The arm along a plan: which pose of the tool each knot asks for, and the joints that take it there.

**Release.** The arm goes down with the object until it stands, and away from it with the gripper open.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import RigidTransform

from micah_plan.arrays import Floats
from micah_plan.automaton.graph import BASE
from micah_plan.automaton.hybrid import HybridAutomaton, Part
from micah_plan.errors import InputError
from micah_plan.robot.clearance import ClearanceModel, clearance_model
from micah_plan.robot.load_arm import load_arm
from micah_plan.robot.tool_path import ArmFailure, ToolPath, follow
from micah_plan.task.body import Body, Shape, vector3
from micah_plan.task.contact_poses import settled_poses, touching_pairs
from micah_plan.task.plan import ArmTrajectory, Trajectory
from micah_plan.task.problem import Problem
from micah_plan.task.release import Rest
from micah_plan.task.robot_description import RobotDescription
from micah_plan.task.settings import NEVER, Deadline


def arm_along(
    problem: Problem,
    trajectory: Trajectory,
    seed: int = 0,
    deadline: Deadline = NEVER,
    start: Floats | None = None,
) -> ArmTrajectory | ArmFailure:
    """The arm's trajectory that takes the held part along the means of a plan, or what stands in the way.

    Parts may meet bodies of the scene where a held object is to touch them.

    Args:
        problem: with a robot and a grasp.
        trajectory: over K knots.
        seed: of the start postures.
        deadline: when to end.
        start: (n,) joints that the arm is at, nearly; None: it may start in any posture.

    Raises:
        TimeLimitError: if it passes before there is a trajectory.
        InputError: if the problem has no robot or grasp, or its files cannot be used.
    """
    path = tool_path(problem, trajectory.modes, trajectory.of_first(problem.automaton.n).means)
    return follow(problem_clearance(problem), path, seed, deadline=deadline, start=start)


def start_posture(problem: Problem, seed: int = 0) -> Floats:
    """(n,) joints that the arm may start the problem with.

    Raises:
        InputError: if it cannot hold the object there.
    """
    mode = problem.start.mode or problem.automaton.modes[0].name
    path = tool_path(problem, [mode], np.array([problem.start.mean]))
    trajectory = follow(problem_clearance(problem), path, seed)
    if isinstance(trajectory, ArmFailure):
        raise InputError(
            f"the arm cannot start: {trajectory.sentence}", source=problem.source or None, remedy=trajectory.remedy
        )
    return np.array(trajectory.positions[0])


def problem_clearance(problem: Problem) -> ClearanceModel:
    """The problem's arm, scene and object, with the pairs that must not meet.

    Raises:
        InputError: if the problem has no robot or grasp, or its files cannot be used.
    """
    if problem.robot is None or problem.grasp is None:
        raise InputError("the problem has no robot with a grasp", source=problem.source or None, remedy="add them")
    parts = [part for part in problem.automaton.parts if part.shapes]
    with_shapes = {part.name for part in parts}
    carried = [name for name in carried_parts(problem.automaton, problem.grasp.part) if name in with_shapes]
    if problem.hold is not None:
        # The tool follows the hand; what it has between its fingers is the held part, which may turn there.
        carried = [problem.hold.grip.held.name, problem.hold.grip.moving.name]
    elif problem.grasp.part not in with_shapes:
        parts, carried = [*parts, Part(problem.grasp.part)], [problem.grasp.part, *carried]
    return clearance_model(load_arm(problem.robot), problem.scene, parts, carried)


def tool_path(problem: Problem, modes: Sequence[str], states: Floats) -> ToolPath:
    """Poses of the tool and of the object's parts in K modes and states (K, n), as contacts leave them.

    Raises:
        InputError: if the problem has no grasp.
    """
    grasp = problem.grasp
    if grasp is None:
        raise InputError("the problem has no grasp", source=problem.source or None, remedy="add 'grasp'")
    knots = [settled_poses(problem, mode, x) for mode, x in zip(modes, states, strict=True)]
    touching = None if problem.hold is None else [touching_pairs(problem, poses) for poses in knots]
    moved = {
        name: RigidTransform.from_matrix(np.stack([poses[name].as_matrix() for poses in knots])) for name in knots[0]
    }
    still = RigidTransform.from_matrix(np.tile(np.eye(4), (len(knots), 1, 1)))
    return ToolPath(moved[grasp.part] * grasp.pose, {BASE: still, **moved}, touching)


def carried_parts(automaton: HybridAutomaton, part: str) -> tuple[str, ...]:
    """A part and those attached to it, directly or through others."""
    parts = [part]
    for link in automaton.links:  # parents come first
        if link.parent in parts:
            parts.append(link.child)
    return tuple(parts)


def lowered(
    problem: Problem, mode: str, states: Floats, start: Floats, deadline: Deadline
) -> ArmTrajectory | ArmFailure:
    """The arm along states (K, n) on the way down; the object may meet its support.

    Args:
        start: (J,) joints that the arm is at, nearly.

    Raises:
        TimeLimitError: if it passes before there is a trajectory.
    """
    if problem.hold is None or problem.release is None:
        raise InputError("the problem releases nothing", remedy="add 'release' to a problem with 'hold'")
    path = tool_path(problem, [mode] * len(states), states)
    grip = problem.hold.grip
    meet = frozenset((part, problem.release.support) for part in (grip.held.name, grip.moving.name))
    touching = path.touching or [frozenset()] * len(states)
    path = replace(path, touching=[pairs | meet for pairs in touching])
    return follow(problem_clearance(problem), path, deadline=deadline, start=start)


def withdrawn(
    problem: Problem, rest: Rest, contact: Floats, displacements: Floats, start: Floats, deadline: Deadline
) -> ArmTrajectory | ArmFailure:
    """The arm as its hand goes away, with the gripper open, from an object that stands.

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
    """The robot with its fingers where they are when the gripper is open.

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
