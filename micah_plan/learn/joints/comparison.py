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
from micah_plan.learn.joints.quaternions import conjugate, cross, rotated, rotation_vector, times

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
        position, quaternion: (n, 3) [m] and (n, 4) rows; quaternion None if not measured.
        rotation_length: what weighs rotation against position in "closest" [m/rad].
    """
    h, n = len(joints), len(position)
    axis, center, start = joints.axis[:, None], joints.center[:, None], joints.position[:, None]
    pitch, turning = joints.pitch[:, None], joints.turning[:, None]
    sliding = joints.moving[:, None] & ~turning
    along = np.einsum("hnk,hk->hn", position[None] - start, joints.axis)
    arm0 = start - center
    arm0 = arm0 - np.sum(arm0 * axis, axis=2, keepdims=True) * axis
    side = cross(axis, arm0)
    arm = position[None] - center
    real = np.einsum("hnk,hk->hn", arm, arm0[:, 0])
    imaginary = np.einsum("hnk,hk->hn", arm, side[:, 0])
    relative = None
    if quaternion is not None:
        relative = times(np.broadcast_to(quaternion, (h, n, 4)), conjugate(joints.quaternion)[:, None])
        twist = np.einsum("hnk,hk->hn", relative[..., :3], joints.axis)
        real = real + rotation_length**2 * (relative[..., 3] ** 2 - twist**2)
        imaginary = imaginary + rotation_length**2 * 2 * relative[..., 3] * twist
    angle = np.arctan2(imaginary, real)
    weight = np.hypot(real, imaginary)
    angle = np.where(weight > _TINY, angle, 0.0)
    pitched = np.flatnonzero(np.abs(joints.pitch) > 1e-7)
    if len(pitched):
        angle[pitched] = _balanced(angle[pitched], weight[pitched], along[pitched], pitch[pitched])
    turned = np.where(turning, angle, 0.0)
    if n:
        turned = np.unwrap(turned, axis=1)
    cosine, sine = np.cos(turned)[..., None], np.sin(turned)[..., None]
    # Model position: centre + rotated arm + what lies along the axis.
    lengthwise = start - center - arm0
    reach = center + lengthwise + cosine * arm0 + sine * side + (pitch * turned)[..., None] * axis
    model = np.where(turning[..., None], reach, start + np.where(sliding, along, 0.0)[..., None] * axis)
    error = position[None] - model
    moved = np.where(turning[..., None], cosine * side - sine * arm0 + pitch[..., None] * axis, 0.0)
    moved = moved + sliding[..., None] * axis
    configuration = np.where(turning, turned, np.where(sliding, along, 0.0))
    if relative is None:
        return Compared(configuration, error, moved)
    half = np.concatenate([np.sin(turned / 2)[..., None] * axis, np.cos(turned / 2)[..., None]], axis=2)
    rotation = rotation_vector(times(relative, conjugate(half)))
    turns = np.broadcast_to(turning[..., None] * axis, rotation.shape)
    return Compared(configuration, np.concatenate([rotation, error], axis=2), np.concatenate([turns, moved], axis=2))


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
        c = c - slope / np.maximum(weight + pitch**2, _TINY)
    return np.asarray(c)
