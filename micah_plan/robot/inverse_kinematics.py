"""Inverse kinematics within joint limits: `reach_pose` for one pose, `next_pose` along a path.

Levenberg-Marquardt with damping that follows the error (Sugihara, "Solvability-unconcerned inverse kinematics by the
Levenberg-Marquardt method", IEEE T-RO 2011); joints that would leave their limits stop there and the others go on.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from micah_plan.arrays import TINY, Floats
from micah_plan.robot.arm import Arm

POSE_TOLERANCE = 1e-8
_DAMPING = 1e-2
_LONGEST_STEP = 0.5


class Reached(NamedTuple):
    """Final state of the iteration.

    Attributes:
        q: (n,) configuration within the limits.
        error: (6,) [rotation vector (rad), translation (m)] from the tool to the target, base frame.
        stopped: (n,) whether a joint stopped at a limit in the last step.
    """

    q: Floats
    error: Floats
    stopped: NDArray[np.bool_]

    @property
    def done(self) -> bool:
        """Whether the pose is reached within `POSE_TOLERANCE` [rad and m]."""
        return bool(np.abs(self.error).max() < POSE_TOLERANCE)


def pose_error(target: Floats, actual: Floats) -> Floats:
    """(6,) [rotation vector (rad), translation (m)] from a pose (4, 4) to a target (4, 4), base frame."""
    return np.concatenate([pin.log3(target[:3, :3] @ actual[:3, :3].T), target[:3, 3] - actual[:3, 3]])


def reach_pose(arm: Arm, target: Floats, q: Floats, limits: tuple[Floats, Floats], iterations: int = 60) -> Reached:
    """The configuration near q (n,) with the tool at pose `target` (4, 4), or the closest approach.

    Args:
        limits: lower and upper, (n,) each; q is within them.
    """
    stopped = np.zeros(arm.n, dtype=bool)
    error = pose_error(target, arm.matrix(q))
    for _ in range(iterations):
        if np.abs(error).max() < POSE_TOLERANCE:
            break
        step, stopped = _bounded_step(arm.jacobian(q), error, limits[0] - q, limits[1] - q)
        longest = float(np.abs(step).max())
        if longest < 1e-13:
            break
        q = np.clip(q + step * min(1.0, _LONGEST_STEP / longest), *limits)
        error = pose_error(target, arm.matrix(q))
    return Reached(q, error, stopped)


def next_pose(arm: Arm, target: Floats, q: Floats, wish: Floats, limits: tuple[Floats, Floats]) -> Reached:
    """The configuration at the next pose of a path, near q (n,), with the null-space part of a desired step (n,)."""
    start = np.clip(q + null_step(arm, q, wish, limits), *limits)
    reached = reach_pose(arm, target, start, limits)
    return reached if reached.done else reach_pose(arm, target, q, limits)


def null_step(arm: Arm, q: Floats, wish: Floats, limits: tuple[Floats, Floats]) -> Floats:
    """Null-space projection of a step (n,), to first order; joints at a limit stay."""
    free = ((q > limits[0]) | (wish > 0)) & ((q < limits[1]) | (wish < 0))
    jacobian = arm.jacobian(q)[:, free]
    # Directions that hardly move the tool count as null space only where they do not move it at all.
    _, values, directions = np.linalg.svd(jacobian, full_matrices=True)
    rank = int((values > 1e-6).sum())
    step = np.zeros(arm.n)
    basis = directions[rank:]
    step[free] = basis.T @ (basis @ wish[free])
    return step


def _bounded_step(jacobian: Floats, error: Floats, below: Floats, above: Floats) -> tuple[Floats, NDArray[np.bool_]]:
    """(damped least-squares step within [below, above], joints at these bounds)."""
    n = jacobian.shape[1]
    damping = _DAMPING * float(error @ error) + TINY
    free, step = np.ones(n, dtype=bool), np.zeros(n)
    for _ in range(n):
        columns = jacobian[:, free]
        residual = error - jacobian[:, ~free] @ step[~free]
        step[free] = columns.T @ np.linalg.solve(columns @ columns.T + damping * np.eye(6), residual)
        outside = free & ((step < below) | (step > above))
        if not outside.any():
            break
        step[outside] = np.clip(step[outside], below[outside], above[outside])
        free &= ~outside
        if not free.any():
            break
    return step, ~free
