"""Extent and roughness of paths of rows, in any dimension and isotropic."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from micah_plan.arrays import Floats

_BEND_VARIANCE = 1.5  # of a row from the middle of its neighbours, for white noise of variance 1


def extent(points: Floats, ignored: float = 0.0) -> float:
    """Diameter estimate of points (n, k): largest distance from the point farthest from the first; 0 if empty.

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
    """(n - 2 lag, k) second differences: deviation of rows (n, k) from the mean of the rows at distance `lag`."""
    return np.asarray(rows[lag:-lag] - 0.5 * (rows[: -2 * lag] + rows[2 * lag :]))


def std_of_bends(missed: Floats, size: ArrayLike = 3.0) -> Floats:
    """Robust std (...) per axis of the white noise behind second differences (..., n, 3).

    Args:
        size: in how many directions there is noise.
    """
    lengths = np.sqrt((missed**2).sum(axis=-1))
    # The median of a chi-squared variable (Wilson and Hilferty).
    k = np.asarray(size, dtype=np.float64)
    return np.asarray(np.median(lengths, axis=-1) / np.sqrt(_BEND_VARIANCE * k * (1 - 2 / (9 * k)) ** 3))
