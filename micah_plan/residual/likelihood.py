"""Predictive likelihood of innovations: Student's t with an estimated scale, robust against single bad rows.

Source: Lange, Little and Taylor, "Robust statistical modeling using the t distribution", JASA 1989.
"""

from __future__ import annotations

import numpy as np
from scipy.special import gammaln

from micah_plan.arrays import ROUND_OFF, Floats

FEWEST_ROWS = 8
"""Rows that a run needs to show its noise, and a recording to be compared."""
LEAST_EVIDENCE, EVIDENCE_PER_ROW = 8.0, 0.01
"""Evidence [nats] that whatever is added must have: odds of 3000 to 1, more than what two dozen candidates take to be
safe; and so much per row (1 % of the innovations' std)."""
TIE = 3.0
"""What is within this of the best is as good as it [nats]."""
FREEDOM = 4.0
"""Degrees of freedom of residuals among which some are far off."""
_REGRESSION_ROUNDS = 30


def robust_log_density(design: Floats, now: Floats, freedom: float, finest: float = 1e-3) -> float:
    """Log density of values (N,) under the best linear prediction from a design (N, k), with a fitted scale [nats].

    Args:
        finest: the smallest scale, as a share of the values' std, so that values that are exact to the last digit do
            not decide.
    """
    least = finest * float(np.std(now)) + ROUND_OFF
    weight, residual, scale = np.ones(len(now)), now, least
    for _ in range(_REGRESSION_ROUNDS):
        root = np.sqrt(weight)
        if design.shape[1]:
            residual = now - design @ np.linalg.lstsq(design * root[:, None], now * root, rcond=None)[0]
        scale = max(float(np.sqrt(np.mean(weight * residual**2))), least)
        weight = (freedom + 1.0) / (freedom + (residual / scale) ** 2)
    return float(student_t_log_density(residual / scale, freedom).sum() - len(residual) * np.log(scale))


def student_t_log_density(x: Floats, freedom: float) -> Floats:
    """Log density of Student's t distribution of unit scale at x, of any shape."""
    half = 0.5 * (freedom + 1.0)
    norm = gammaln(half) - gammaln(0.5 * freedom) - 0.5 * np.log(np.pi * freedom)
    return np.asarray(norm - half * np.log1p(np.square(x) / freedom))


def independent_share(correlation: float) -> float:
    """Effective fraction of rows with lag-1 correlation r: (1 - r) / (1 + r) (Bartlett 1935)."""
    r = max(correlation, 0.0)
    return (1.0 - r) / (1.0 + r)
