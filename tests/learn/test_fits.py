"""Fits: closed forms and minimal sets exact on exact data, refinement at the optimum, MLESAC against outliers."""

from __future__ import annotations

import numpy as np
import pytest
from planted import AXIS, JOINTS, TRAVEL, Noise, moving_then_held, recorded
from scipy.spatial.transform import Rotation

from micah_plan.automaton.joint import Joint, radius
from micah_plan.automaton.kinematics import forward
from micah_plan.learn.closed_form import fit_closed_form, fit_minimal, minimal_rows
from micah_plan.learn.inliers import find_inliers
from micah_plan.learn.mlesac import Mixture, fit_robust
from micah_plan.learn.noise_fit import first_noise
from micah_plan.learn.refine import compare, moved, refine, with_covariance
from micah_plan.learn.settings import LearnSettings
from micah_plan.learn.track import part_track

MIXTURE = Mixture(0.006, 0.001, 2 * np.pi, 1.0, 10.0)
KINDS = ("prismatic", "revolute", "screw")


def rows_of(kind: str, n: int = 60, noise: Noise | None = None, seed: int = 0) -> tuple[np.ndarray, Rotation]:
    c = np.linspace(0, TRAVEL[kind], n)
    recording = recorded([(JOINTS[kind], c)], np.random.default_rng(seed), noise or Noise(0.0, 0.0))
    return recording.position, recording.poses().rotation


def assert_same_motion(found: Joint | None, truth: Joint, tolerance: float) -> None:
    assert found is not None
    assert abs(np.dot(found.axis, truth.axis)) > np.cos(max(tolerance, 1e-7))
    assert radius(found) == pytest.approx(radius(truth), abs=tolerance)
    assert found.pitch == pytest.approx(truth.pitch, abs=tolerance)


@pytest.mark.parametrize("kind", KINDS)
def test_minimal_sets_fix_the_joint_exactly(kind: str) -> None:
    position, rotation = rows_of(kind)
    chosen = [5, 50]
    assert_same_motion(fit_minimal(kind, position[chosen], rotation[chosen]), JOINTS[kind], 1e-7)
    assert minimal_rows(kind, True) == 2


def test_three_positions_fix_a_circle() -> None:
    position, _ = rows_of("revolute")
    assert_same_motion(fit_minimal("revolute", position[[0, 30, 59]], None), JOINTS["revolute"], 1e-6)


@pytest.mark.parametrize("kind", KINDS)
def test_all_rows_fix_the_joint_exactly(kind: str) -> None:
    position, rotation = rows_of(kind)
    start = fit_closed_form(kind, position, rotation, np.ones(60))
    assert start is not None
    refined = refine(start, position, rotation, np.ones(60), MIXTURE.stds, iterations=20)
    assert_same_motion(refined, JOINTS[kind], 1e-4)
    assert np.abs(compare(refined, position, rotation, 0.2).error).max() < 1e-4


def test_rows_without_motion_fix_no_moving_joint() -> None:
    position, rotation = np.zeros((10, 3)), Rotation.identity(10)
    assert fit_closed_form("prismatic", position, rotation, np.ones(10)) is None
    assert fit_closed_form("revolute", position, rotation, np.ones(10)) is None
    assert fit_minimal("revolute", position[:2], rotation[:2]) is None
    assert fit_closed_form("revolute", position, None, np.ones(10)) is None


@pytest.mark.parametrize("kind", KINDS)
def test_refinement_ends_where_no_small_step_is_better(kind: str) -> None:
    position, rotation = rows_of(kind, noise=Noise(0.002, 0.01))
    start = fit_closed_form(kind, position, rotation, np.ones(60))
    assert start is not None
    best = refine(start, position, rotation, np.ones(60), MIXTURE.stds, iterations=30)

    def cost(joint: Joint | None) -> float:
        assert joint is not None
        error = compare(joint, position, rotation, MIXTURE.rotation_length).error
        return float(((error / np.repeat(MIXTURE.stds, 3)) ** 2).sum())

    rng = np.random.default_rng(1)
    for _ in range(20):
        step = 2e-3 * rng.standard_normal(13)
        assert cost(moved(best, step)) > cost(best) * (1 - 1e-4)


@pytest.mark.parametrize("kind", KINDS)
def test_outliers_do_not_move_the_robust_fit(kind: str) -> None:
    position, rotation = rows_of(kind, noise=Noise(0.001, 0.006, outliers=0.2), seed=4)
    fit = fit_robust(kind, position, rotation, MIXTURE, np.random.default_rng(0), 24)
    assert fit is not None
    assert_same_motion(fit.joint, JOINTS[kind], 0.02)
    assert 0.05 < fit.outlier_ratio < 0.35
    assert ((fit.inlier > 0.5).mean()) == pytest.approx(1 - fit.outlier_ratio, abs=0.1)


def test_the_spread_of_repeated_fits_matches_their_covariance() -> None:
    errors, claimed = [], []
    for seed in range(40):
        position, rotation = rows_of("revolute", 40, Noise(0.001, 0.006), seed)
        start = fit_closed_form("revolute", position, rotation, np.ones(40))
        assert start is not None
        joint = refine(start, position, rotation, np.ones(40), MIXTURE.stds)
        joint = with_covariance(joint, position, rotation, np.ones(40), MIXTURE.stds)
        assert joint.covariance is not None
        errors.append(np.linalg.norm(np.cross(joint.axis, AXIS)) ** 2)
        matrix = np.array(joint.covariance.matrix)
        claimed.append(matrix[0, 0] + matrix[1, 1])
        assert np.linalg.eigvalsh(matrix).min() > -1e-12
    assert 0.5 < np.mean(claimed) / np.mean(errors) < 2.0


def test_noise_scales_come_from_the_rows() -> None:
    recording = recorded(
        [(JOINTS["revolute"], moving_then_held("revolute", 150, 150))],
        np.random.default_rng(5),
        Noise(0.003, 0.02, 0.05),
    )
    track = part_track(recording, 0, recording.parts[0])
    inlier = find_inliers(track)
    noise = first_noise(track.take(inlier.nonzero()[0]), LearnSettings())
    assert noise.position_white == pytest.approx(0.003, rel=0.2)
    assert noise.rotation_white == pytest.approx(0.02, rel=0.2)
    truth = np.linalg.norm(
        recording.position - forward(JOINTS["revolute"], moving_then_held("revolute", 150, 150)).translation, axis=1
    )
    assert not inlier[truth > 0.1].any()
    assert inlier[truth < 0.01].mean() > 0.95
