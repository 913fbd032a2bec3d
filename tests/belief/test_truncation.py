"""The split of a Gaussian at a guard: against scipy's truncated normal, Monte Carlo, and the laws of total moments."""

from __future__ import annotations

import numpy as np
import pytest
from scalar_belief.one_at_a_time import mixed, split, truncate
from scipy.stats import norm, truncnorm

from micah_plan.belief.truncation import NEGLIGIBLE

# Joint of start and end: [x0, x1] with x1 = x0 + 0.1 + noise; the guard is x >= 0.
BEFORE, AFTER = (np.array([1.0, 0.0]), 0.0), (np.array([0.0, 1.0]), 0.0)


def moving(start: float, std: float, motion: float, noise: float) -> tuple[np.ndarray, np.ndarray]:
    return np.array([start, start + motion]), np.array([[std, 0.0], [std, noise]])


@pytest.mark.parametrize(("start", "motion"), [(-1.0, 0.9), (-1.0, 1.1), (-1.5, 0.4), (-0.9, 2.0)])
def test_without_noise_it_is_the_truncated_normal(start: float, motion: float) -> None:
    std = 0.15
    mean, factor = moving(start, std, motion, 0.0)
    crossing, staying = split(mean, factor, BEFORE, AFTER)
    cut = -(start + motion) / std
    assert crossing.probability == pytest.approx(norm.sf(cut), abs=1e-8)
    if crossing.probability > 1e-6:
        expected = truncnorm(cut, np.inf, loc=start + motion, scale=std)
        assert crossing.mean[1] == pytest.approx(expected.mean(), abs=1e-7)
        assert np.sqrt((crossing.factor @ crossing.factor.T)[1, 1]) == pytest.approx(expected.std(), rel=1e-5)
    if staying.probability > 1e-6:
        expected = truncnorm(-np.inf, cut, loc=start + motion, scale=std)
        assert staying.mean[1] == pytest.approx(expected.mean(), abs=1e-7)
        assert np.sqrt((staying.factor @ staying.factor.T)[1, 1]) == pytest.approx(expected.std(), rel=1e-5)


@pytest.mark.parametrize("seed", range(6))
def test_split_of_a_joint_in_five_dimensions_equals_monte_carlo(seed: int) -> None:
    rng = np.random.default_rng(seed)
    mean, factor = rng.normal(size=5), rng.normal(size=(5, 5))
    before, after = (rng.normal(size=5), 0.0), (rng.normal(size=5), 0.0)
    before = (before[0], before[0] @ mean + 5.5 * np.linalg.norm(before[0] @ factor))  # starts well outside
    after = (after[0], after[0] @ mean + rng.normal() * np.linalg.norm(after[0] @ factor))
    samples = mean + rng.normal(size=(400_000, 5)) @ factor.T
    fires = samples @ after[0] > after[1]
    for part, chosen in zip(split(mean, factor, before, after), (samples[fires], samples[~fires]), strict=True):
        assert part.probability == pytest.approx(len(chosen) / len(samples), abs=0.004)
        assert np.allclose(part.mean, chosen.mean(axis=0), atol=0.05)
        assert np.allclose(part.factor @ part.factor.T, np.cov(chosen.T), rtol=0.03, atol=0.12)


@pytest.mark.parametrize("start", [-3.0, -0.8])
@pytest.mark.parametrize("motion", [0.0, 0.3, 0.9, 4.0])
@pytest.mark.parametrize("noise", [0.0, 1e-6, 0.02, 0.5])
def test_parts_sum_up_to_the_whole(start: float, motion: float, noise: float) -> None:
    mean, factor = moving(start, 0.12, motion, noise)
    parts = [part for part in split(mean, factor, BEFORE, AFTER) if part.probability > 0]
    assert sum(part.probability for part in parts) == pytest.approx(1.0, abs=NEGLIGIBLE)  # what filters drop is 0
    total, root = mixed([p.probability for p in parts], np.stack([p.mean for p in parts]), [p.factor for p in parts])
    assert np.allclose(total, mean, atol=1e-7)
    assert np.allclose(root @ root.T, factor @ factor.T, atol=1e-7)


def test_the_tail_behind_the_guard_neither_leaks_at_rest_nor_stays_behind() -> None:
    at_rest = split(*moving(-0.02, 0.1, 0.0, 0.0), BEFORE, AFTER)
    assert at_rest[0].probability == 0.0
    assert np.array_equal(at_rest[1].mean, [-0.02, -0.02])
    pushed = split(*moving(-0.02, 0.1, 1.0, 0.0), BEFORE, AFTER)
    assert pushed[0].probability == pytest.approx(1.0, abs=1e-9)
    retreating = split(*moving(-0.02, 0.1, -0.3, 0.0), BEFORE, AFTER)
    assert retreating[0].probability == 0.0


def test_a_mean_inside_crosses_even_when_it_moves_out() -> None:
    crossing, _ = split(*moving(0.5, 0.1, -0.2, 0.01), BEFORE, AFTER)
    assert crossing.probability > 0.999
    assert crossing.mean == pytest.approx([0.5, 0.3], abs=1e-5)


@pytest.mark.parametrize("scale", [1e-4, 1.0, 1e5])
def test_split_does_not_depend_on_the_unit(scale: float) -> None:
    mean, factor = moving(-1.0, 0.3, 0.8, 0.1)
    reference = split(mean, factor, BEFORE, AFTER)
    for part, twin in zip(split(mean * scale, factor * scale, BEFORE, AFTER), reference, strict=True):
        assert part.probability == pytest.approx(twin.probability, abs=1e-3)
        assert np.allclose(part.mean / scale, twin.mean, atol=2e-3)


@pytest.mark.parametrize("z", [-300.0, -99.0, -30.0, -3.0, 0.0, 3.0, 30.0])
def test_truncate_is_the_truncated_normal_far_into_the_tail(z: float) -> None:
    log_probability, mean, factor = truncate(np.array([z]), np.array([[1.0]]), np.array([1.0]), 0.0)
    assert log_probability == pytest.approx(norm.logcdf(z), rel=1e-9)
    assert mean[0] > 0
    assert mean[0] == pytest.approx(1 / -z if z < -20 else truncnorm(-z, np.inf, loc=z).mean(), rel=3e-3)
    assert factor[0, 0] == pytest.approx(1 / -z if z < -20 else truncnorm(-z, np.inf).std(), rel=5e-3)


def test_mixed_is_moment_matching() -> None:
    means = np.array([[0.0, 1.0], [2.0, -1.0]])
    factors = [np.diag([1.0, 0.5]), np.array([[0.3, 0.0], [0.1, 0.2]])]
    mean, factor = mixed([0.6, 0.2], means, factors)
    weights = np.array([0.75, 0.25])
    spread = means - weights @ means
    expected = sum(w * (f @ f.T + np.outer(d, d)) for w, f, d in zip(weights, factors, spread, strict=True))
    assert np.allclose(mean, weights @ means)
    assert np.allclose(factor @ factor.T, expected)
