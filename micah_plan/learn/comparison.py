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
    h, n = len(joints), len(position)
    axis = np.array([j.axis for j in joints]).reshape(h, 1, 3)
    center = np.array([j.center for j in joints]).reshape(h, 1, 3)
    start = np.array([j.position for j in joints]).reshape(h, 1, 3)
    pitch = np.array([j.pitch if j.kind == "screw" else 0.0 for j in joints]).reshape(h, 1)
    turning = np.array([j.kind in ("revolute", "screw") for j in joints]).reshape(h, 1)
    sliding = np.array([j.kind == "prismatic" for j in joints]).reshape(h, 1)
    along = np.einsum("hnk,hk->hn", position[None] - start, axis[:, 0])
    arm, arm0 = position[None] - center, start - center
    arm0 = arm0 - np.sum(arm0 * axis, axis=2, keepdims=True) * axis
    side = np.cross(axis, arm0)
    real = np.einsum("hnk,hk->hn", arm, arm0[:, 0])
    imaginary = np.einsum("hnk,hk->hn", arm, side[:, 0])
    relative = None
    if quaternion is not None:
        first = np.array([j.quaternion for j in joints]).reshape(h, 1, 4)
        relative = _times(np.broadcast_to(quaternion, (h, n, 4)), _conjugate(first))
        twist = np.sum(relative[..., :3] * axis, axis=2)
        real = real + rotation_length**2 * (relative[..., 3] ** 2 - twist**2)
        imaginary = imaginary + rotation_length**2 * 2 * relative[..., 3] * twist
    angle = np.arctan2(imaginary, real)
    weight = np.hypot(real, imaginary)
    angle = np.where(weight > _TINY, angle, 0.0)
    if (np.abs(pitch) > 1e-7).any():
        angle = _balanced(angle, weight, along, pitch)
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
    rotation = _rotation_vector(_times(relative, _conjugate(half)))
    turns = np.broadcast_to(turning[..., None] * axis, rotation.shape)
    return Compared(configuration, np.concatenate([rotation, error], axis=2), np.concatenate([turns, moved], axis=2))


def _balanced(angle: Floats, weight: Floats, along: Floats, pitch: Floats) -> Floats:
    """Minimise -2 weight cos(c - angle) + (along - pitch c)² by parabolas from above, whole turns by the pitch."""
    has = np.abs(pitch) > 1e-7
    safe = np.where(has, pitch, 1.0)
    turns = np.where(has, np.round((along / safe - angle) / (2 * np.pi)), 0.0)
    # Whole turns only where the pitch is large against noise; a small one is left to continuity.
    c = angle + 2 * np.pi * np.where(np.abs(pitch) * 2 * np.pi > 0.05, turns, 0.0)
    target = c
    for _ in range(_NEWTON_STEPS):
        slope = weight * np.sin(c - target) - pitch * (along - pitch * c)
        c = c - slope / np.maximum(weight + pitch**2, _TINY)
    return np.asarray(c)


def _times(a: Floats, b: Floats) -> Floats:
    """Products of quaternions, scalar last."""
    vector = a[..., 3:] * b[..., :3] + b[..., 3:] * a[..., :3] + np.cross(a[..., :3], b[..., :3])
    scalar = a[..., 3:] * b[..., 3:] - np.sum(a[..., :3] * b[..., :3], axis=-1, keepdims=True)
    return np.concatenate([vector, scalar], axis=-1)


def _conjugate(q: Floats) -> Floats:
    return np.asarray(q * np.array([-1.0, -1.0, -1.0, 1.0]))


def _rotation_vector(q: Floats) -> Floats:
    q = np.where(q[..., 3:] < 0, -q, q)
    length = np.linalg.norm(q[..., :3], axis=-1, keepdims=True)
    angle = 2 * np.arctan2(length, q[..., 3:])
    return np.asarray(q[..., :3] * np.where(length > _TINY, angle / np.maximum(length, _TINY), 2.0))
