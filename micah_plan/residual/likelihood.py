"""Predictive likelihood of innovations: Student's t with a scale of its own, so that single bad rows decide nothing.

Source: Lange, Little and Taylor, "Robust statistical modeling using the t distribution", JASA 1989.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.special import gammaln

from micah_plan.arrays import ROUND_OFF, Booleans, Floats

if TYPE_CHECKING:
    from micah_plan.residual.simulation import Prediction

FEWEST_ROWS = 8
"""Rows that a run needs to show its noise, and a recording to be compared."""
LEAST_EVIDENCE, EVIDENCE_PER_ROW = 8.0, 0.01
"""Evidence [nats] that whatever is added must have: odds of 3000 to 1, more than what two dozen candidates take to be
safe; and so much per row (1 % of the innovations' std)."""
TIE = 3.0
"""What is within this of the best is as good as it [nats]."""
FREEDOM = 4.0
"""Degrees of freedom of residuals among which some are far off."""
_ROUNDS, _REGRESSION_ROUNDS = 12, 30
_CONVERGED = 1e-6  # relative: likelihoods then differ by less than a row's rounding


@dataclass(frozen=True, eq=False)
class Fitness:
    """How well B predictions fit the rows of their training segments.

    Attributes:
        loss: (B,) negative log likelihood [nats].
        scale: (B,) of the noise, in the coordinate's unit.
        weight: (B, S, T) of each row for least squares, 0 where it is not trained on.
    """

    loss: Floats
    scale: Floats
    weight: Floats


def fitness(prediction: Prediction, trained: Booleans, freedom: float) -> Fitness:
    """The best scale for each prediction (maximum likelihood, by expectation maximisation) and what it gives.

    Args:
        trained: (B, S, T) rows that count.
        freedom: degrees of freedom of the t distribution.
    """
    squared = prediction.error**2 / prediction.variance
    count = trained.sum(axis=(1, 2))
    scale2 = np.maximum((squared * trained).sum(axis=(1, 2)) / np.maximum(count, 1), ROUND_OFF**2)
    counted = squared * trained
    for _ in range(_ROUNDS):
        weight = (freedom + 1) / (freedom + squared / scale2[:, None, None])
        before, scale2 = scale2, np.einsum("bst,bst->b", weight, counted) / np.maximum(count, 1)
        scale2 = np.maximum(scale2, ROUND_OFF**2)
        if np.all(np.abs(scale2 - before) <= _CONVERGED * before):
            break
    density = log_density(prediction, np.sqrt(scale2), freedom)
    loss = -(density * trained).sum(axis=(1, 2))
    weight = (freedom + 1) / (freedom + squared / scale2[:, None, None]) * trained
    weight = weight / (prediction.variance * scale2[:, None, None])
    return Fitness(np.asarray(loss), np.sqrt(scale2), weight)


def log_density(prediction: Prediction, scale: Floats, freedom: float) -> Floats:
    """(B, S, T) log predictive density of each row, given the scale (B,) of the noise [nats]."""
    spread = prediction.variance * (scale**2)[:, None, None]
    constant = gammaln((freedom + 1) / 2) - gammaln(freedom / 2) - 0.5 * np.log(freedom * np.pi)
    tail = np.log1p(prediction.error**2 / (freedom * spread))
    return np.asarray(constant - 0.5 * np.log(spread) - 0.5 * (freedom + 1) * tail)


def robust_log_density(design: Floats, now: Floats, freedom: float, least: float) -> float:
    """Log density of values (N,) about the best linear prediction from a design (N, k), with a scale of its own [nats].

    Args:
        least: the smallest scale.
    """
    weight, residual, scale = np.ones(len(now)), now, least
    for _ in range(_REGRESSION_ROUNDS):
        root = np.sqrt(weight)
        if design.shape[1]:
            residual = now - design @ np.linalg.lstsq(design * root[:, None], now * root, rcond=None)[0]
        scale = max(float(np.sqrt(np.mean(weight * residual**2))), least)
        weight = (freedom + 1.0) / (freedom + (residual / scale) ** 2)
    return float(student_t_log_density(residual / scale, freedom).sum() - len(residual) * np.log(scale))


def student_t_log_density(x: Floats, freedom: float) -> Floats:
    """ln density of Student's t distribution with that many degrees of freedom, of unit scale, at x of any shape."""
    half = 0.5 * (freedom + 1.0)
    norm = gammaln(half) - gammaln(0.5 * freedom) - 0.5 * np.log(np.pi * freedom)
    return np.asarray(norm - half * np.log1p(np.square(x) / freedom))
