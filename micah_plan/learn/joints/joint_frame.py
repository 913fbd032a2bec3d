"""Rows in a joint's own frame: u1 towards the part at configuration 0, u2 = axis x u1, and the axis.

There the motion is a turn of the plane, so derivatives are sines, cosines and constants.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from micah_plan.arrays import Floats
from micah_plan.automaton.joint import Joint, axis_basis
from micah_plan.learn.joints.joint_arrays import compare_all

_ON_THE_AXIS = 1e-9  # m


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
    compared = compare_all([joint], position, quaternion, rotation_length)
    c = compared.configuration[0]
    *rotation, shift = frame @ compared.error[0].reshape(-1, 3, len(c))
    if joint.turns:
        (x, y, z), cosine, sine = shift, np.cos(c), np.sin(c)
        shift = np.stack([x * cosine + y * sine, y * cosine - x * sine, z])
    return Seen(c, shift.T, rotation[0].T if rotation else None, radius, frame)


def frame_of(joint: Joint) -> tuple[Floats, float]:
    """(3, 3) rows u1, u2 and the axis of a joint's own frame (the base's for a rigid one), and its radius [m].

    u1 points from the axis to the part's origin; where that is on the axis it is the first of `axis_basis`.
    """
    if not joint.moves:
        return np.eye(3), 0.0
    axis = np.array(joint.axis)
    arm = np.subtract(joint.position, joint.center) if joint.turns else np.zeros(3)
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
