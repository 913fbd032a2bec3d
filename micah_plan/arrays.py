"""Array types for signatures, whose docstrings give shapes and units; tolerances for equality and spread."""

from __future__ import annotations

from math import comb
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Booleans = NDArray[np.bool_]
Scalar = TypeVar("Scalar", bound=np.generic)


ROUND_OFF = 1e-9
"""Beside 1 m, 1 rad or 1: what floating point leaves of nothing. What is smaller is no length, turn or difference."""
EQUAL = 1e-6
"""Beside 1 m, 1 rad or 1: numbers that differ by less are meant to be the same, as files have six digits."""
DIFFERENCE = 1e-6
"""Step of central differences [m or rad]."""
SMALLEST_STD = 1e-9
"""What a standard deviation of 0 is taken for, so that its inverse and its derivative exist [m or rad]."""
TINY = 1e-12
"""Beside 1: below it squares and weights are 0 except for round-off; against divisions by 0."""
VANISHING = 1e-300
"""The smallest share whose logarithm is taken."""

STDS_PER_MAD = 1.4826
"""Standard deviations of a normal distribution per median absolute deviation."""
INTERVAL = 0.95
"""Probability that an interval holds, half of the rest on each side."""
INTERVAL_STDS = 1.959964
"""Standard deviations of a normal distribution from its mean to the ends of such an interval."""
NEAR_STDS, SURE_STDS = 3.0, 4.0
"""What is normal may be as far away as the first; it is further away than the second once in 16,000 times."""


def robust_std(values: Floats) -> Floats:
    """(...) robust std of values (N, ...) from their median absolute deviation."""
    return np.asarray(STDS_PER_MAD * np.median(np.abs(values - np.median(values, axis=0)), axis=0))


def earlier_rows(rows: NDArray[Scalar], by: int, axis: int = 1) -> NDArray[Scalar]:
    """The rows shifted down by `by` (up if negative), filled with 0 or False."""
    result, along = np.zeros_like(rows), rows.shape[axis]
    by = max(-along, min(by, along))
    here, there = slice(max(by, 0), along + min(by, 0)), slice(max(-by, 0), along + min(-by, 0))
    before = (slice(None),) * axis
    result[(*before, here)] = rows[(*before, there)]
    return result


def rows_by_number(numbers: Ints) -> list[tuple[int, Ints]]:
    """Distinct numbers (k,), each with the indices (c,) of its occurrences."""
    counts = np.bincount(numbers)
    return [(number, np.flatnonzero(numbers == number)) for number in np.flatnonzero(counts).tolist()]


def white_std(values: Floats, order: int) -> Floats:
    """Std of white noise on rows (n, ...) per column, from differences of order >= 1.

    They lie about 0 and have comb(2 order, order) times its variance; what lower orders show of a motion is in them.
    """
    differences = np.diff(values, order, axis=0)
    return np.asarray(robust_std(np.concatenate([differences, -differences])) / np.sqrt(comb(2 * order, order)))
