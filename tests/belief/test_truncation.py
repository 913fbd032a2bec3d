"""The split of a Gaussian at a guard: against scipy's truncated normal, Monte Carlo, and the laws of total moments."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.stats import norm, truncnorm
from single_gaussian.one_at_a_time import merged_moments, split, truncate

from micah_plan.belief.truncation import NEGLIGIBLE, is_cut, onto_boundary, truncated, uncut

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
    total, root = merged_moments(
        [p.probability for p in parts], np.stack([p.mean for p in parts]), [p.factor for p in parts]
    )
    assert np.allclose(total, mean, atol=1e-7)
    assert np.allclose(root @ root.T, factor @ factor.T, atol=1e-7)


@pytest.mark.parametrize("end", [-0.8, -0.1, 0.0, 0.3])
def test_from_a_known_start_all_that_ends_inside_crosses(end: float) -> None:
    crossing, staying = split(*moving(-0.5, 0.0, end + 0.5, 0.4), BEFORE, AFTER)
    assert crossing.probability == pytest.approx(norm.cdf(end / 0.4), abs=1e-9)
    for part, within in ((crossing, (-end / 0.4, np.inf)), (staying, (-np.inf, -end / 0.4))):
        assert part.mean == pytest.approx([-0.5, truncnorm(*within, loc=end, scale=0.4).mean()], abs=1e-7)


def test_nothing_is_behind_the_guard_before_the_step() -> None:
    at_rest = split(*moving(-0.02, 0.1, 0.0, 0.0), BEFORE, AFTER)
    assert at_rest[0].probability == 0.0
    assert np.array_equal(at_rest[1].mean, [-0.02, -0.02])
    pushed = split(*moving(-0.1, 0.05, 1.0, 0.0), BEFORE, AFTER)
    assert pushed[0].probability == pytest.approx(1.0, abs=1e-9)
    retreating = split(*moving(-0.02, 0.1, -0.3, 0.0), BEFORE, AFTER)
    assert retreating[0].probability == 0.0


def before_the_cut(ahead: float) -> tuple[float, float, float]:
    """Mean and std of a Gaussian that, cut at 0, has the mean -ahead and the std 1, and its share; the rest is at 0.

    By SciPy's own moments and root finding. A Gaussian whose mean lies behind 0 is never asked for.
    """
    steepest = truncnorm(-np.inf, 0.0)
    if ahead < -steepest.mean() / steepest.std():
        # Share and size of a half Gaussian that with a lump at 0 has these moments.
        share = steepest.mean() ** 2 * (1 + ahead**2) / steepest.moment(2) / ahead**2
        size = np.sqrt((1 + ahead**2) * share / steepest.moment(2))
        return 0.0, float(size), 1 / float(share)

    def lacks(place: float) -> float:
        cut = truncnorm(-np.inf, place)
        return float((place - cut.mean()) / cut.std() - ahead)

    place = brentq(lacks, 0.0, 12.0)
    scale = 1 / float(truncnorm(-np.inf, place).std())
    return -place * scale, scale, 1.0


@pytest.mark.sweep
@pytest.mark.parametrize("ahead", [0.2, 0.4, 0.8, 1.2, 1.4, 2.0, 3.5])
@pytest.mark.parametrize(("motion", "noise"), [(0.0, 0.3), (0.8, 0.0), (0.8, 0.5), (-0.5, 0.4), (2.5, 1.0)])
def test_what_crosses_is_that_of_samples_of_the_density_that_ends_at_the_guard(
    ahead: float, motion: float, noise: float
) -> None:
    rng, count = np.random.default_rng(7), 400_000
    mean, std, share = before_the_cut(ahead)
    drawn = rng.random(count)
    start = mean + std * norm.ppf(drawn * norm.cdf(-mean / std))
    start[rng.random(count) > share] = 0.0
    assert start.mean() == pytest.approx(-ahead, abs=0.01)
    assert start.std() == pytest.approx(1.0, abs=0.01)
    path = np.column_stack([start, start + motion + noise * rng.standard_normal(count)])
    fires = path[:, 1] > 0
    for part, chosen in zip(split(*moving(-ahead, 1.0, motion, noise), BEFORE, AFTER), (fires, ~fires), strict=True):
        assert part.probability == pytest.approx(chosen.mean(), abs=0.004)
        if chosen.mean() > 0.01:
            np.testing.assert_allclose(part.mean, path[chosen].mean(axis=0), rtol=0.03, atol=0.03)
            np.testing.assert_allclose(part.factor @ part.factor.T, np.cov(path[chosen].T), rtol=0.03, atol=0.05)


@pytest.mark.parametrize("ahead", [0.9, 1.4, 2.0, 3.5, 5.9])
def test_uncut_is_truncated_undone(ahead: float) -> None:
    """Up to the width of a table's row; along the margin and across it."""
    mean, factor = np.array([[ahead], [0.3]]), np.array([[[1.0], [0.0]], [[0.5], [0.7]]])
    margin, row = np.array([ahead]), np.array([[1.0], [0.0]])
    assert is_cut(margin, row)[0]
    wider_mean, wider, (share,) = uncut(mean, factor, margin, row)
    back, narrow = truncated(wider_mean, wider, wider_mean[0], wider[0])
    if share == 1.0:
        np.testing.assert_allclose(back, mean, atol=1e-6)
        np.testing.assert_allclose(narrow, factor, atol=1e-6)
    else:
        # With what lies on the boundary it has the mean and the std.
        on_it, _ = onto_boundary(mean, factor, margin, row)
        assert on_it[0, 0] == pytest.approx(0.0, abs=1e-12)
        assert share * back[0, 0] == pytest.approx(ahead, rel=1e-6)
        assert share * (back[0, 0] ** 2 + narrow[0, 0, 0] ** 2) == pytest.approx(1 + ahead**2, rel=1e-6)


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
    mean, factor = merged_moments([0.6, 0.2], means, factors)
    weights = np.array([0.75, 0.25])
    spread = means - weights @ means
    expected = sum(w * (f @ f.T + np.outer(d, d)) for w, f, d in zip(weights, factors, spread, strict=True))
    assert np.allclose(mean, weights @ means)
    assert np.allclose(factor @ factor.T, expected)
