"""Arms that others describe, with meshes: Panda, Kinova and UR5 of example-robot-data (extra `robots`)."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

import numpy as np
import pytest

from micah_plan.robot.arm import symbolic_forward
from micah_plan.robot.inverse_kinematics import next_pose
from micah_plan.robot.load_arm import describe_robot, load_arm

ARMS = {
    "panda_description/urdf/panda.urdf": ("panda_hand", 7),
    "kinova_description/robots/kinova.urdf": ("j2s6s200_end_effector", 6),
    "ur_description/urdf/ur5_robot.urdf": ("ee_link", 6),
}


@pytest.fixture(scope="module")
def robots() -> Path:
    try:
        found = distribution("example-robot-data").locate_file("cmeel.prefix/share/example-robot-data/robots")
    except PackageNotFoundError:
        pytest.skip("the extra 'robots' is not installed")
    return Path(str(found))


@pytest.mark.parametrize("name", ARMS)
def test_an_arm_of_the_extra_moves_as_pinocchio_says_and_follows_its_tool(robots: Path, name: str) -> None:
    tool, joints = ARMS[name]
    arm = load_arm(describe_robot(robots / name, tool))
    assert arm.n == joints
    assert arm.geometry.ngeoms >= joints
    forward, rng = symbolic_forward(arm), np.random.default_rng(0)
    lower, upper = np.maximum(arm.lower, -np.pi), np.minimum(arm.upper, np.pi)
    for _ in range(5):
        q = rng.uniform(lower + 0.1, upper - 0.1)
        np.testing.assert_allclose(np.array(forward(q)), arm.matrix(q), atol=1e-12, rtol=0)
        near = np.clip(q + 0.02 * rng.standard_normal(arm.n), lower, upper)
        reached = next_pose(arm, arm.matrix(near), q, np.zeros(arm.n), (arm.lower, arm.upper))
        np.testing.assert_allclose(arm.matrix(reached.q), arm.matrix(near), atol=1e-4)
