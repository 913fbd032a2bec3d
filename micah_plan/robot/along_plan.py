"""The arm along a plan: which pose of the tool each knot asks for, and the joints that take it there."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from micah_plan.automaton.graph import BASE
from micah_plan.automaton.hybrid import HybridAutomaton, Part
from micah_plan.errors import InputError
from micah_plan.robot.clearance import ClearanceModel, Pair, clearance_model
from micah_plan.robot.load_arm import load_arm
from micah_plan.robot.tool_path import ArmFailure, PathSettings, ToolPath, follow
from micah_plan.task.contact_poses import settled_poses, touching_pairs
from micah_plan.task.deadline import NEVER, Deadline
from micah_plan.task.plan import ArmTrajectory, Trajectory
from micah_plan.task.problem import Problem

Floats = NDArray[np.float64]


def arm_along(
    problem: Problem,
    trajectory: Trajectory,
    seed: int = 0,
    settings: PathSettings | None = None,
    touching: Sequence[frozenset[Pair]] | None = None,
    deadline: Deadline = NEVER,
    start: Floats | None = None,
) -> ArmTrajectory | ArmFailure:
    """The arm's trajectory that takes the held part along the means of a plan, or what stands in the way.

    Args:
        problem: with a robot and a grasp.
        trajectory: over K knots.
        seed: of the start postures.
        touching: (K,) pairs (part, body of the scene) that may meet at each knot; None: those of the contacts that a
            held object is to make, none for others.
        deadline: when to end.
        start: (n,) joints that the arm is at, nearly; None: it may start in any posture.

    Raises:
        TimeLimitError: if it passes before there is a trajectory.
        InputError: if the problem has no robot or grasp, or its files cannot be used.
    """
    path = tool_path(problem, trajectory, touching)
    return follow(problem_clearance(problem), path, seed, settings, deadline, start)


def start_posture(problem: Problem, seed: int = 0) -> Floats:
    """(n,) joints that the arm may start the problem with.

    Raises:
        InputError: if it cannot hold the object there.
    """
    start = problem.start
    mode = start.mode or problem.automaton.modes[0].name
    poses = settled_poses(problem, mode, np.array(start.mean))
    found = follow(problem_clearance(problem), _path(problem, [poses]), seed)
    if isinstance(found, ArmFailure):
        raise InputError(f"the arm cannot start: {found.sentence}", source=problem.source or None, remedy=found.remedy)
    return np.array(found.positions[0])


def problem_clearance(problem: Problem) -> ClearanceModel:
    """The problem's arm, scene and object, with the pairs that must not meet.

    Raises:
        InputError: if the problem has no robot or grasp, or its files cannot be used.
    """
    if problem.robot is None or problem.grasp is None:
        raise InputError("the problem has no robot with a grasp", source=problem.source or None, remedy="add them")
    parts = [part for part in problem.automaton.parts if part.shapes]
    known = {part.name for part in parts}
    held = [name for name in carried_parts(problem.automaton, problem.grasp.part) if name in known]
    if problem.hold is not None:
        # The tool follows the hand; what it has between its fingers is the held part, which may turn there.
        held = [problem.hold.grip.held.name, problem.hold.grip.moving.name]
    elif problem.grasp.part not in known:
        parts, held = [*parts, Part(problem.grasp.part)], [problem.grasp.part, *held]
    return clearance_model(load_arm(problem.robot), problem.scene, parts, held)


def tool_path(problem: Problem, trajectory: Trajectory, touching: Sequence[frozenset[Pair]] | None = None) -> ToolPath:
    """Poses of the tool and of the object's parts at the knots of a plan, as contacts leave them.

    Raises:
        InputError: if the problem has no grasp.
    """
    states = trajectory.of_first(problem.automaton.n).means
    knots = [settled_poses(problem, mode, x) for mode, x in zip(trajectory.modes, states, strict=True)]
    return _path(problem, knots, touching)


def _path(
    problem: Problem,
    knots: Sequence[dict[str, RigidTransform]],
    touching: Sequence[frozenset[Pair]] | None = None,
) -> ToolPath:
    grasp = problem.grasp
    if grasp is None:
        raise InputError("the problem has no grasp", source=problem.source or None, remedy="add 'grasp'")
    if touching is None and problem.hold is not None:
        touching = [touching_pairs(problem, poses) for poses in knots]
    moved = {
        name: RigidTransform.from_matrix(np.stack([poses[name].as_matrix() for poses in knots])) for name in knots[0]
    }
    still = RigidTransform.from_matrix(np.tile(np.eye(4), (len(knots), 1, 1)))
    return ToolPath(moved[grasp.part] * grasp.pose, {BASE: still, **moved}, touching)


def carried_parts(automaton: HybridAutomaton, part: str) -> tuple[str, ...]:
    """A part and those attached to it, directly or through others."""
    found = [part]
    for link in automaton.links:  # parents come first
        if link.parent in found:
            found.append(link.child)
    return tuple(found)
