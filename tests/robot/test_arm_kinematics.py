"""An arm's kinematics: symbolic as in Pinocchio, Jacobians as differences, poses reached within the limits."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from robot_examples import SLIDER, TWO_LINKS, arm7, described

from micah_plan.errors import InputError
from micah_plan.robot.arm import Arm, symbolic_forward
from micah_plan.robot.inverse_kinematics import null_step, pose_error, reach_pose
from micah_plan.robot.load_arm import load_arm

ARMS = {
    "arm7": lambda: arm7((0.1, -0.2, 0.3)),
    "slider": lambda: load_arm(described(SLIDER, "finger", quaternion=(0.0, 0.6, 0.0, 0.8))),
    "mjcf": lambda: load_arm(described(TWO_LINKS, "tool")),
}


@pytest.fixture(params=list(ARMS))
def arm(request: pytest.FixtureRequest) -> Arm:
    return ARMS[request.param]()


def test_symbolic_kinematics_are_those_of_pinocchio(arm: Arm) -> None:
    forward = symbolic_forward(arm)
    for q in arm.sample(np.random.default_rng(0), 100):
        np.testing.assert_allclose(np.array(forward(q)), arm.matrix(q), atol=1e-12, rtol=0)


def test_jacobians_are_the_differences_of_poses_and_the_symbolic_derivative(arm: Arm) -> None:
    forward = symbolic_forward(arm)
    q = ca.SX.sym("q", arm.n)
    translation = ca.Function("jacobian", [q], [ca.jacobian(forward(q)[:3, 3], q)])
    step = 1e-6
    for row in arm.sample(np.random.default_rng(1), 20):
        jacobian = arm.jacobian(row)
        columns = [
            pose_error(arm.matrix(row + step * e), arm.matrix(row - step * e)) / (2 * step) for e in np.eye(arm.n)
        ]
        np.testing.assert_allclose(jacobian, np.stack(columns, axis=1), atol=1e-8)
        np.testing.assert_allclose(jacobian[3:], np.array(translation(row)), atol=1e-12)


def test_manipulability_is_that_of_yoshikawa_and_vanishes_at_a_singularity() -> None:
    arm = arm7()
    q = arm.sample(np.random.default_rng(2), 30)
    expected = [np.sqrt(np.linalg.det(arm.jacobian(row) @ arm.jacobian(row).T)) for row in q]
    np.testing.assert_allclose(arm.manipulability(q), expected, rtol=1e-9)
    # All axes that turn about the vertical are in line when the arm points straight up.
    assert arm.manipulability(np.zeros(7))[0] < 1e-10


def test_configurations_of_another_shape_are_refused() -> None:
    arm = arm7()
    for wrong in (np.zeros(6), np.zeros((2, 8)), np.full(7, np.nan)):
        with pytest.raises(InputError, match=r"must be finite, of shape \(k, 7\)"):
            arm.poses(wrong)


def test_poses_that_can_be_reached_are_reached_from_most_starts_within_the_limits() -> None:
    arm = arm7()
    generator = np.random.default_rng(3)
    limits = arm.lower, arm.upper
    reached = 0
    for goal, start in zip(arm.sample(generator, 60), arm.sample(generator, 60), strict=True):
        target = arm.matrix(goal)
        found = reach_pose(arm, target, start, limits)
        assert np.all(found.q >= arm.lower)
        assert np.all(found.q <= arm.upper)
        np.testing.assert_allclose(found.error, pose_error(target, arm.matrix(found.q)), atol=1e-12)
        reached += found.done
    assert reached >= 24


def test_near_a_solution_the_error_shrinks_quadratically() -> None:
    arm = arm7()
    target = arm.matrix(arm.rest)
    limits = arm.lower, arm.upper
    errors = [
        np.linalg.norm(reach_pose(arm, target, arm.rest + 0.05, limits, iterations=count).error) for count in range(4)
    ]
    assert errors[2] < 1e-2 * errors[1]
    assert errors[3] < 1e-7


def test_a_null_step_leaves_the_tool_where_it_is_and_joints_at_their_limits() -> None:
    arm = arm7()
    generator = np.random.default_rng(4)
    for q in arm.sample(generator, 20):
        wish = generator.normal(size=7)
        step = null_step(arm, q, wish, (arm.lower, arm.upper))
        np.testing.assert_allclose(arm.jacobian(q) @ step, 0.0, atol=1e-9)
        assert step @ wish >= 0
    at_limit = arm.rest.copy()
    at_limit[0] = arm.upper[0]
    assert null_step(arm, at_limit, np.ones(7), (arm.lower, arm.upper))[0] == 0.0
