"""Gaussian arithmetic on factors against textbook covariance formulas, at all scales."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import multivariate_normal, norm
from single_gaussian import one_at_a_time
from single_gaussian import reference as gaussian

from micah_plan.automaton.hybrid import Pin, Reset
from micah_plan.automaton.region import HalfSpace


def random_gaussian(seed: int, n: int = 3, scale: float = 1.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """mean, lower factor, covariance"""
    rng = np.random.default_rng(seed)
    factor = scale * np.linalg.cholesky(np.atleast_2d(np.cov(rng.normal(size=(n, n + 3)))))
    return rng.normal(size=n) * scale, factor, factor @ factor.T


@given(st.integers(0, 10_000), st.integers(1, 5), st.integers(1, 8), st.floats(1e-8, 1e8))
def test_lower_factor_is_a_factor(seed: int, n: int, k: int, scale: float) -> None:
    matrix = np.random.default_rng(seed).normal(size=(n, k)) * scale
    factor = one_at_a_time.lower_factor(matrix)
    assert np.array_equal(factor, np.tril(factor))
    assert (np.diag(factor) >= 0).all()
    assert np.allclose(factor @ factor.T, matrix @ matrix.T, rtol=1e-10, atol=1e-12 * scale**2)


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
@pytest.mark.parametrize("seed", range(5))
def test_update_is_the_kalman_update(seed: int, scale: float) -> None:
    mean, factor, P = random_gaussian(seed, scale=scale)
    std = np.array([0.3, np.inf, 0.1]) * scale
    z = np.array([0.2, 1.0, -0.4]) * scale
    seen = [0, 2]
    S = P[np.ix_(seen, seen)] + np.diag(std[seen] ** 2)
    K = np.linalg.solve(S, P[seen]).T
    new_mean, new_factor, log_likelihood = one_at_a_time.update(mean, factor, z, std)
    assert np.allclose(new_mean, mean + K @ (z - mean)[seen], rtol=1e-9)
    assert np.allclose(new_factor @ new_factor.T, P - K @ P[seen], rtol=1e-8, atol=1e-12 * scale**2)
    assert log_likelihood == pytest.approx(multivariate_normal(mean[seen], S, allow_singular=True).logpdf(z[seen]))


@given(st.integers(0, 10_000), st.integers(1, 4), st.floats(1e-6, 1e4), st.floats(0.0, 1e4))
def test_measuring_never_adds_variance_and_noise_never_removes_any(seed: int, n: int, scale: float, std: float) -> None:
    mean, factor, P = random_gaussian(seed, n, scale)
    updated = one_at_a_time.update(mean, factor, np.zeros(n), np.full(n, std))[1]
    assert np.linalg.eigvalsh(P - updated @ updated.T).min() > -1e-11 * scale**2
    predicted = gaussian.predict(mean, factor, np.ones(n), np.full(n, std))
    assert np.allclose(predicted[0], mean + 1)
    assert np.allclose(predicted[1] @ predicted[1].T, P + std**2 * np.eye(n), rtol=1e-10)


def test_no_measurement_is_no_information() -> None:
    mean, factor, _ = random_gaussian(0)
    same = one_at_a_time.update(mean, factor, np.full(3, np.nan), np.ones(3))
    assert np.array_equal(same[0], mean)
    assert np.array_equal(same[1], factor)
    assert same[2] == 0.0


def test_reset_goes_through_the_covariance() -> None:
    mean, factor, P = random_gaussian(1, n=2)
    transition = Reset(((1.0, 0.5), (0.0, 0.0)), ((1.0,), (0.0,)), (0.0, 2.0))
    new_mean, new_factor = gaussian.reset(mean, factor, np.array([0.3]), transition)
    A = np.array(transition.A)
    assert np.allclose(new_mean, A @ mean + [0.3, 2.0])
    assert np.allclose(new_factor @ new_factor.T, A @ P @ A.T)


def test_pins_add_to_what_is_known_or_replace_it() -> None:
    mean, factor, P = random_gaussian(2)
    pin = Pin(1, 0.7, 0.2)
    added = one_at_a_time.condition_on_pins(mean, factor, [pin])
    gain = P[:, 1] / (P[1, 1] + 0.04)
    assert np.allclose(added[0], mean + gain * (0.7 - mean[1]))
    assert np.allclose(added[1] @ added[1].T, P - np.outer(gain, P[1]))
    replaced = one_at_a_time.replaced_at_pins(mean, factor, [pin])
    expected = P.copy()
    expected[1], expected[:, 1], expected[1, 1] = 0.0, 0.0, 0.04
    assert np.allclose(replaced[1] @ replaced[1].T, expected)
    assert replaced[0].tolist() == [mean[0], 0.7, mean[2]]


def test_half_space_probability_is_the_normal_one() -> None:
    mean, factor, P = random_gaussian(3)
    half_space = HalfSpace((1.0, -2.0, 0.5), (0.3,), 0.4)
    u = np.array([0.7])
    a = np.array(half_space.a)
    z = (a @ mean + 0.21 - 0.4) / np.sqrt(a @ P @ a)
    assert gaussian.half_space_probability(mean, factor, u, half_space) == pytest.approx(norm.cdf(z))


def test_half_spaces_on_inputs_hold_or_do_not() -> None:
    mean, factor, _ = random_gaussian(4, n=1)
    for strict, on_boundary in ((False, 1.0), (True, 0.0)):
        half_space = HalfSpace((0.0,), (1.0,), 0.5, strict)
        values = [gaussian.half_space_probability(mean, factor, np.array([u]), half_space) for u in (0.4, 0.5, 0.6)]
        assert values == [0.0, on_boundary, 1.0]
