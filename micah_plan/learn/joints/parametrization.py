"""The free numbers of a joint: what they are called and how they move it.

A joint has fewer freedoms than named parameters, for its origin may be counted from any pose of the motion. A `Chart`
spans those freedoms at one joint without singularity: tilts of the axis about the directions of `axis_basis`, turning
about the centre (about the origin where there is none); shifts of the centre along them; the pitch; turn and shift of
the origin, save the one along the motion.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from micah_plan.arrays import Floats
from micah_plan.automaton.joint import KINDS, Joint, axis_basis, rigid, twisting
from micah_plan.automaton.kinematics import ROTATION_LENGTH
from micah_plan.learn.joints.joint_arrays import times
from micah_plan.learn.joints.joint_frame import cross, frame_of

# Tilt (2), shift of the centre (2), pitch, turn of the origin (3) and its shift (3), along the axes of a joint's frame.
FRAME_NUMBERS = 11

_ROTATION = ("rotation_1", "rotation_2", "rotation_3")
_POSITION = ("position_1", "position_2", "position_3")
_LONGEST_STEP = 1.0  # rad, m, m/rad: no linearization holds further
_SHORTEST = 1e-9  # m; a direction shorter than that is none


@dataclass(frozen=True, eq=False)
class Chart:
    """Free numbers around a joint.

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


def chart_of(joint: Joint, has_orientation: bool) -> Chart:
    """The free numbers of a joint; without orientations the part's is none of them."""
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
    return Chart(before + after, free, change @ free, change, basis)


def stepped(joint: Joint, chart: Chart, numbers: Floats) -> Joint | None:
    """The joint after a step of the free numbers (p,); None where the step is too long to mean anything."""
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
    if length < _SHORTEST:
        return np.eye(len(direction))
    # Householder's reflection takes one unit vector to the direction and so the others across it.
    mirror = mirror / length
    largest = int(np.argmax(np.abs(mirror)))
    mirror[largest] += 1.0 if mirror[largest] >= 0 else -1.0
    rest = np.eye(len(mirror)) - np.outer(mirror, mirror) * (2 / float(mirror @ mirror))
    return np.asarray(np.delete(rest, largest, axis=1) / scale[:, None])
