"""White noise and wander: recursions against dense matrices, and scales against what was planted."""

from __future__ import annotations

import numpy as np
import pytest

from micah_plan.learning.joints.mixture import Sort, fit_mixtures
from micah_plan.learning.joints.tracker_wander import OrnsteinUhlenbeck, finer, memories, noise_posterior
from micah_plan.learning.segmenting.noise_fit import correlated

NONE = np.zeros((1000, 0))  # modes of a joint that has no misfit
SCALE = (1e-12, 1.0)


def uneven(n: int, rng: np.random.Generator) -> np.ndarray:
    """Times with uneven steps and a pause."""
    steps = rng.uniform(0.3, 1.7, n)
    steps[n // 2] = 40.0
    return np.cumsum(steps)


def covariance(time: np.ndarray, memory: float) -> np.ndarray:
    return np.exp(-np.abs(time[:, None] - time) / memory)


@pytest.mark.parametrize("memory", [0.5, 3.0, 50.0])
def test_recursions_equal_dense_matrices(memory: float) -> None:
    rng = np.random.default_rng(0)
    time, columns = uneven(30, rng), rng.standard_normal((30, 4))
    process, dense = OrnsteinUhlenbeck(time, memory), covariance(time, memory)
    np.testing.assert_allclose(process.covariance_times(columns), dense @ columns, atol=1e-9)
    for ratio in (0.0, 0.3, 20.0):
        whole = np.eye(30) + ratio * dense
        np.testing.assert_allclose(process.whiten(ratio, columns), np.linalg.solve(whole, columns), atol=1e-9)
        _, log_det = process.smoothed(ratio, columns)
        assert log_det == pytest.approx(np.linalg.slogdet(whole)[1], abs=1e-9)


def test_rows_at_the_same_time_do_not_break_it() -> None:
    solved = OrnsteinUhlenbeck(np.zeros(5), 1.0).whiten(2.0, np.eye(5))
    np.testing.assert_allclose(solved, np.linalg.inv(np.eye(5) + 2.0), atol=1e-4)


@pytest.mark.parametrize(("white", "wander", "memory"), [(1.0, 0.0, 5.0), (1.0, 2.0, 5.0), (0.5, 4.0, 12.0)])
def test_scales_are_those_planted(white: float, wander: float, memory: float) -> None:
    rng = np.random.default_rng(4)
    time = np.cumsum(rng.uniform(0.5, 1.5, 600))
    slow = np.linalg.cholesky(covariance(time, memory) + 1e-12 * np.eye(600)) @ rng.standard_normal((600, 3))
    design = np.stack([np.ones(600), time / time[-1]], axis=1)[:, None, :] * np.ones((1, 3, 1))
    error = white * rng.standard_normal((600, 3)) + wander * slow + (design @ np.array([3.0, -5.0]))
    processes = [OrnsteinUhlenbeck(time, one) for one in memories(time).tolist()]
    found = noise_posterior(processes, NONE[: len(error)], error, design, SCALE)
    assert found is not None
    share = np.exp(found.log_likelihood - found.log_likelihood.max())
    share /= share.sum()
    # What sets the covariance of slow parameters: the noise at the slowest frequencies.
    tried = finer(memories(time))
    at_rest = share @ (found.white + 2 * tried * found.wander)
    assert at_rest == pytest.approx(white**2 + 2 * memory * wander**2, rel=0.5)
    if not wander:
        assert share @ found.white == pytest.approx(white**2, rel=0.15)


def test_parameters_that_were_fitted_are_paid_for() -> None:
    rng = np.random.default_rng(5)
    time = np.arange(16.0)
    processes = [OrnsteinUhlenbeck(time, one) for one in memories(time).tolist()]
    variances = []
    for _ in range(200):
        design, error = rng.standard_normal((16, 1, 8)), rng.standard_normal((16, 1))
        left = error[:, 0] - design[:, 0] @ np.linalg.lstsq(design[:, 0], error[:, 0], rcond=None)[0]
        found = noise_posterior(processes, NONE[:16], left[:, None], design, SCALE)
        assert found is not None
        variances.append(float((found.white + found.wander).mean()))
    # The posterior mean of a variance of 8 degrees of freedom is 8/6 of it; unpaid parameters would give about 0.6.
    assert 0.9 < np.mean(variances) < 2.0


def test_too_few_rows_do_not_determine_noise() -> None:
    time = np.arange(3.0)
    processes = [OrnsteinUhlenbeck(time, one) for one in memories(time).tolist()]
    assert noise_posterior(processes, NONE[:3], np.ones((3, 1)), np.eye(3)[:, None, :], SCALE) is None


def test_a_mixture_finds_its_spread_and_its_outliers() -> None:
    rng = np.random.default_rng(6)
    wrong = rng.random(400) < 0.15
    errors = 0.01 * rng.standard_normal((400, 3)) + wrong[:, None] * rng.uniform(-1, 1, (400, 3))
    squares = (errors**2).sum(axis=1)
    other = squares + 0.1
    found = fit_mixtures([Sort(np.stack([squares, other]), 3.0, 2.0, 1e-6)], np.ones(400), 10.0)
    assert found.ratio[0] == pytest.approx(wrong.mean(), abs=0.02)
    assert found.stds[0][0] == pytest.approx(0.01, rel=0.1)
    assert ((found.inlier[0] < 0.5) != wrong).mean() < 0.01
    assert found.log_likelihood[0] > found.log_likelihood[1]


def test_errors_far_beyond_all_noise_leave_a_finite_correlation() -> None:
    """What a joint of other rows leaves may be a metre, where noise is a tenth of a millimetre."""
    innovation = 1e5 * np.random.default_rng(0).standard_normal((1, 40, 6))
    matrix, dof = correlated(innovation, np.zeros((1, 40, 6)))
    assert np.isfinite(matrix).all()
    assert np.linalg.eigvalsh(matrix[0])[0] > 0
    assert dof[0] > 0
