"""Forward kinematics of a chain of joints, as a CasADi function."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import casadi as ca
import numpy as np

from micah_plan.arrays import Floats


class ChainJoint(NamedTuple):
    """A joint of the chain from the root to the tool.

    Attributes:
        placement: (4, 4) pose of the joint's frame in that of the joint before [m].
        twist: (6,) [translation, rotation] of its motion in its own frame per unit of its coordinate; the rotation is a
            unit vector or zero.
    """

    placement: Floats
    twist: Floats


def chain_forward(joints: Sequence[ChainJoint], tool: Floats) -> ca.Function:
    """q (n, 1) [rad or m] -> T (4, 4), the pose of the tool in the frame that the first joint is placed in [m].

    T = P1 exp(ξ1 q1) ... Pn exp(ξn qn) tool (Murray, Li and Sastry, "A Mathematical Introduction to Robotic
    Manipulation", section 3.2), smooth at every q.

    Args:
        joints: from the root on; n of them.
        tool: (4, 4) pose of the tool in the last joint's frame.
    """
    q = ca.SX.sym("q", len(joints))
    pose = ca.SX.eye(4)
    for i, joint in enumerate(joints):
        pose = ca.mtimes([pose, ca.DM(joint.placement), _joint_motion(joint.twist, q[i])])
    pose = ca.densify(ca.mtimes(pose, ca.DM(tool)))
    return ca.Function("chain_forward", [q], [pose], ["q"], ["pose"])


def _joint_motion(twist: Floats, c: ca.SX) -> ca.SX:
    """(4, 4) exp(ξ c) by Rodrigues' formula; a joint without rotation slides."""
    v, w = twist[:3], twist[3:]
    k = np.array([[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]])
    turn = ca.SX.eye(3) + ca.sin(c) * ca.DM(k) + (1 - ca.cos(c)) * ca.DM(k @ k)
    along = np.outer(w, w) @ v if w.any() else v
    moved = ca.mtimes(ca.SX.eye(3) - turn, ca.DM(np.cross(w, v))) + c * ca.DM(along)
    return ca.vertcat(ca.horzcat(turn, moved), ca.DM([[0.0, 0.0, 0.0, 1.0]]))
