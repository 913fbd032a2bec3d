"""Laws of joint kinematics: inverse, group law, Jacobians, changes of base, origin and direction."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rebased_joints import rebased
from scipy.spatial.transform import RigidTransform, Rotation

from micah_plan.automaton.joint import (
    Joint,
    ParameterCovariance,
    axis_basis,
    prismatic,
    radius,
    revolute,
    rigid,
    screw,
)
from micah_plan.automaton.kinematics import (
    forward,
    inverse,
    inverse_jacobian,
    jacobian,
    origin,
    placements,
    reversed_direction,
    shifted,
    twist,
)
from micah_plan.errors import InputError
from micah_plan.learning.joints.parametrization import chart_of, stepped

KINDS = ("prismatic", "revolute", "screw")
quick = settings(max_examples=60)


def unit(rng: np.random.Generator, size: int = 3) -> np.ndarray:
    vector = rng.standard_normal(size)
    return vector / np.linalg.norm(vector)


def random_joint(kind: str, seed: int) -> Joint:
    rng = np.random.default_rng(seed)
    position, point, quaternion = rng.uniform(-1, 1, 3), rng.uniform(-1, 1, 3), unit(rng, 4)
    axis = rng.uniform(0.5, 3.0) * unit(rng)
    pitch = rng.choice([-1.0, 1.0]) * rng.uniform(0.005, 0.3)
    if kind == "rigid":
        return rigid(position, quaternion, fixed_at=0.7)
    if kind == "prismatic":
        return prismatic(axis, position, quaternion)
    if kind == "revolute":
        return revolute(axis, point, position, quaternion)
    return screw(axis, point, pitch, position, quaternion)


def random_transform(seed: int) -> RigidTransform:
    rng = np.random.default_rng(seed)
    return RigidTransform.from_components(rng.uniform(-2, 2, 3), Rotation.from_quat(unit(rng, 4)))


def configurations(joint: Joint, seed: int, count: int = 7) -> np.ndarray:
    reach = {"rigid": 1.0, "prismatic": 2.0, "revolute": 3.0, "screw": 25.0}[joint.kind]
    return np.random.default_rng(seed + 1).uniform(-reach, reach, count)


def poses_of(joint: Joint, c: np.ndarray) -> tuple[np.ndarray, Rotation]:
    poses = forward(joint, c)
    return poses.translation, poses.rotation


joints = st.builds(random_joint, st.sampled_from(KINDS), st.integers(0, 10_000))
all_joints = st.builds(random_joint, st.sampled_from((*KINDS, "rigid")), st.integers(0, 10_000))
seeds = st.integers(0, 10_000)


class TestConstruction:
    @pytest.mark.parametrize("kind", ["rigid", "prismatic", "revolute", "screw"])
    def test_placements_are_the_poses_of_forward(self, kind: str) -> None:
        for seed in range(20):
            joint, c = random_joint(kind, seed), np.linspace(-4.0, 4.0, 9)
            np.testing.assert_allclose(placements(joint, c), forward(joint, c).as_matrix(), atol=1e-13)

    def test_axis_is_normalised_and_the_center_is_closest_to_the_position(self) -> None:
        joint = revolute([0, 0, 4], [1, 0, -7], [1.0, 0.5, 2.0])
        assert joint.axis == (0.0, 0.0, 1.0)
        assert joint.center == pytest.approx((1.0, 0.0, 2.0))
        assert radius(joint) == pytest.approx(0.5)

    def test_radius_is_zero_without_rotation(self) -> None:
        assert radius(prismatic([1, 0, 0], [1, 2, 3])) == 0.0
        assert radius(rigid([1, 2, 3])) == 0.0

    @pytest.mark.parametrize("axis", [[0, 0, 0], [1e-13, 0, 0], [np.nan, 0, 1], [1, 0]])
    def test_bad_axis_is_refused(self, axis: list[float]) -> None:
        with pytest.raises(InputError, match="axis"):
            prismatic(axis, [0, 0, 0])
        with pytest.raises(InputError, match="axis"):
            revolute(axis, [0, 0, 0], [1, 0, 0])

    def test_bad_position_and_quaternion_are_refused(self) -> None:
        with pytest.raises(InputError, match="position"):
            rigid([0, np.inf, 0])
        with pytest.raises(InputError, match="quaternion"):
            rigid([0, 0, 0], [0, 0, 0, 0])
        with pytest.raises(InputError, match=r"shape \(k, 3\)"):
            inverse(prismatic([1, 0, 0], [0, 0, 0]), np.zeros((4, 2)))
        with pytest.raises(InputError, match=r"\(k, 6\)"):
            inverse_jacobian(prismatic([1, 0, 0], [0, 0, 0]), [0.0], np.zeros((1, 4)))

    @given(seeds)
    @quick
    def test_axis_basis_is_right_handed_and_flips_its_first_vector(self, seed: int) -> None:
        axis = unit(np.random.default_rng(seed))
        b1, b2 = axis_basis(axis)
        np.testing.assert_allclose(np.cross(b1, b2), axis, atol=1e-12)
        np.testing.assert_allclose(axis_basis(-axis), [-b1, b2], atol=1e-12)


class TestForward:
    def test_twists_of_known_joints(self) -> None:
        np.testing.assert_allclose(twist(rigid([1, 2, 3])), np.zeros(6))
        np.testing.assert_allclose(twist(prismatic([0, 2, 0], [1, 2, 3])), [0, 0, 0, 0, 1, 0])
        np.testing.assert_allclose(twist(revolute([0, 0, 1], [1, 0, 0], [2, 0, 0])), [0, 0, 1, 0, -1, 0])
        np.testing.assert_allclose(twist(screw([0, 0, 1], [1, 0, 0], 0.1, [2, 0, 0])), [0, 0, 1, 0, -1, 0.1])

    def test_a_door_turned_by_a_quarter(self) -> None:
        position, rotation = poses_of(revolute([0, 0, 1], [1, 0, 0], [1.5, 0, 0.2]), np.array([np.pi / 2]))
        np.testing.assert_allclose(position, [[1.0, 0.5, 0.2]], atol=1e-12)
        np.testing.assert_allclose(rotation.as_rotvec(), [[0, 0, np.pi / 2]], atol=1e-12)

    def test_two_and_a_quarter_turns_of_a_screw(self) -> None:
        position, rotation = poses_of(screw([0, 0, 1], [0, 0, 0], 0.01, [0.3, 0, 0]), np.array([4.5 * np.pi]))
        np.testing.assert_allclose(position, [[0, 0.3, 0.045 * np.pi]], atol=1e-12)
        np.testing.assert_allclose(rotation.as_rotvec(), [[0, 0, np.pi / 2]], atol=1e-12)

    @given(all_joints, seeds)
    @quick
    def test_group_law(self, joint: Joint, seed: int) -> None:
        a, b = configurations(joint, seed), configurations(joint, seed + 7)
        xi = twist(joint)
        apart = RigidTransform.from_exp_coords(a[:, None] * xi) * RigidTransform.from_exp_coords(b[:, None] * xi)
        np.testing.assert_allclose((apart * origin(joint)).as_matrix(), forward(joint, a + b).as_matrix(), atol=1e-10)

    @given(all_joints)
    @quick
    def test_configuration_zero_is_the_origin(self, joint: Joint) -> None:
        np.testing.assert_allclose(forward(joint, 0.0)[0].as_matrix(), origin(joint).as_matrix(), atol=1e-14)


class TestInverse:
    @given(joints, seeds)
    @quick
    def test_inverts_forward(self, joint: Joint, seed: int) -> None:
        c = configurations(joint, seed)
        position, rotation = poses_of(joint, c)
        np.testing.assert_allclose(inverse(joint, position, rotation), c, atol=1e-9)

    @given(joints, seeds)
    @quick
    def test_positions_alone_suffice(self, joint: Joint, seed: int) -> None:
        c = configurations(joint, seed)
        np.testing.assert_allclose(inverse(joint, forward(joint, c).translation), c, atol=1e-6)

    @given(joints, seeds, st.floats(0.02, 2.0))
    @quick
    def test_is_the_least_squares_configuration_of_a_noisy_pose(self, joint: Joint, seed: int, length: float) -> None:
        rng = np.random.default_rng(seed)
        c = configurations(joint, seed)
        position, rotation = poses_of(joint, c)
        position = position + rng.normal(0, 0.02, position.shape)
        rotation = Rotation.from_rotvec(rng.normal(0, 0.1, (len(c), 3))) * rotation
        found = inverse(joint, position, rotation, length)

        def error(at: np.ndarray) -> np.ndarray:
            p, r = poses_of(joint, at)
            cosine = 2 * (rotation * r.inv()).as_quat()[:, 3] ** 2 - 1
            return ((p - position) ** 2).sum(axis=1) + length**2 * 2 * (1 - cosine)

        for nudge in (-0.3, -1e-3, 1e-3, 0.3):
            assert (error(found) <= error(found + nudge) + 1e-12).all()

    def test_noise_of_the_tracker_moves_the_configuration_no_further_than_it_should(self) -> None:
        joint = revolute([0, 0, 1], [0, 0, 0], [0.4, 0, 0])
        rng = np.random.default_rng(3)
        c = rng.uniform(-2, 2, 4000)
        position, rotation = poses_of(joint, c)
        noisy = Rotation.from_rotvec(rng.normal(0, 0.02, (len(c), 3))) * rotation
        error = inverse(joint, position + rng.normal(0, 0.004, position.shape), noisy) - c
        # Weighted mean of two measurements of the angle: positions with std 0.004/0.4, orientations with 0.02.
        weights = np.array([0.4**2, 0.2**2])
        expected = np.linalg.norm(weights * [0.004 / 0.4, 0.02]) / weights.sum()
        assert error.std() == pytest.approx(expected, rel=0.05)
        assert abs(error.mean()) < 4 * expected / np.sqrt(len(c))

    def test_range_of_a_revolute_joint_includes_plus_pi_only(self) -> None:
        joint = revolute([0, 0, 1], [0, 0, 0], [1, 0, 0])
        np.testing.assert_array_equal(inverse(joint, [[-1.0, 0.0, 0.0], [-1.0, -0.0, 0.0]]), [np.pi, np.pi])

    def test_near_chooses_the_turn(self) -> None:
        c = np.array([3.0, 7.0, -9.0, 40.0])
        for joint in (revolute([0, 1, 0], [0, 0, 0], [1, 0, 0]), screw([0, 1, 0], [0, 0, 0], 1e-4, [1, 0, 0])):
            position, rotation = poses_of(joint, c)
            position = position + np.array([0.0, 0.004, 0.0])
            np.testing.assert_allclose(inverse(joint, position, rotation, near=c + 0.5), c, atol=1e-5)

    def test_screw_without_pitch_is_revolute(self) -> None:
        c = np.linspace(-3, 3, 9)
        flat, door = screw([0, 0, 1], [0, 0, 0], 0.0, [1, 0, 0]), revolute([0, 0, 1], [0, 0, 0], [1, 0, 0])
        position, rotation = poses_of(door, c)
        np.testing.assert_array_equal(inverse(flat, position, rotation), inverse(door, position, rotation))

    def test_without_information_the_configuration_is_defined(self) -> None:
        on_axis = revolute([0, 0, 1], [0, 0, 0], [0, 0, 0.5])
        np.testing.assert_array_equal(inverse(on_axis, [[0, 0, 0.5], [0.3, 0.1, 0.5]]), [0.0, 0.0])
        np.testing.assert_allclose(inverse(on_axis, [[0, 0, 0.5]], Rotation.from_rotvec([0, 0, 1.1])), [1.1])
        bolt = screw([0, 0, 1], [0, 0, 0], 0.01, [0, 0, 0])
        np.testing.assert_allclose(inverse(bolt, [[0, 0, 0.123]]), [12.3])
        np.testing.assert_array_equal(inverse(rigid([1, 2, 3], fixed_at=0.4), np.zeros((3, 3))), [0.4, 0.4, 0.4])

    def test_no_rows_and_single_rows(self) -> None:
        joint = revolute([0, 0, 1], [0, 0, 0], [1, 0, 0])
        assert inverse(joint, np.zeros((0, 3))).shape == (0,)
        assert inverse(joint, [1.0, 0.0, 0.0], Rotation.identity()).shape == (1,)


class TestJacobian:
    @given(all_joints, seeds)
    @quick
    def test_against_finite_differences(self, joint: Joint, seed: int) -> None:
        c, h = configurations(joint, seed), 1e-6
        ahead, behind = forward(joint, c + h), forward(joint, c - h)
        rotation = (ahead.rotation * behind.rotation.inv()).as_rotvec() / (2 * h)
        translation = (ahead.translation - behind.translation) / (2 * h)
        np.testing.assert_allclose(jacobian(joint, c), np.hstack([rotation, translation]), atol=1e-7)

    @given(joints, seeds)
    @quick
    def test_inverse_jacobian_inverts_it(self, joint: Joint, seed: int) -> None:
        c = configurations(joint, seed)
        step = np.random.default_rng(seed).uniform(-1, 1, len(c))
        moved = step[:, None] * jacobian(joint, c)
        np.testing.assert_allclose(inverse_jacobian(joint, c, moved), step, atol=1e-9)
        np.testing.assert_allclose(inverse_jacobian(joint, c, moved[:, 3:]), step, atol=1e-6)

    @given(joints, seeds)
    @quick
    def test_inverse_jacobian_is_least_squares(self, joint: Joint, seed: int) -> None:
        c = configurations(joint, seed)
        wanted = np.random.default_rng(seed).uniform(-0.1, 0.1, (len(c), 6))
        found = inverse_jacobian(joint, c, wanted, rotation_length=0.5)
        left_over = wanted - found[:, None] * jacobian(joint, c)
        weights = np.repeat([0.25, 1.0], 3)
        np.testing.assert_allclose((left_over * jacobian(joint, c)) @ weights, 0.0, atol=1e-12)

    def test_without_an_estimate_it_is_zero(self) -> None:
        np.testing.assert_array_equal(inverse_jacobian(rigid([0, 0, 0]), [0.0], [[1, 1, 1, 1, 1, 1.0]]), [0.0])
        on_axis = revolute([0, 0, 1], [0, 0, 0], [0, 0, 0.5])
        np.testing.assert_array_equal(inverse_jacobian(on_axis, [0.2], [[1.0, 1.0, 1.0]]), [0.0])


class TestChanges:
    @given(all_joints, seeds)
    @quick
    def test_base(self, joint: Joint, seed: int) -> None:
        transform = random_transform(seed)
        moved, c = rebased(joint, transform), configurations(joint, seed)
        np.testing.assert_allclose(
            forward(moved, c).as_matrix(), (transform * forward(joint, c)).as_matrix(), atol=1e-10
        )
        rng = np.random.default_rng(seed)
        noisy = forward(joint, c).translation + rng.normal(0, 0.01, (len(c), 3))
        tilted = Rotation.from_rotvec(rng.normal(0, 0.05, (len(c), 3))) * forward(joint, c).rotation
        np.testing.assert_allclose(
            inverse(moved, transform.apply(noisy), transform.rotation * tilted),
            inverse(joint, noisy, tilted),
            atol=1e-9,
        )

    @given(joints, seeds, st.floats(-2.0, 2.0))
    @quick
    def test_shift(self, joint: Joint, seed: int, offset: float) -> None:
        c = configurations(joint, seed)
        moved = shifted(joint, offset)
        np.testing.assert_allclose(forward(moved, c - offset).as_matrix(), forward(joint, c).as_matrix(), atol=1e-10)
        np.testing.assert_allclose(
            np.dot(np.subtract(moved.position, moved.center), moved.axis) * bool(radius(moved)), 0, atol=1e-12
        )

    @given(joints, seeds)
    @quick
    def test_reversal(self, joint: Joint, seed: int) -> None:
        c = configurations(joint, seed)
        turned = reversed_direction(joint)
        np.testing.assert_allclose(forward(turned, -c).as_matrix(), forward(joint, c).as_matrix(), atol=1e-12)
        assert reversed_direction(turned) == joint

    def test_a_rigid_joint_changes_what_it_stands_for_but_not_where_it_is(self) -> None:
        joint = rigid([1, 2, 3], fixed_at=0.5)
        assert shifted(joint, 0.2) == rigid([1, 2, 3], fixed_at=0.3)
        assert reversed_direction(joint) == rigid([1, 2, 3], fixed_at=-0.5)

    @given(seeds)
    @quick
    def test_the_covariance_follows_the_tilts_and_shifts_that_it_describes(self, seed: int) -> None:
        """As vectors in the base frame, tilts and shifts of the axis turn with the base, whatever the basis."""
        rng = np.random.default_rng(seed)
        joint, transform = random_joint("revolute", seed), random_transform(seed)
        names = ("axis_1", "axis_2", "center_1", "center_2")
        root = rng.normal(0, 0.01, 4)
        matrix = tuple(tuple(float(v) for v in row) for row in np.outer(root, root))
        known = Joint(**{**joint.__dict__, "covariance": ParameterCovariance(names, matrix)})

        def as_vectors(of: Joint) -> np.ndarray:
            """Covariance of [tilt vector, shift vector] in the base frame: does not depend on the choice of basis."""
            assert of.covariance is not None
            spread = np.kron(np.eye(2), axis_basis(of.axis).T)
            return spread @ np.array(of.covariance.matrix) @ spread.T

        turn = np.kron(np.eye(2), transform.rotation.as_matrix())
        np.testing.assert_allclose(as_vectors(rebased(known, transform)), turn @ as_vectors(known) @ turn.T, atol=1e-15)
        np.testing.assert_allclose(as_vectors(reversed_direction(known)), as_vectors(known), atol=1e-15)
        np.testing.assert_allclose(as_vectors(shifted(known, 0.4)), as_vectors(known), atol=1e-15)

    @pytest.mark.parametrize("kind", ["prismatic", "revolute", "screw"])
    @pytest.mark.parametrize("has_rotation", [True, False])
    def test_a_shift_carries_errors_of_the_parameters_to_the_new_origin(self, kind: str, has_rotation: bool) -> None:
        joint, offset, rng = random_joint(kind, 4), 0.7, np.random.default_rng(8)
        chart = chart_of(joint, has_rotation)
        numbers = 1e-5 * rng.standard_normal(chart.free.shape[1])
        wrong = stepped(joint, chart, numbers)
        error = chart.free @ numbers
        known = replace(
            joint, covariance=ParameterCovariance(chart.names, tuple(map(tuple, np.outer(error, error).tolist())))
        )
        moved, basis = shifted(known, offset), axis_basis(joint.axis)
        assert wrong is not None
        assert moved.covariance is not None
        # The other joint is counted from where it comes closest.
        rotation = Rotation.from_quat(moved.quaternion)
        measured = rotation if has_rotation else None
        other = shifted(wrong, float(inverse(wrong, moved.position, measured, near=offset)[0]))
        parts = [basis @ np.cross(moved.axis, other.axis)]
        parts += [basis @ np.subtract(other.center, moved.center)] if kind != "prismatic" else []
        parts += [[other.pitch - moved.pitch]] if kind == "screw" else []
        parts += [(Rotation.from_quat(other.quaternion) * rotation.inv()).as_rotvec()] if has_rotation else []
        there = np.concatenate([*parts, np.subtract(other.position, moved.position)])
        np.testing.assert_allclose(moved.covariance.matrix, np.outer(there, there), atol=2e-3 * (there**2).max())

    def test_halves_of_a_pair_are_dropped_by_a_change_of_base(self) -> None:
        both = ParameterCovariance(("axis_1", "position_1"), ((1e-4, 1e-5), (1e-5, 1e-4)))
        joint = Joint(**{**prismatic([0, 0, 1], [1, 2, 3]).__dict__, "covariance": both})
        assert rebased(joint, random_transform(1)).covariance is None
