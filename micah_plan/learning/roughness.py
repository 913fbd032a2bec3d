"""How far points lie apart and how rough a path of rows is, in any dimension and in no preferred axes."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from micah_plan.arrays import Floats

_BEND_VARIANCE = 1.5  # of a row from the middle of its neighbours, for white noise of variance 1


def extent(points: Floats, ignored: float = 0.0) -> float:
    """Distance of points (n, k) from the one that is farthest from the first, at most; 0 without points.

    Args:
        ignored: share of the points that may lie further away.
    """
    if not len(points):
        return 0.0
    rank = round((1 - ignored) * (len(points) - 1))
    away = np.linalg.norm(points - points[0], axis=1)
    end = points[np.argpartition(away, rank)[rank]]
    return float(np.partition(np.linalg.norm(points - end, axis=1), rank)[rank])


def bends(rows: Floats, lag: int = 1) -> Floats:
    """(n - 2 lag, k) by how much rows (n, k) miss the middle of those `lag` before and after."""
    return np.asarray(rows[lag:-lag] - 0.5 * (rows[: -2 * lag] + rows[2 * lag :]))


def std_of_bends(missed: Floats, size: ArrayLike = 3.0) -> Floats:
    """Std (...) per axis of the white noise that leaves such `bends` (..., n, 3), blind to outliers.

    Args:
        size: in how many directions there is noise.
    """
    lengths = np.sqrt((missed**2).sum(axis=-1))
    # The median of a chi-squared variable (Wilson and Hilferty).
    k = np.asarray(size, dtype=np.float64)
    return np.asarray(np.median(lengths, axis=-1) / np.sqrt(_BEND_VARIANCE * k * (1 - 2 / (9 * k)) ** 3))
