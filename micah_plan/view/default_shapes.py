"""What to draw for parts whose model describes no shapes: sizes follow the joint."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from micah_plan.automaton.hybrid import Primitive
from micah_plan.automaton.joint import Joint
from micah_plan.automaton.kinematics import origin
from micah_plan.view.palette import BODY, MUTED
from micah_plan.view.solids import perpendicular

Floats = NDArray[np.float64]

_SMALLEST = 0.02


def moving_shapes(joint: Joint, reach: float) -> tuple[Primitive, ...]:
    """Shapes of a moving part, in its own frame.

    A thin panel from the axis to the part's origin for revolute and screw, a box along the motion for prismatic, a
    small cube for rigid.

    Args:
        joint: that moves the part.
        reach: length of its motion, to scale a prismatic part by [m].
    """
    pose = origin(joint)
    if joint.kind == "rigid":
        return (_box(pose, pose.translation, np.eye(3), (_SMALLEST,) * 3),)
    axis = np.array(joint.axis)
    if joint.kind == "prismatic":
        length = max(reach, 2 * _SMALLEST)
        frame = _level_frame(axis)
        return (_box(pose, pose.translation, frame, (length, 0.7 * length, 0.35 * length)),)
    arm = np.array(joint.position) - joint.center
    radius = float(np.linalg.norm(arm))
    if radius < _SMALLEST / 4:
        return (_box(pose, pose.translation, np.eye(3), (_SMALLEST,) * 3),)
    frame = np.column_stack([arm / radius, np.cross(axis, arm / radius), axis])
    return (_box(pose, joint.center + arm / 2, frame, (radius, 0.05 * radius, 0.75 * radius)),)


def base_shapes(joint: Joint, reach: float) -> tuple[Primitive, ...]:
    """Shapes of the base that carries a joint, in the base frame: a post on the axis, or a rail under the motion."""
    axis, position = np.array(joint.axis), np.array(joint.position)
    if joint.kind == "rigid":
        return ()
    if joint.kind == "prismatic":
        length = max(reach, 2 * _SMALLEST)
        frame = _level_frame(axis)
        center = position + axis * length / 2 - frame[:, 2] * 0.22 * length
        return (_box(RigidTransform.identity(), center, frame, (2 * length, 0.75 * length, 0.04 * length), MUTED),)
    radius = max(float(np.linalg.norm(position - joint.center)), _SMALLEST)
    across = perpendicular(axis)
    upright = Rotation.from_matrix(np.column_stack([across, np.cross(axis, across), axis])).as_quat()
    size = (0.06 * radius, 0.85 * radius)
    return (Primitive("cylinder", size, _triple(joint.center), _quadruple(upright), MUTED),)


def _level_frame(axis: Floats) -> Floats:
    """(3, 3) right-handed axes in columns: the motion, across it, and as upright as possible."""
    upright = np.array([0.0, 0.0, 1.0]) - axis[2] * axis
    size = float(np.linalg.norm(upright))
    upright = upright / size if size > 0.1 else perpendicular(axis)
    return np.column_stack([axis, np.cross(upright, axis), upright])


def _box(
    part: RigidTransform, center: Floats, frame: Floats, size: tuple[float, float, float], color: str = BODY
) -> Primitive:
    """A box given in the base frame, written in the frame of a part at pose `part`."""
    relative = part.inv() * RigidTransform.from_components(center, Rotation.from_matrix(frame))
    return Primitive("box", size, _triple(relative.translation), _quadruple(relative.rotation.as_quat()), color)


def _triple(values: Floats | tuple[float, float, float]) -> tuple[float, float, float]:
    return (float(values[0]), float(values[1]), float(values[2]))


def _quadruple(values: Floats) -> tuple[float, float, float, float]:
    return (float(values[0]), float(values[1]), float(values[2]), float(values[3]))
