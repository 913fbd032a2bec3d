"""Which poses no tracker read."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from micah_plan.recording.exact_poses import are_exact

TURNED = Rotation.from_rotvec([0.3, -0.5, 0.9])


def poses(kind: str, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """(n, 3) [m] and (n, 4), of a door or a drawer in a turned frame, at speeds that change from row to row."""
    angle = np.cumsum(0.02 * np.exp(0.3 * np.random.default_rng(seed).standard_normal(50)))
    if kind == "drawer":
        return TURNED.apply(np.outer(angle, [0.0, 0.3, 0.0])) + 2.0, np.tile(TURNED.as_quat(), (len(angle), 1))
    position = 0.3 * np.stack([np.cos(angle), np.sin(angle), 0.1 + 0.0 * angle], axis=1)
    return TURNED.apply(position) + 2.0, (TURNED * Rotation.from_rotvec(np.outer(angle, [0, 0, 1.0]))).as_quat()


@pytest.mark.parametrize("kind", ["door", "drawer"])
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(("noise", "is_exact"), [(0.0, True), (1e-9, True), (3e-5, False), (1e-3, False)])
def test_poses_of_a_joint_are_exact_unless_something_errs(kind, seed, noise, is_exact) -> None:
    rng, (position, quaternion) = np.random.default_rng(seed), poses(kind, seed)
    read = position + noise * rng.standard_normal(position.shape)
    assert are_exact(read, None) == is_exact
    assert are_exact(read, quaternion) == is_exact
    turned = (
        Rotation.from_rotvec(noise * rng.standard_normal(position.shape)) * Rotation.from_quat(quaternion)
    ).as_quat()
    assert are_exact(position, turned) == is_exact


@pytest.mark.parametrize("kind", ["door", "drawer"])
@pytest.mark.parametrize("digits", [3, 4, 5])
def test_digits_that_a_file_leaves_out_are_no_errors(kind, digits) -> None:
    """A tracker that errs by a digit is one all the same."""
    (position, quaternion), rng = poses(kind, 0), np.random.default_rng(0)
    written = np.round(quaternion, digits)
    written /= np.linalg.norm(written, axis=1)[:, None]
    assert are_exact(np.round(position, digits), written)
    read = position + 10.0**-digits * rng.standard_normal(position.shape)
    assert not are_exact(np.round(read, digits), written)


def test_what_turns_about_its_origin_is_exact_by_its_turns() -> None:
    """Places that never change are written with no digit."""
    rng, (position, quaternion) = np.random.default_rng(0), poses("door", 0)
    tilts = Rotation.from_rotvec(1e-3 * rng.standard_normal(position.shape))
    assert are_exact(0.0 * position, quaternion)
    assert not are_exact(0.0 * position, (tilts * Rotation.from_quat(quaternion)).as_quat())


def test_three_poses_are_uninformative() -> None:
    position, quaternion = poses("door", 0)
    for count in (0, 1, 3):
        assert not are_exact(position[:count], quaternion[:count])


def test_signs_of_quaternions_do_not_matter_and_rotation_about_two_axes_is_no_joint() -> None:
    position, quaternion = poses("door", 0)
    signs = np.where(np.arange(len(position)) % 3, 1.0, -1.0)[:, None]
    assert are_exact(position, signs * quaternion)
    tilted = Rotation.from_quat(quaternion) * Rotation.from_rotvec(np.outer(position[:, 0] ** 2, [1.0, 0.0, 0.0]))
    assert not are_exact(position, tilted.as_quat())
