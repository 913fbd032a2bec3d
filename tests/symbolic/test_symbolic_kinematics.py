"""Symbolic joint kinematics against the NumPy ones and finite differences."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from micah_plan.automaton import kinematics as numeric
from micah_plan.automaton.joint import Joint, prismatic, revolute, rigid, screw
from micah_plan.symbolic.forward_kinematics import ChainJoint, chain_forward


def joints(seed: int) -> dict[str, Joint]:
    rng = np.random.default_rng(seed)
    axis, center, position = rng.normal(size=(3, 3))
    quaternion = rng.normal(size=4)
    axis, quaternion = axis / np.linalg.norm(axis), quaternion / np.linalg.norm(quaternion)
    return {
        "rigid": rigid(position, quaternion, 0.3),
        "prismatic": prismatic(axis, position, quaternion),
        "revolute": revolute(axis, center, position, quaternion),
        "screw": screw(axis, center, 0.17, position, quaternion),
    }


def forward(joint: Joint) -> ca.Function:
    """c (1, 1) -> T (4, 4): a joint as a chain of one."""
    rotation, translation = np.split(numeric.twist(joint), 2)
    own = ChainJoint(np.eye(4), np.concatenate([translation, rotation]))
    return chain_forward([own], numeric.origin(joint).as_matrix())


@pytest.mark.parametrize("kind", ["rigid", "prismatic", "revolute", "screw"])
@pytest.mark.parametrize("seed", range(4))
def test_pose_and_derivative_equal_the_numeric_joint(kind: str, seed: int) -> None:
    joint = joints(seed)[kind]
    pose = forward(joint)
    derivative = pose.jacobian()
    for c in (0.0, 1e-9, -1e-5, 0.4, -2.5, np.pi, 7.0):
        assert np.allclose(pose(c).full(), numeric.forward(joint, c)[0].as_matrix(), atol=1e-12)
        exact = derivative(c, pose(c)).full().reshape(4, 4, order="F")
        central = (pose(c + 1e-6) - pose(c - 1e-6)).full() / 2e-6
        assert np.allclose(exact, central, atol=1e-8)
        assert np.allclose(exact[:3, 3], numeric.jacobian(joint, c)[0, 3:], atol=1e-12)
