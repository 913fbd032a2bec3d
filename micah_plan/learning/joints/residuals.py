"""Comparison of many joints with all rows of a track, in plain arrays.

The same closed forms as automaton.kinematics (MICAH, section II-B), over (h, n) arrays instead of SciPy's transforms:
a pool of joints against a few hundred rows is then a handful of array operations.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from micah_plan.arrays import TINY, Booleans, Floats, Ints
from micah_plan.automaton.joint import Joint
from micah_plan.automaton.kinematics import balanced
from micah_plan.learning.joints.joint_arrays import JointArrays, arrays_of
from micah_plan.learning.joints.quaternions import (
    conjugate,
    cross_products,
    rotated,
    rotation_vectors,
    times_matrix,
)

_LEAST_PITCH = 0.05 / (2 * np.pi)  # m/rad


@dataclass(frozen=True, eq=False)
class Compared:
    """All n rows in the frames of h joints, d = 6 [rotation vector (rad), position (m)] or 3 with positions only.

    Attributes:
        configuration: (h, n) closest configurations [rad or m], 0 for rigid.
        error: (h, d, n) measured minus model, base frame. Rows last: NumPy is slow at rows of three numbers.
        direction: (h, d, n) J, the derivative of the model's pose by the configuration; 0 for rigid.
    """

    configuration: Floats
    error: Floats
    direction: Floats

    def rows(self, index: Ints) -> Compared:
        """Some rows (h, k) of each joint."""
        wide = index[:, None]
        return Compared(
            np.take_along_axis(self.configuration, index, axis=1),
            np.take_along_axis(self.error, wide, axis=2),
            np.take_along_axis(self.direction, wide, axis=2),
        )

    def take(self, index: Ints | Booleans | slice) -> Compared:
        """The joints with these indices."""
        return Compared(self.configuration[index], self.error[index], self.direction[index])

    def where(self, condition: Booleans, alternative: Compared) -> Compared:
        """These joints where a condition (h,) holds, the alternatives where not."""
        narrow, wide = condition[:, None], condition[:, None, None]
        return Compared(
            np.where(narrow, self.configuration, alternative.configuration),
            np.where(wide, self.error, alternative.error),
            np.where(wide, self.direction, alternative.direction),
        )


def compare_all(
    joints: Sequence[Joint], position: Floats, quaternion: Floats | None, rotation_length: float
) -> Compared:
    """Closest configurations, errors and directions of motion of rows (n, 3), (n, 4) under every joint."""
    return compare_arrays(arrays_of(joints), position, quaternion, rotation_length)


def compare_arrays(
    joints: JointArrays, position: Floats, quaternion: Floats | None, rotation_length: float | Floats
) -> Compared:
    """`compare_all` for joints that are arrays.

    Args:
        joints: the h joints.
        position, quaternion: (n, 3) [m] and (n, 4) rows, or (h, n, 3) and (h, n, 4) of each joint its own; quaternion
            None if not measured.
        rotation_length: weight of rotation against position in "closest" [m/rad], one number or one per joint (h, 1).
    """
    turning, moving = joints.turning, joints.moving
    arm = joints.position - joints.center
    arm = (arm - np.sum(arm * joints.axis, axis=1, keepdims=True) * joints.axis) * turning[:, None]
    # Of every joint: its axis, and the arm from it to the origin with the direction in which that turns.
    basis = np.stack([joints.axis, arm, cross_products(joints.axis, arm)], axis=1)
    from_start = np.ascontiguousarray(position.swapaxes(-1, -2)) - joints.position[..., None]
    along, real, imaginary = (basis @ from_start).swapaxes(0, 1)
    real += np.sum(arm**2, axis=1, keepdims=True)
    relative = None
    if quaternion is not None:
        # Of every row: its rotation from the start, and the same followed by half a turn back about the axis.
        start = times_matrix(conjugate(joints.quaternion))
        back = times_matrix(np.concatenate([-joints.axis, np.zeros((len(joints), 1))], axis=1))
        relative = np.concatenate([start, start @ back], axis=2).swapaxes(1, 2) @ quaternion.swapaxes(-1, -2)
        scalar, twist = relative[:, 3], relative[:, 7]
        real += rotation_length**2 * (scalar**2 - twist**2)
        imaginary += rotation_length**2 * 2 * scalar * twist
    weight = np.sqrt(real**2 + imaginary**2)
    angle = np.where(turning[:, None] & (weight > TINY), np.arctan2(imaginary, real), 0.0)
    pitched = np.flatnonzero(np.abs(joints.pitch) > 1e-7)
    if len(pitched):
        pitch = joints.pitch[pitched, None]
        # Whole turns only where the pitch is large against noise; a small one is left to continuity.
        turns = np.round((along[pitched] / pitch - angle[pitched]) / (2 * np.pi))
        counted = angle[pitched] + 2 * np.pi * np.where(np.abs(pitch) > _LEAST_PITCH, turns, 0.0)
        angle[pitched] = balanced(counted, weight[pitched], along[pitched], pitch)
    if angle.size:
        angle = _unwrapped(angle)
    half_sine, half_cosine = np.sin(0.5 * angle), np.cos(0.5 * angle)
    sliding = moving & ~turning
    configuration = np.where(sliding[:, None], along, angle)
    h, n = angle.shape
    # The displacement from the start, and the direction of motion, along the basis.
    way = np.empty((h, 3, 2, n))
    rate = np.where(turning, joints.pitch, sliding)[:, None]
    way[:, 2, 0], way[:, 1, 0], way[:, 0, 1] = 2 * half_sine * half_cosine, -2 * half_sine**2, rate
    way[:, 0, 0], way[:, 1, 1], way[:, 2, 1] = rate * configuration, -way[:, 2, 0], 1 + way[:, 1, 0]
    moved = (basis.swapaxes(1, 2) @ way.reshape(h, 3, 2 * n)).reshape(h, 3, 2, n)
    if relative is None:
        return Compared(configuration, from_start - moved[:, :, 0], moved[:, :, 1])
    error, direction = np.empty((h, 6, n)), np.empty((h, 6, n))
    np.subtract(from_start, moved[:, :, 0], out=error[:, 3:])
    residual = half_cosine[:, None] * relative[:, :4] + half_sine[:, None] * relative[:, 4:]
    error[:, :3] = rotation_vectors(residual)
    direction[:, :3], direction[:, 3:] = (turning[:, None] * joints.axis)[..., None], moved[:, :, 1]
    return Compared(configuration, error, direction)


def _unwrapped(angle: Floats) -> Floats:
    """Angles (h, n) without jumps of more than half a turn, as `np.unwrap` has them."""
    turns = np.round(np.diff(angle, axis=1) / (2 * np.pi))
    if turns.any():
        angle = angle.copy()
        angle[:, 1:] -= 2 * np.pi * np.cumsum(turns, axis=1)
    return angle


def levers(joints: JointArrays, in_part: bool) -> Floats:
    """(h, 3) J⁻¹ for a displacement of the part's origin: configuration per displacement [rad or m per m].

    In the part's frame (`in_part`) the direction in which a joint moves the part's origin is constant (MICAH, section
    IV-A); in the base frame it is the one at configuration 0.
    """
    side = cross_products(joints.axis, joints.position - joints.center) + joints.pitch[:, None] * joints.axis
    direction = np.where(joints.turning[:, None], side, joints.axis)
    lever = direction / np.maximum(np.sum(direction**2, axis=1, keepdims=True), TINY)
    if not in_part:
        return np.asarray(lever)
    from_base = conjugate(joints.quaternion)
    return rotated(from_base, lever)
