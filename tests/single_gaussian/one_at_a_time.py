"""The package's functions on many Gaussians, called with one."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from micah_plan.automaton.hybrid import Pin
from micah_plan.belief import gaussian, truncation
from micah_plan.belief.gaussian import lower_factors
from micah_plan.belief.moment_matching import merged_moments as mixed_moments


def lower_factor(matrix: np.ndarray) -> np.ndarray:
    return lower_factors(np.array(matrix, dtype=float)[..., None])[..., 0]


def update(
    mean: np.ndarray, factor: np.ndarray, z: np.ndarray, std: np.ndarray
) -> tuple[np.ndarray, np.ndarray, float]:
    """Mean, factor and log likelihood after measuring z (n,), NaN where there is no measurement."""
    noise = np.broadcast_to(np.asarray(std, dtype=float), np.shape(mean))
    columns = (np.asarray(value, dtype=float)[..., None] for value in (mean, factor, z, noise))
    means, factors, likelihood = gaussian.measured(*columns)
    return means[:, 0], factors[..., 0], float(likelihood[0])


def condition_on_pins(mean: np.ndarray, factor: np.ndarray, pins: Sequence[Pin]) -> tuple[np.ndarray, np.ndarray]:
    means, factors = gaussian.condition_on_pins(mean[:, None], factor[..., None], pins)
    return means[:, 0], lower_factors(factors)[..., 0]


def replaced_at_pins(mean: np.ndarray, factor: np.ndarray, pins: Sequence[Pin]) -> tuple[np.ndarray, np.ndarray]:
    means, factors = gaussian.replaced_at_pins(mean[:, None], factor[..., None], pins)
    return means[:, 0], lower_factors(factors)[..., 0]


Margin = tuple[np.ndarray, float]


class Part(NamedTuple):
    """A share of a Gaussian as one of its own: probability, mean (N,) and any square root (N, K) of its covariance."""

    probability: float
    mean: np.ndarray
    factor: np.ndarray


def split(mean: np.ndarray, factor: np.ndarray, before: Margin, after: Margin) -> tuple[Part, Part]:
    """What crosses into a half-space and what stays, for margins weights @ x - offset before and after the step."""
    margins = truncation.Margins(
        np.array([[weights @ mean - offset] for weights, offset in (before, after)]),
        np.array([(weights @ factor)[:, None] for weights, _ in (before, after)]),
    )
    if not margins.can_cross(np.ones(1))[0]:  # filters do not ask then
        return Part(0.0, mean, factor), Part(1.0, mean, factor)
    shares = truncation.split(mean[:, None], factor[..., None], margins)
    crossing, staying = (
        Part(float(p[0]), m[..., 0], f[..., 0])
        for p, m, f in zip(shares.probability, shares.mean, shares.factor, strict=True)
    )
    return crossing, staying


def truncate(
    mean: np.ndarray, factor: np.ndarray, weights: np.ndarray, offset: float
) -> tuple[float, np.ndarray, np.ndarray]:
    """log P(m > 0), mean and lower factor given m > 0, with m = weights @ x - offset."""
    margin, row = np.array([weights @ mean - offset]), (weights @ factor)[:, None]
    means, factors = truncation.truncated(mean[:, None], factor[..., None], margin, row)
    score = truncation.log_probability(margin, row)
    return float(score[0]), means[:, 0], lower_factors(factors)[..., 0]


def merged_moments(
    weights: Sequence[float], means: np.ndarray, factors: Sequence[np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """Mean and lower factor of a mixture; weights need not sum to 1."""
    widest = max(factor.shape[1] for factor in factors)
    padded = [np.pad(factor, ((0, 0), (0, widest - factor.shape[1])))[..., None] for factor in factors]
    share = np.array(weights, dtype=float)[:, None] / np.sum(weights)
    center, factor = mixed_moments(share, [mean[:, None] for mean in means], padded)
    return center[:, 0], factor[..., 0]
