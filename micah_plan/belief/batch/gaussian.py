"""Many Gaussians at once: means (p, n) and factors (p, n, n). Twin of `belief.gaussian`, compared by a test."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from micah_plan.automaton.hybrid import Pin
from micah_plan.belief.gaussian import SMALLEST_STD

Floats = NDArray[np.float64]


def lower_factors(matrices: Floats) -> Floats:
    """Lower triangular L (p, n, n) with non-negative diagonals and L L' = M M', for M (p, n, k)."""
    _, n, k = matrices.shape
    if n == 1:
        return np.asarray(np.sqrt(np.einsum("pik,pik->p", matrices, matrices))[:, None, None])
    padded = matrices if k >= n else np.concatenate([matrices, np.zeros((len(matrices), n, n - k))], axis=2)
    roots: Floats = np.asarray(np.linalg.qr(padded.transpose(0, 2, 1), mode="r"))
    factors = roots.transpose(0, 2, 1)
    signs = np.where(np.diagonal(factors, axis1=1, axis2=2) < 0, -1.0, 1.0)
    return np.asarray(factors * signs[:, None, :])


def update(means: Floats, factors: Floats, z: Floats, observation_std: ArrayLike) -> tuple[Floats, Floats, Floats]:
    """Means, factors and log likelihoods (p,) after measuring z (p, n), columns NaN where there is no measurement.

    Args:
        observation_std: (n,) the same for all, or (p, n); infinite in a column that is not measured.
    """
    std = np.broadcast_to(np.asarray(observation_std, dtype=float), means.shape)
    seen = np.flatnonzero(np.isfinite(z).all(axis=0) & np.isfinite(std).all(axis=0))
    if not seen.size:
        return means, factors, np.zeros(len(means))
    return _given(means, factors, (z - means)[:, seen], factors[:, seen], std[:, seen])


def _given(
    means: Floats, factors: Floats, innovations: Floats, rows: Floats, std: Floats
) -> tuple[Floats, Floats, Floats]:
    """Means, factors and log likelihoods after k measurements: innovations (p, k), H L (p, k, n), std (p, k)."""
    count, k, n = rows.shape
    joint = np.zeros((count, k + n, k + n))
    joint[:, np.arange(k), np.arange(k)] = np.maximum(std, SMALLEST_STD)
    joint[:, :k, k:], joint[:, k:, k:] = rows, factors
    array = lower_factors(joint)
    root, gain_root, posterior = array[:, :k, :k], array[:, k:, :k], array[:, k:, k:]
    whitened = np.linalg.solve(root, innovations[:, :, None])
    logs = np.log(np.diagonal(root, axis1=1, axis2=2)).sum(axis=1)
    log_likelihood = -0.5 * np.square(whitened).sum(axis=(1, 2)) - logs - 0.5 * k * np.log(2 * np.pi)
    return means + (gain_root @ whitened)[:, :, 0], posterior, np.asarray(log_likelihood)


def condition_on_pins(means: Floats, factors: Floats, pins: Sequence[Pin]) -> tuple[Floats, Floats]:
    """Means and factors given that a mode holds its pins: each pin is one measurement of its coordinate."""
    for pin in pins:
        away, rows = pin.value - means[:, pin.coordinate], factors[:, pin.coordinate]
        if pin.follows is not None:
            away, rows = away + means[:, pin.follows], rows - factors[:, pin.follows]
        means, factors, _ = _given(means, factors, away[:, None], rows[:, None], np.full((len(rows), 1), pin.std))
    return means, factors


def hold_at_pins(means: Floats, factors: Floats, pins: Sequence[Pin]) -> tuple[Floats, Floats]:
    """Means and square roots (p, n, k + pins) of the covariances once a mode holds its pins where its guard is.

    Args:
        factors: (p, n, k) any square roots.
    """
    count, n = means.shape
    means, factors = means.copy(), np.concatenate([factors, np.zeros((count, n, len(pins)))], axis=2)
    for column, pin in enumerate(pins, start=factors.shape[2] - len(pins)):
        means[:, pin.coordinate], factors[:, pin.coordinate] = pin.value, 0.0
        if pin.follows is not None:
            means[:, pin.coordinate] += means[:, pin.follows]
            factors[:, pin.coordinate] = factors[:, pin.follows]
        factors[:, pin.coordinate, column] = pin.std
    return means, factors
