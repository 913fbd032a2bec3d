"""Covariances with conservative stds: 1.96 of them cover 95 % of a mixture of normal errors.

A rare component of large errors would widen intervals made of the mixture's variance beyond all that ever occurs.
"""

from __future__ import annotations

import numpy as np
from scipy.special import ndtr

from micah_plan.arrays import INTERVAL, INTERVAL_STDS, TINY, Floats

_BISECTIONS = 30


def conservative_covariance(matrix: Floats, chance: Floats, off: Floats, std: Floats) -> Floats:
    """(k, k) covariance with given correlations (k, k) and conservative stds.

    Args:
        chance: (m,) probabilities of the components.
        off, std: (m, k) their means and stds.
    """
    scale = _half_width(chance, off, std) / INTERVAL_STDS / np.maximum(np.sqrt(np.diag(matrix)), 1e-300)
    return np.asarray(matrix * scale[:, None] * scale)


def _half_width(chance: Floats, off: Floats, std: Floats) -> Floats:
    """(k,) half width of the interval about 0 that holds 95 % of a mixture of normals (m, k)."""
    std = np.maximum(std, TINY)
    low, high = np.zeros(off.shape[1]), (np.abs(off) + 4 * std).max(axis=0)
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        inside = chance @ (ndtr((middle - off) / std) - ndtr((-middle - off) / std))
        low, high = np.where(inside < INTERVAL, middle, low), np.where(inside < INTERVAL, high, middle)
    return np.asarray(high)
