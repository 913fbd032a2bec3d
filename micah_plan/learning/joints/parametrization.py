"""Local parameters of a joint: their names, and the joint after a step.

A joint has fewer freedoms than named parameters, since its origin may be at any pose of the motion. A `JointChart`
spans those freedoms at one joint without singularity: tilts of the axis about the directions of `axis_basis`, rotation
about the centre (about the origin where there is none); shifts of the centre along them; the pitch; rotation and shift
of the origin, except the one along the motion.

Rows in a joint's own frame: u1 towards the part at configuration 0, u2 = axis x u1, and the axis.

There the motion is a turn of the plane, so derivatives are sines, cosines and constants.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from micah_plan.arrays import ROUND_OFF, Floats
from micah_plan.automaton.joint import KINDS, Joint, axis_basis, rigid, twisting
from micah_plan.automaton.kinematics import ROTATION_LENGTH
from micah_plan.learning.joints.quaternions import times
from micah_plan.learning.joints.residuals import compare_all

# Tilt (2), shift of the centre (2), pitch, turn of the origin (3) and its shift (3), along the axes of a joint's frame.
FRAME_NUMBERS, PITCH_NUMBER = 11, 4

_ROTATION = ("rotation_1", "rotation_2", "rotation_3")
_POSITION = ("position_1", "position_2", "position_3")
_LONGEST_STEP = 1.0  # rad, m, m/rad: no linearization holds further


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
    if radius > ROUND_OFF:
        first = arm / radius
    else:
        first, radius = axis_basis(joint.axis)[0], 0.0
    return np.stack([first, cross(axis, first), axis]), radius


def cross(a: Floats, b: Floats) -> Floats:
    """(3,) cross product of two vectors, without the overhead of NumPy's."""
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


@dataclass(frozen=True, eq=False)
class JointChart:
    """Local parameters of a joint.

    Attributes:
        names: (k,) of `automaton.joint.ParameterCovariance`.
        free: (k, p) named parameters per free number. The origin moves across the motion only, as closeness of poses
            with `kinematics.ROTATION_LENGTH` has it: two joints' origins are compared where they come closest.
        in_frame: (11, p) the same steps as numbers of the joint's frame.
        turn: (11, k) numbers of the joint's frame per named parameter; its transpose leads back.
        basis: (2, 3) `axis_basis` of the joint; of no meaning for a rigid one.
    """

    names: tuple[str, ...]
    free: Floats
    in_frame: Floats
    turn: Floats
    basis: Floats


def chart_of(joint: Joint, has_orientation: bool) -> JointChart:
    """The local parameters of a joint; without orientations the part's orientation is excluded."""
    before = KINDS[joint.kind].parameters
    after = (_ROTATION if has_orientation else ()) + _POSITION
    k, size = len(before), len(after)
    pose = _across(_start_direction(joint)[6 - size :]) if joint.moves else np.eye(size)
    free = np.zeros((k + size, k + pose.shape[1]))
    free[:k, :k] = np.eye(k)
    free[k:, k:] = pose
    frame, _ = frame_of(joint)
    basis = axis_basis(joint.axis) if k else np.eye(2, 3)
    change = np.zeros((FRAME_NUMBERS, k + size))
    if k:
        planar = frame[:2] @ basis.T
        change[0:2, 0:2] = planar
        if k > 2:
            change[2:4, 2:4] = planar
        if k > 4:
            change[4, 4] = 1.0
    change[8:, -3:] = frame
    if has_orientation:
        change[5:8, -6:-3] = frame
    return JointChart(before + after, free, change @ free, change, basis)


def stepped(joint: Joint, chart: JointChart, numbers: Floats) -> Joint | None:
    """The joint after a step of the free parameters (p,); None if the step leaves the valid range."""
    step = dict(zip(chart.names, (chart.free @ numbers).tolist(), strict=True))
    if not all(abs(value) <= _LONGEST_STEP for value in step.values()):
        return None
    position = np.array(joint.position) + [step[name] for name in _POSITION]
    quaternion = np.array(joint.quaternion)
    if _ROTATION[0] in step:
        half = 0.5 * np.array([step[name] for name in _ROTATION])
        length = float(np.linalg.norm(half))
        quaternion = times(np.append(np.sinc(length / np.pi) * half, np.cos(length)), quaternion)
    if not joint.moves:
        return rigid(position, quaternion, joint.fixed_at)
    basis, old = chart.basis, np.array(joint.axis)
    # The basis is right-handed with the axis: a tilt about the first direction moves the axis against the second.
    axis = old + step["axis_2"] * basis[0] - step["axis_1"] * basis[1]
    point = np.array(joint.center) + step.get("center_1", 0.0) * basis[0] + step.get("center_2", 0.0) * basis[1]
    return twisting(joint.kind, axis, point, joint.pitch + step.get("pitch", 0.0), position, quaternion)


def _start_direction(joint: Joint) -> Floats:
    """(6,) the motion per configuration at configuration 0."""
    axis = np.array(joint.axis)
    if joint.kind == "prismatic":
        return np.concatenate([np.zeros(3), axis])
    arm = np.subtract(joint.position, joint.center)
    return np.concatenate([axis, cross(axis, arm) + joint.pitch * axis])


def _across(direction: Floats) -> Floats:
    """(d, d - 1) basis of the steps of a pose across a direction (d,); all (d, d) where the direction is 0."""
    scale = np.repeat([ROTATION_LENGTH, 1.0], 3)[6 - len(direction) :]
    mirror = direction * scale
    length = float(np.linalg.norm(mirror))
    if length < ROUND_OFF:
        return np.eye(len(direction))
    # Householder's reflection takes one unit vector to the direction and so the others across it.
    mirror = mirror / length
    largest = int(np.argmax(np.abs(mirror)))
    mirror[largest] += 1.0 if mirror[largest] >= 0 else -1.0
    rest = np.eye(len(mirror)) - np.outer(mirror, mirror) * (2 / float(mirror @ mirror))
    return np.asarray(np.delete(rest, largest, axis=1) / scale[:, None])
