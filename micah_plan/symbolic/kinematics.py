"""A joint's forward kinematics f(c) as a CasADi function; NumPy twin: `micah_plan.automaton.kinematics.forward`."""

from __future__ import annotations

import casadi as ca
import numpy as np
from scipy.spatial.transform import Rotation

from micah_plan.automaton.joint import Joint


def forward(joint: Joint) -> ca.Function:
    """c (1, 1) -> T (4, 4), the pose of the part's frame in the base frame [m] at configuration c [rad or m].

    Rodrigues' formula about the unit axis, R(c) = I + sin c K + (1 - cos c) K², smooth at every c, zero included
    (Murray, Li and Sastry, "A Mathematical Introduction to Robotic Manipulation", eq. 2.14).
    """
    c = ca.SX.sym("c")
    axis, center = np.array(joint.axis), np.array(joint.center)
    position = np.array(joint.position)
    orientation = Rotation.from_quat(joint.quaternion).as_matrix()
    if joint.kind == "rigid":
        rotated, moved = ca.SX(ca.DM(orientation)), ca.SX(ca.DM(position))
    elif joint.kind == "prismatic":
        rotated, moved = ca.SX(ca.DM(orientation)), ca.DM(position) + c * ca.DM(axis)
    else:
        turn = _rotation(axis, c)
        rotated = ca.mtimes(turn, ca.DM(orientation))
        moved = ca.DM(center) + ca.mtimes(turn, ca.DM(position - center)) + joint.pitch * c * ca.DM(axis)
    pose = ca.vertcat(ca.horzcat(rotated, moved), ca.DM([[0.0, 0.0, 0.0, 1.0]]))
    return ca.Function("forward", [c], [ca.densify(pose)], ["c"], ["pose"])


def _rotation(axis: np.ndarray, angle: ca.SX) -> ca.SX:
    k = np.array([[0.0, -axis[2], axis[1]], [axis[2], 0.0, -axis[0]], [-axis[1], axis[0], 0.0]])
    return ca.SX.eye(3) + ca.sin(angle) * ca.DM(k) + (1 - ca.cos(angle)) * ca.DM(k @ k)
