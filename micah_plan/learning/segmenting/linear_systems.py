"""Small symmetric systems, many at once, without the overhead of the general pseudo-inverse."""

from __future__ import annotations

import numpy as np

from micah_plan.arrays import Floats


def least_norm(normal: Floats, pull: Floats, least: float) -> Floats:
    """(..., k) x of least norm with normal x = pull, for symmetric positive normal (..., k, k) and pull (..., k).

    Args:
        least: information, relative to that of the best-known direction, below which x is 0.
    """
    values, vectors = np.linalg.eigh(normal)
    is_determined = values > least * values[..., -1:]
    along = (vectors.swapaxes(-1, -2) @ pull[..., None])[..., 0] * is_determined / np.where(is_determined, values, 1.0)
    return np.asarray((vectors @ along[..., None])[..., 0])
