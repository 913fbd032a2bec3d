"""Joints along a path: a natural spline of poses, the same in every frame, with exact derivatives and inverse."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from micah_plan.automaton.joint import Joint
from micah_plan.automaton.kinematics import forward, inverse, jacobian, placements, reversed_direction, shifted
from micah_plan.automaton.path import path
from micah_plan.errors import InputError

C = np.linspace(-0.3, 0.7, 23)  # beyond both ends of the knots too


def knots() -> np.ndarray:
    t = np.linspace(0.0, 0.8, 9)
    position = np.column_stack([t, np.sin(3 * t), t**2])
    quaternion = Rotation.from_rotvec(np.column_stack([t, 0.3 * np.sin(2 * t), -t])).as_quat()
    quaternion[3] *= -1  # one rotation has two quaternions
    return np.column_stack([t - 0.2, position, quaternion])


@pytest.fixture(scope="module")
def joint() -> Joint:
    return path(knots())


def test_a_path_is_a_natural_spline_through_its_knots_and_straight_beyond(joint: Joint) -> None:
    rows = knots()
    inside = np.linspace(-0.2, 0.6, 31)
    spline = CubicSpline(rows[:, 0], rows[:, 1:4], bc_type="natural")
    np.testing.assert_allclose(forward(joint, inside).translation, spline(inside), atol=1e-12)
    there = forward(joint, rows[:, 0])
    np.testing.assert_allclose((there.rotation.inv() * Rotation.from_quat(rows[:, 4:])).magnitude(), 0.0, atol=1e-7)
    beyond = forward(joint, [0.6, 0.7, 0.8]).translation
    np.testing.assert_allclose(beyond[2] - beyond[1], beyond[1] - beyond[0], atol=1e-12)
    np.testing.assert_allclose(np.concatenate([joint.position, joint.quaternion]), _pose(joint, 0.0), atol=1e-12)


def test_the_jacobian_of_a_path_is_the_derivative_of_its_poses(joint: Joint) -> None:
    step = 1e-6
    before, after = forward(joint, C - step), forward(joint, C + step)
    expected = np.hstack([(after.rotation * before.rotation.inv()).as_rotvec(), after.translation - before.translation])
    np.testing.assert_allclose(jacobian(joint, C), expected / (2 * step), atol=1e-8)


@pytest.mark.parametrize("turned", [True, False])
def test_the_inverse_of_a_path_gives_the_configuration_back(joint: Joint, turned: bool) -> None:
    poses = forward(joint, C)
    np.testing.assert_allclose(inverse(joint, poses.translation, poses.rotation if turned else None), C, atol=1e-10)


@pytest.mark.slow
def test_the_inverse_of_a_path_is_the_closest_of_all_poses(joint: Joint) -> None:
    rng = np.random.default_rng(0)
    poses = forward(joint, rng.uniform(-0.2, 0.6, 20))
    position = poses.translation + 0.03 * rng.standard_normal((20, 3))
    rotation = Rotation.from_rotvec(0.1 * rng.standard_normal((20, 3))) * poses.rotation
    fine = np.linspace(-0.3, 0.7, 40_001)
    there = forward(joint, fine)
    for i, c in enumerate(inverse(joint, position, rotation, 0.2)):
        error = ((there.translation - position[i]) ** 2).sum(axis=1)
        error += 0.2**2 * 2 * (1 - np.cos((there.rotation.inv() * rotation[i]).magnitude()))
        assert c == pytest.approx(fine[np.argmin(error)], abs=2e-3)


def test_a_path_counted_otherwise_is_the_same_motion(joint: Joint) -> None:
    same = forward(joint, C).as_matrix()
    np.testing.assert_allclose(forward(shifted(joint, 0.1), C - 0.1).as_matrix(), same, atol=1e-12)
    np.testing.assert_allclose(forward(reversed_direction(joint), -C).as_matrix(), same, atol=1e-12)
    np.testing.assert_allclose(placements(joint, C), same, atol=1e-12)


def test_a_turned_frame_turns_the_path(joint: Joint) -> None:
    turn, shift = Rotation.from_rotvec([0.4, -1.2, 0.3]), np.array([0.5, -2.0, 1.0])
    rows = knots()
    rows[:, 1:4] = turn.apply(rows[:, 1:4]) + shift
    rows[:, 4:] = (turn * Rotation.from_quat(rows[:, 4:])).as_quat()
    there, here = forward(path(rows), C), forward(joint, C)
    np.testing.assert_allclose(there.translation, turn.apply(here.translation) + shift, atol=1e-12)
    np.testing.assert_allclose((there.rotation.inv() * turn * here.rotation).magnitude(), 0.0, atol=1e-7)


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        (lambda rows: rows[:3], "at least 4 rows"),
        (lambda rows: rows[:, :7], "position .3. and quaternion .4."),
        (lambda rows: rows[::-1], "increasing c"),
        (lambda rows: np.where(np.arange(8) > 3, 0.0, rows), "not zero"),
        (lambda rows: rows * np.nan, "at least 4 rows"),
    ],
)
def test_bad_knots_are_refused(change, problem: str) -> None:
    with pytest.raises(InputError, match=problem):
        path(change(knots()))


def _pose(joint: Joint, c: float) -> np.ndarray:
    pose = forward(joint, c)[0]
    quaternion = pose.rotation.as_quat()
    return np.concatenate([pose.translation, quaternion * np.sign(quaternion @ joint.quaternion)])
