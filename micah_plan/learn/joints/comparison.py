"""Many joints compared with all rows of a track at once, in plain arrays.

The same closed forms as automaton.kinematics (MICAH, section II-B), over (h, n) arrays instead of SciPy's transforms:
a pool of joints against a few hundred rows is then a handful of array operations.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from micah_plan.automaton.joint import Joint
from micah_plan.learn.joints.joint_arrays import JointArrays, arrays_of
from micah_plan.learn.joints.quaternions import conjugate, cross, rotated, rotation_vector, times_matrix

Floats = NDArray[np.float64]

_NEWTON_STEPS = 8
_TINY = 1e-12


@dataclass(frozen=True, eq=False)
class Compared:
    """All n rows as h joints see them, d = 6 [rotation vector (rad), position (m)] or 3 where only positions exist.

    Attributes:
        configuration: (h, n) closest configurations [rad or m], 0 for rigid.
        error: (h, n, d) measured minus model, base frame.
        direction: (h, n, d) J, the derivative of the model's pose by the configuration; 0 for rigid.
    """

    configuration: Floats
    error: Floats
    direction: Floats

    def rows(self, index: NDArray[np.int64]) -> Compared:
        """Some of the rows."""
        return Compared(self.configuration[:, index], self.error[:, index], self.direction[:, index])


def compare_all(
    joints: Sequence[Joint], position: Floats, quaternion: Floats | None, rotation_length: float
) -> Compared:
    """Closest configurations, errors and directions of motion of rows (n, 3), (n, 4) under every joint."""
    return compare_arrays(arrays_of(joints), position, quaternion, rotation_length)


def compare_arrays(
    joints: JointArrays, position: Floats, quaternion: Floats | None, rotation_length: float
) -> Compared:
    """The same for joints that are arrays already.

    Args:
        joints: the h joints.
        position, quaternion: (n, 3) [m] and (n, 4) rows, or (h, n, 3) and (h, n, 4) of each joint its own; quaternion
            None if not measured.
        rotation_length: what weighs rotation against position in "closest" [m/rad].
    """
    turning, moving = joints.turning, joints.moving
    arm = joints.position - joints.center
    arm = (arm - np.sum(arm * joints.axis, axis=1, keepdims=True) * joints.axis) * turning[:, None]
    # Of every joint: its axis, and the arm from it to the origin with the direction in which that turns.
    basis = np.stack([joints.axis, arm, cross(joints.axis, arm)], axis=1)
    from_start = position - joints.position[:, None]
    along, real, imaginary = np.moveaxis(from_start @ basis.swapaxes(1, 2), 2, 0)
    real = real + np.sum(arm**2, axis=1, keepdims=True)
    relative = None
    if quaternion is not None:
        # Of every row: its rotation from the start, and the same followed by half a turn back about the axis.
        start = times_matrix(conjugate(joints.quaternion))
        back = times_matrix(np.concatenate([-joints.axis, np.zeros((len(joints), 1))], axis=1))
        relative, turned = np.split(quaternion @ np.concatenate([start, start @ back], axis=2), 2, axis=2)
        twist, scalar = turned[..., 3], relative[..., 3]
        real += rotation_length**2 * (scalar**2 - twist**2)
        imaginary = imaginary + rotation_length**2 * 2 * scalar * twist
    weight = np.sqrt(real**2 + imaginary**2)
    angle = np.where(turning[:, None] & (weight > _TINY), np.arctan2(imaginary, real), 0.0)
    pitched = np.flatnonzero(np.abs(joints.pitch) > 1e-7)
    if len(pitched):
        angle[pitched] = _balanced(angle[pitched], weight[pitched], along[pitched], joints.pitch[pitched, None])
    if angle.size:
        angle = _unwrapped(angle)
    half_sine, half_cosine = np.sin(0.5 * angle), np.cos(0.5 * angle)
    sine, versine = 2 * half_sine * half_cosine, 2 * half_sine**2
    sliding = moving & ~turning
    configuration = np.where(sliding[:, None], along, angle)
    rate = np.where(turning, joints.pitch, sliding)[:, None]
    error = from_start - np.stack([rate * configuration, -versine, sine], axis=2) @ basis
    moved = np.stack([np.broadcast_to(rate, angle.shape), -sine, 1 - versine], axis=2) @ basis
    if relative is None:
        return Compared(configuration, error, moved)
    rotation = rotation_vector(half_cosine[..., None] * relative + half_sine[..., None] * turned)
    turns = np.broadcast_to((turning[:, None] * joints.axis)[:, None], rotation.shape)
    return Compared(configuration, np.concatenate([rotation, error], axis=2), np.concatenate([turns, moved], axis=2))


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
    side = cross(joints.axis, joints.position - joints.center) + joints.pitch[:, None] * joints.axis
    direction = np.where(joints.turning[:, None], side, joints.axis)
    lever = direction / np.maximum(np.sum(direction**2, axis=1, keepdims=True), _TINY)
    if not in_part:
        return np.asarray(lever)
    from_base = conjugate(joints.quaternion)
    return rotated(from_base, lever)


def _balanced(angle: Floats, weight: Floats, along: Floats, pitch: Floats) -> Floats:
    """Minimise -2 weight cos(c - angle) + (along - pitch c)² by parabolas from above, whole turns by the pitch."""
    turns = np.round((along / pitch - angle) / (2 * np.pi))
    # Whole turns only where the pitch is large against noise; a small one is left to continuity.
    c = angle + 2 * np.pi * np.where(np.abs(pitch) * 2 * np.pi > 0.05, turns, 0.0)
    target = c
    for _ in range(_NEWTON_STEPS):
        slope = weight * np.sin(c - target) - pitch * (along - pitch * c)
        step = slope / np.maximum(weight + pitch**2, _TINY)
        c = c - step
        if np.abs(step).max(initial=0.0) < _TINY:
            break
    return np.asarray(c)
