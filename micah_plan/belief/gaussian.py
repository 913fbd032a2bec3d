"""Square-root algebra of Gaussians, many at once: measurements, pins, and factors made triangular again.

A Gaussian is a mean and a factor F of its covariance P = F F'. P itself is never formed, so it stays positive
semi-definite at any scale, and exactly known directions have rows of zeros. Within a step any F is used; only the
stored belief has the lower Cholesky factor.

Here and in the modules that build on it, p Gaussians lie side by side with their number as the **last** index: means
(n, p), factors (n, k, p). So every operation runs over all of them, and one belief is the case p = 1.

Sources: Kailath, Sayed and Hassibi, "Linear estimation", ch. 12, for array algorithms; Bierman, "Factorization methods
for discrete sequential estimation", 1977, ch. 5, for measurements one after the other (Potter's and Carlson's);
Björck, "Solving linear least squares problems by Gram-Schmidt orthogonalization", BIT 1967, for the triangular factor.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dgeqrf

from micah_plan.arrays import SMALLEST_STD, Floats, Ints
from micah_plan.automaton.hybrid import Pin

Values = TypeVar("Values", NDArray[np.float64], NDArray[np.int64], NDArray[np.bool_])

# Up to this many matrices, one call for each costs less than operations on all of them.
_FEW = 8


def take_last(values: Values, chosen: Ints) -> Values:
    """(..., c) columns `chosen` (c,) of arrays (..., p).

    Unlike indexing, which puts the numbers first in memory, it leaves their number last there too.
    """
    return values.take(chosen, axis=-1)


def weighted(weights: Floats, factors: Floats) -> Floats:
    """(..., k, p) sums of the rows of factors (n, k, p) with weights (..., n)."""
    n, *rest = factors.shape
    return np.asarray((weights @ factors.reshape(n, -1)).reshape(*weights.shape[:-1], *rest))


def replace_last(values: Floats, chosen: Ints, replacement: Floats) -> Floats:
    """Arrays (..., p) with the columns `chosen` (c,) replaced by (..., c)."""
    changed = values.copy()
    assign_last(changed, chosen, replacement)
    return changed


def assign_last(values: Floats, chosen: Ints, replacement: Floats) -> None:
    """`replace_last` in place."""
    # A run of numbers is copied as one piece.
    is_run = chosen.size > 0 and not np.count_nonzero(np.diff(chosen) != 1)
    values[..., slice(chosen[0], chosen[-1] + 1) if is_run else chosen] = replacement


def lower_factors(matrices: Floats, overwrite: bool = False) -> Floats:
    """Lower triangular L (n, n, p) with non-negative diagonals and L L' = M M', for M (n, k, p), singular or not.

    Args:
        overwrite: whether the matrices need not be kept.
    """
    n, k, count = matrices.shape
    if n == 1:
        return np.asarray(np.sqrt(np.einsum("ikp,ikp->p", matrices, matrices))[None, None])
    if count <= _FEW and k >= n:
        return _lq_by_reflections(matrices)
    return _lq_by_projections(matrices if overwrite else matrices.copy())


def _lq_by_reflections(matrices: Floats) -> Floats:
    """LQ decomposition by Householder reflections, one matrix at a time."""
    n, _, count = matrices.shape
    lower = np.empty((n, n, count))
    for i in range(count):
        # LAPACK itself: for matrices this small the checks of np.linalg.qr take several times as long as the work.
        lower[..., i] = dgeqrf(matrices[..., i].T)[0][:n].T
    return np.asarray(lower * np.tri(n)[..., None] * np.where(np.einsum("iip->ip", lower) < 0, -1.0, 1.0))


def _lq_by_projections(matrices: Floats) -> Floats:
    """Modified Gram-Schmidt over the rows, in place; its triangular factor is backward stable like Householder's."""
    n, _, count = matrices.shape
    rest, lower, taken = matrices, np.zeros((n, n, count)), np.empty_like(matrices[1:])
    for j in range(n):
        length = np.sqrt(np.einsum("kp,kp->p", rest[j], rest[j]))
        lower[j, j] = length
        if j + 1 < n:
            direction = rest[j] / np.where(length > 0.0, length, 1.0)
            along = np.einsum("ikp,kp->ip", rest[j + 1 :], direction)
            lower[j + 1 :, j] = along
            rest[j + 1 :] -= np.multiply(along[:, None], direction, out=taken[j:])
    return lower


def measured(means: Floats, factors: Floats, z: Floats, std: Floats) -> tuple[Floats, Floats, Floats]:
    """Means, lower factors and log likelihoods (p,) after measuring z with independent noise.

    One coordinate after the other, each by rotations that leave the factor lower triangular.

    Args:
        means: (n, p).
        factors: (n, n, p) lower.
        z: (n, p), NaN where there is no measurement.
        std: (n, p) of its noise; infinite: not measured either.
    """
    means, factors = means.copy(), factors.copy()
    square, scale = np.zeros(means.shape[1]), np.ones(means.shape[1])
    is_measured = np.isfinite(z) & np.isfinite(std)
    coordinates = np.flatnonzero(is_measured.any(axis=1))
    for i in coordinates:
        deviation, away, row = np.maximum(std[i], SMALLEST_STD), z[i] - means[i], factors[i].copy()
        if np.count_nonzero(is_measured[i]) < len(away):
            # Where it is not seen it has no information: it is uncoupled from the state, and its density is 1.
            deviation = np.where(is_measured[i], deviation, 1 / math.sqrt(2 * math.pi))
            away, row = np.where(is_measured[i], away, 0.0), np.where(is_measured[i], row, 0.0)
        # The innovation's variance grows by one column of the factor after the other, and so does the gain times it.
        variance, gain = deviation**2, factors[:0, 0]
        for j in range(i, -1, -1):
            column = factors[j:, j].copy()
            variance = variance + row[j] ** 2
            longer = np.sqrt(variance)
            factors[j:, j] *= deviation / longer
            before, gain = gain, column * row[j]
            if j < i:
                factors[j + 1 :, j] -= before * (row[j] / (deviation * longer))
                gain[1:] += before
            deviation = longer
        whitened = away / deviation
        means += gain * (whitened / deviation)
        square += whitened**2
        scale *= deviation
    likelihood = -0.5 * square - np.log(scale) - 0.5 * coordinates.size * math.log(2 * math.pi)
    return means, factors, likelihood


def condition_on_pins(means: Floats, factors: Floats, pins: Sequence[Pin]) -> tuple[Floats, Floats]:
    """Means and factors conditioned on a mode's pins, each a measurement of its coordinate.

    A pin that follows another coordinate is one of the difference of the two. Factors may be any square roots.
    """
    for pin in pins:
        away, row = pin.value - means[pin.coordinate], factors[pin.coordinate]
        if pin.follows is not None:
            away, row = away + means[pin.follows], row - factors[pin.follows]
        std = max(pin.std, SMALLEST_STD)
        variance = np.einsum("kp,kp->p", row, row) + std**2
        gain = np.einsum("ikp,kp->ip", factors, row) / variance
        means = means + gain * away
        factors = factors - (gain / (1.0 + std / np.sqrt(variance)))[:, None] * row
    return means, factors


def replaced_at_pins(means: Floats, factors: Floats, pins: Sequence[Pin]) -> tuple[Floats, Floats]:
    """Means and factors (n, k + pins, p) after pinned coordinates are replaced by their guard's position.

    The previous state has no information about where exactly it is pinned, so the pin replaces the estimate of the
    coordinate, whereas `condition_on_pins` fuses the two. A pin that follows another coordinate varies with that one.
    """
    n, k, count = factors.shape
    means, factors = means.copy(), np.concatenate([factors, np.zeros((n, len(pins), count))], axis=1)
    put_at_pins(means, factors, pins, k)
    return means, factors


def put_at_pins(means: Floats, factors: Floats, pins: Sequence[Pin], column: int) -> None:
    """As `replaced_at_pins`, in place: the columns of the factors from that number on are free."""
    for number, pin in enumerate(pins, start=column):
        means[pin.coordinate], factors[pin.coordinate] = pin.value, 0.0
        if pin.follows is not None:
            means[pin.coordinate] += means[pin.follows]
            factors[pin.coordinate] = factors[pin.follows]
        factors[pin.coordinate, number] = pin.std
