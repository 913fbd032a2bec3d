"""Rows in a joint's own frame: u1 towards the part at configuration 0, u2 = axis x u1, and the axis.

There the motion is a turn of the plane, so the closest configuration and the errors take a few operations per row. The
same closed forms as automaton.kinematics (MICAH, section IV-A) in plain arrays, for one joint and all rows.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from micah_plan.arrays import Floats
from micah_plan.automaton.joint import Joint, axis_basis
from micah_plan.learn.joints.quaternions import rotation_vector, times_matrix

_ON_THE_AXIS = 1e-9  # m
_TINY = 1e-18
_NEWTON_STEPS = 6
_TELLING_PITCH = 0.05  # m per turn; a smaller one cannot count whole turns


@dataclass(frozen=True, eq=False)
class Seen:
    """Rows in the frame of a joint.

    Attributes:
        configuration: (n,) closest configurations [rad or m].
        position_error: (n, 3) measured minus model [m], for a turning joint along its radius, its tangent and its axis.
        rotation_error: (n, 3) [rad] along u1, u2 and the axis; None without orientations.
        radius: of the part about the axis [m].
        frame: (3, 3) rows u1, u2 and the axis.
    """

    configuration: Floats
    position_error: Floats
    rotation_error: Floats | None
    radius: float
    frame: Floats

    def squares(self) -> list[Floats]:
        """(n,) squared errors of positions [m²] and, where measured, of rotations [rad²]."""
        both = [self.position_error] if self.rotation_error is None else [self.position_error, self.rotation_error]
        return [np.einsum("ij,ij->i", e, e) for e in both]


def seen_by(joint: Joint, position: Floats, quaternion: Floats | None, rotation_length: float) -> Seen:
    """Rows (n, 3), (n, 4) at their closest configurations, in the joint's frame.

    Args:
        rotation_length: weight of rotation against position [m/rad].
    """
    frame, radius = frame_of(joint)
    relative = None
    if quaternion is not None:
        # In the frame's coordinates: the vector part turns like any vector.
        relative = quaternion @ times_matrix(np.array(joint.quaternion) * [-1.0, -1.0, -1.0, 1.0])
        relative = np.concatenate([relative[:, :3] @ frame.T, relative[:, 3:]], axis=1)
    if joint.kind in ("rigid", "prismatic"):
        error = (position - joint.position) @ frame.T
        c = np.zeros(len(error))
        if joint.kind == "prismatic":
            c = error[:, 2].copy()
            error[:, 2] = 0.0
        turns = None if relative is None else rotation_vector(relative)
        return Seen(c, error, turns, radius, frame)
    local = (position - joint.center) @ frame.T
    c = _angles(joint, radius, local, relative, rotation_length)
    cosine, sine = np.cos(c), np.sin(c)
    x, y = local[:, 0], local[:, 1]
    error = np.stack([x * cosine + y * sine - radius, y * cosine - x * sine, local[:, 2] - joint.pitch * c], axis=1)
    turns = None
    if relative is not None:
        half_cosine, half_sine = np.cos(0.5 * c), -np.sin(0.5 * c)
        i, j, k, w = relative.T
        back = [i * half_cosine + j * half_sine, j * half_cosine - i * half_sine]
        back += [k * half_cosine + w * half_sine, w * half_cosine - k * half_sine]
        turns = rotation_vector(np.stack(back, axis=1))
    return Seen(c, error, turns, radius, frame)


def frame_of(joint: Joint) -> tuple[Floats, float]:
    """(3, 3) rows u1, u2 and the axis of a joint's own frame (the base's for a rigid one), and its radius [m].

    u1 points from the axis to the part's origin; where that is on the axis it is the first of `axis_basis`.
    """
    if joint.kind == "rigid":
        return np.eye(3), 0.0
    axis = np.array(joint.axis)
    arm = np.subtract(joint.position, joint.center) if joint.kind != "prismatic" else np.zeros(3)
    arm = arm - (arm @ axis) * axis
    radius = math.sqrt(float(arm @ arm))
    if radius > _ON_THE_AXIS:
        first = arm / radius
    else:
        first, radius = axis_basis(joint.axis)[0], 0.0
    return np.stack([first, cross(axis, first), axis]), radius


def cross(a: Floats, b: Floats) -> Floats:
    """(3,) cross product of two vectors, without the overhead of NumPy's."""
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def _angles(joint: Joint, radius: float, local: Floats, relative: Floats | None, rotation_length: float) -> Floats:
    """(n,) closest angles, continuous from row to row (see automaton.kinematics for the closed form)."""
    real, imaginary = radius * local[:, 0], radius * local[:, 1]
    if relative is not None:
        real = real + rotation_length**2 * (relative[:, 3] ** 2 - relative[:, 2] ** 2)
        imaginary = imaginary + rotation_length**2 * 2 * relative[:, 3] * relative[:, 2]
    target, weight = np.arctan2(imaginary, real), np.hypot(real, imaginary)
    if not joint.pitch:
        return target
    if abs(joint.pitch) * 2 * np.pi > _TELLING_PITCH:
        target = target + 2 * np.pi * np.round((local[:, 2] / joint.pitch - target) / (2 * np.pi))
    else:
        target = np.unwrap(target)
    c = target
    for _ in range(_NEWTON_STEPS):
        slope = weight * np.sin(c - target) - joint.pitch * (local[:, 2] - joint.pitch * c)
        curvature = weight * np.maximum(np.cos(c - target), 0.5) + joint.pitch**2
        c = c - slope / np.maximum(curvature, _TINY)
    return np.asarray(c)
