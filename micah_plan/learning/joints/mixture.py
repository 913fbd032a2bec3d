"""Mixture model of MLESAC for many hypotheses: inliers of unknown spread, and uniform outliers.

Sources: Torr and Zisserman, "MLESAC", CVIU 2000; MICAH, the mixture (1 - γ) N + γ U with p(γ) ∝ exp(-w γ).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from micah_plan.arrays import Floats

_STEPS = 6  # of expectation maximisation
_LARGE = 600.0  # nats
_MOST_OUTLIERS = 0.45  # share of rows
_LEAST_OUTLIERS = 1e-4  # share of rows


@dataclass(frozen=True, eq=False)
class Sort:
    """A group of errors: of positions or of rotations.

    Attributes:
        squares: (h, n) squared errors of n rows under h hypotheses.
        degrees: of freedom per row that its configuration leaves.
        span: width per axis of the uniform density of outliers.
        least: smallest std to believe in.
    """

    squares: Floats
    degrees: float
    span: float
    least: float


@dataclass(frozen=True, eq=False)
class Mixtures:
    """The mixture fitted to each of h hypotheses.

    Attributes:
        inlier: (h, n) probability that a row is no outlier.
        ratio: (h,) γ.
        stds: per sort (h,).
        log_likelihood: (h,) at these values, with the prior of γ.
    """

    inlier: Floats
    ratio: Floats
    stds: tuple[Floats, ...]
    log_likelihood: Floats


def fit_mixtures(sorts: list[Sort], weight: Floats, outlier_weight: float) -> Mixtures:
    """Expectation maximization from the medians of the errors.

    Args:
        weight: (n,) prior probability that a row can be an inlier.
        outlier_weight: w of p(γ) ∝ exp(-w γ).
    """
    h = len(sorts[0].squares)
    used = weight > 0.5
    variances = []
    for sort in sorts:
        # Wilson and Hilferty's median of a chi-squared variable.
        middle = sort.degrees * (1 - 2 / (9 * sort.degrees)) ** 3
        variances.append(np.maximum(np.median(sort.squares[:, used], axis=1) / middle, sort.least**2))
    ratio, good = np.full(h, 0.1), weight
    inlier = advantage = np.zeros((h, len(weight)))
    outside = -float(sum(sort.degrees * np.log(sort.span) for sort in sorts))
    counted = weight * used
    for step in range(_STEPS):
        # How much likelier a row is as an inlier [nats].
        level = -outside - sum(0.5 * s.degrees * np.log(2 * np.pi * v) for s, v in zip(sorts, variances, strict=True))
        advantage = np.asarray(level)[:, None]
        for sort, variance in zip(sorts, variances, strict=True):
            advantage = advantage - sort.squares * (0.5 / variance)[:, None]
        good = weight * (1 - ratio[:, None])
        inlier = good / (good + (1 - good) * np.exp(np.minimum(-advantage, _LARGE)))
        if step == _STEPS - 1:
            break
        count = inlier @ counted
        ratio = _likely_ratio(counted.sum() - count, float(counted.sum()), outlier_weight)
        for i, sort in enumerate(sorts):
            spread = (inlier * sort.squares) @ counted / np.maximum(count * sort.degrees, 1e-9)
            variances[i] = np.maximum(spread, sort.least**2)
    rows = np.logaddexp(np.log(np.maximum(good, 1e-300)) + advantage, np.log1p(-good))
    total = rows @ used + outside * used.sum() - outlier_weight * ratio
    return Mixtures(inlier, ratio, tuple(np.sqrt(v) for v in variances), total)


def _likely_ratio(outliers: Floats, n: float, weight: float) -> Floats:
    """The γ (h,) that maximizes outliers ln γ + (n - outliers) ln(1 - γ) - weight γ."""
    if weight <= 0:
        return np.clip(outliers / n, _LEAST_OUTLIERS, _MOST_OUTLIERS)
    total = n + weight
    ratio = (total - np.sqrt(total**2 - 4 * weight * outliers)) / (2 * weight)
    return np.clip(ratio, _LEAST_OUTLIERS, _MOST_OUTLIERS)
