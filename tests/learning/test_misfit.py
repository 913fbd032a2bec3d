"""A joint's misfit in the covariance of its fit: against dense matrices, and against deviations that were planted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from planted import JOINTS
from scipy.spatial.transform import Rotation

from micah_plan.automaton.joint import Joint, radius, radius_std
from micah_plan.automaton.kinematics import forward, shifted
from micah_plan.learning.joints.conservative_covariance import conservative_covariance
from micah_plan.learning.joints.final_fit import fit_joint
from micah_plan.learning.joints.misfit import misfit_modes, misfits_tried, without_misfit
from micah_plan.learning.settings import LearnSettings

ARC = 1.2  # rad
ROWS = 80
NO_MISFIT = LearnSettings(position_misfit=1e-12, rotation_misfit=1e-12)


def seen(joint: Joint, misfit: float, noise: float, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Poses along a joint that deviate smoothly with the configuration, and noise (times 6 rad/m for rotations)."""
    c = np.linspace(0, ARC, ROWS)
    # Not the learner's modes: a few waves with phases of their own, of whatever length.
    phase = np.outer(c / ARC, rng.uniform(0.3, 1.6, 4))
    waves = rng.standard_normal((6, 4)) @ np.cos(2 * np.pi * (phase + rng.random(4))).T / np.sqrt(2)
    deviation = misfit * waves.T + noise * rng.standard_normal((ROWS, 6))
    poses = forward(joint, c)
    turn = Rotation.from_rotvec(6 * deviation[:, 3:])
    return poses.translation + deviation[:, :3], (turn * poses.rotation).as_quat()


def tilts_and_radii(misfit: float, noise: float, settings: LearnSettings, trials: int) -> tuple[np.ndarray, np.ndarray]:
    """(t, 3) errors of a door's axis and radius, and their stds."""
    joint, found = JOINTS["revolute"], []
    for trial in range(trials):
        rng = np.random.default_rng([5, trial])
        position, quaternion = seen(joint, misfit, noise, rng)
        fit = fit_joint(joint, position, quaternion, np.arange(ROWS) / 18, np.ones(ROWS), settings).joint
        assert fit.covariance is not None
        tilt = np.cross(fit.axis, joint.axis)
        std = np.sqrt(np.diag(fit.covariance.matrix))
        found.append([[*tilt, radius(fit) - radius(joint)], [std[0], std[1]]])
    errors = np.array([one[0] for one in found])
    return errors, np.array([one[1] for one in found])


def test_misfits_that_are_integrated_out_equal_dense_matrices() -> None:
    rng = np.random.default_rng(0)
    n, k, r = 25, 2, 3
    modes, columns = misfit_modes(rng.uniform(0, 2, n)), rng.standard_normal((k, n, r))
    beside = np.concatenate([*columns, modes], axis=1)
    tried = misfits_tried(modes)
    parts = [slice(i * r, (i + 1) * r) for i in range(k)]
    grams, log_dets = without_misfit((beside.T @ beside)[None], parts, tried)
    for size, gram, log_det in zip(tried, grams[:, 0], log_dets[:, 0], strict=True):
        dense = np.eye(n) + size * modes @ modes.T
        expected = sum(one.T @ np.linalg.solve(dense, one) for one in columns)
        np.testing.assert_allclose(gram, expected, rtol=1e-6, atol=1e-6)
        assert log_det == pytest.approx(k * np.linalg.slogdet(dense)[1], rel=1e-9, abs=1e-9)


def test_a_part_that_does_not_move_has_no_misfit() -> None:
    modes = misfit_modes(np.zeros(7))
    assert modes.shape == (7, 0)
    assert misfits_tried(modes).tolist() == [0.0]


def test_stds_that_cover_hold_95_percent_of_a_mixture() -> None:
    rng = np.random.default_rng(1)
    chance, off, std = np.array([0.6, 0.3, 0.1]), np.array([[0.0], [0.5], [-2.0]]), np.array([[1.0], [0.2], [5.0]])
    held = conservative_covariance(np.array([[7.0]]), chance, off, std)
    component = rng.choice(3, 200_000, p=chance)
    sampled = off[component, 0] + std[component, 0] * rng.standard_normal(200_000)
    assert np.mean(np.abs(sampled) < 1.959964 * np.sqrt(held[0, 0])) == pytest.approx(0.95, abs=0.002)


def test_one_normal_keeps_its_covariance() -> None:
    matrix = np.array([[4.0, 1.0], [1.0, 9.0]])
    np.testing.assert_allclose(
        conservative_covariance(matrix, np.ones(1), np.zeros((1, 2)), np.array([[2.0, 3.0]])), matrix, rtol=1e-6
    )


@pytest.mark.slow
def test_the_axis_of_a_real_hinge_is_within_its_intervals() -> None:
    errors, stds = tilts_and_radii(0.003, 0.0003, LearnSettings(), 40)
    away = np.linalg.norm(errors[:, :3], axis=1)
    assert np.mean(away < 2.45 * stds.mean(axis=1)) > 0.85
    # What rows average out says next to nothing of it: this is what the misfit is for.
    errors, stds = tilts_and_radii(0.003, 0.0003, NO_MISFIT, 40)
    away = np.linalg.norm(errors[:, :3], axis=1)
    assert np.mean(away < 2.45 * stds.mean(axis=1)) < 0.7


@pytest.mark.slow
@pytest.mark.parametrize("noise", [0.0003, 0.002])
def test_an_ideal_hinge_hardly_pays_for_it(noise: float) -> None:
    _, with_misfit = tilts_and_radii(0.0, noise, LearnSettings(), 20)
    _, without = tilts_and_radii(0.0, noise, NO_MISFIT, 20)
    assert np.median(with_misfit / without) < 1.3


def test_the_unit_of_the_configuration_matters_to_no_mode() -> None:
    c = np.random.default_rng(3).uniform(0, 2, 30)
    np.testing.assert_allclose(misfit_modes(c), misfit_modes(100 * c + 7), atol=1e-12)


def test_the_origin_gives_the_same_radius_from_any_zero() -> None:
    """The covariance of a shifted joint's radius is that of the joint: a circle has one radius."""
    joint, rng = JOINTS["revolute"], np.random.default_rng(2)
    position, quaternion = seen(joint, 0.0, 0.001, rng)
    fit = fit_joint(joint, position, quaternion, np.arange(ROWS) / 18, np.ones(ROWS)).joint
    for c in (-0.7, 0.5, 1.4):
        assert radius_std(shifted(fit, c)) == pytest.approx(radius_std(fit), rel=1e-6)
    assert radius_std(shifted(shifted(fit, 0.8), -0.8)) == pytest.approx(radius_std(fit), rel=1e-6)
    assert replace(shifted(fit, 0.8), covariance=None) == shifted(replace(fit, covariance=None), 0.8)
