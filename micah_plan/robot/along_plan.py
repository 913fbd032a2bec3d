"""The arm along a plan: tool poses of the knots, and the joint trajectory through them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import RigidTransform

from micah_plan.arrays import Floats
from micah_plan.automaton.graph import BASE
from micah_plan.automaton.hybrid import HybridAutomaton, Part
from micah_plan.errors import InputError
from micah_plan.robot.clearance import ClearanceModel, clearance_model
from micah_plan.robot.load_arm import load_arm
from micah_plan.robot.tool_path import ArmFailure, ToolPath, follow
from micah_plan.task.contact_poses import settled_poses, touching_pairs
from micah_plan.task.deadline import NEVER, Deadline
from micah_plan.task.plan import ArmTrajectory, Trajectory
from micah_plan.task.problem import Problem


def arm_along(
    problem: Problem,
    trajectory: Trajectory,
    seed: int = 0,
    deadline: Deadline = NEVER,
    start: Floats | None = None,
) -> ArmTrajectory | ArmFailure:
    """The arm's trajectory that moves the held part along the means of a plan, or its failure.

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
    """(n,) initial joints of the arm.

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
    """The problem's arm, scene and object, with the pairs that must not touch.

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
    """A part and those attached to it, directly or indirectly."""
    parts = [part]
    for link in automaton.links:  # parents come first
        if link.parent in parts:
            parts.append(link.child)
    return tuple(parts)
