"""One Gaussian at a time: prediction, measurement, reset, pins, half-spaces, on lower Cholesky factors by QR."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg.lapack import dgeqrf
from scipy.special import ndtr

from micah_plan.automaton.hybrid import Pin, Reset
from micah_plan.automaton.region import HalfSpace

Floats = NDArray[np.float64]

# As in the symbolic twin: the smallest std that the arithmetic resolves [rad or m].
SMALLEST_STD = 1e-9
# A half-space that many standard deviations away holds a share below 1e-15.
FAR_STDS = 8.0


def lower_factor(matrix: Floats) -> Floats:
    """Lower triangular L (n, n) with non-negative diagonal and L L' = M M', for M (n, k)."""
    n, k = matrix.shape
    if n == 1:
        return np.asarray([[math.sqrt(float(matrix[0] @ matrix[0]))]])
    padded = matrix if k >= n else np.hstack([matrix, np.zeros((n, n - k))])
    # LAPACK itself: for matrices this small the checks of np.linalg.qr take several times as long as the work.
    factor = np.asarray(dgeqrf(padded.T)[0])[:n].T
    signs = np.where(factor.diagonal() < 0, -1.0, 1.0)
    return np.asarray(np.tril(factor * signs))


def predict(mean: Floats, factor: Floats, displacement: Floats, process_std: ArrayLike) -> tuple[Floats, Floats]:
    """Mean and factor after a displacement (n,) and process noise of that std (n,) per coordinate."""
    noise = np.diag(np.asarray(process_std, dtype=float))
    return mean + displacement, lower_factor(np.hstack([factor, noise]))


def update(mean: Floats, factor: Floats, z: Floats, observation_std: ArrayLike) -> tuple[Floats, Floats, float]:
    """Mean, factor and log likelihood after measuring z (n,), NaN where there is no measurement.

    A coordinate with infinite `observation_std` is not measured either.
    """
    std = np.asarray(observation_std, dtype=float)
    seen = np.flatnonzero(np.isfinite(z) & np.isfinite(std))
    if not seen.size:
        return mean, factor, 0.0
    return _given(mean, factor, z[seen] - mean[seen], factor[seen], std[seen])


def _given(mean: Floats, factor: Floats, innovation: Floats, rows: Floats, std: Floats) -> tuple[Floats, Floats, float]:
    """Mean, factor and log likelihood after k measurements: innovations (k,), H L (k, n), noise std (k,)."""
    k, n = rows.shape
    noise = np.diag(np.maximum(std, SMALLEST_STD))
    joint = np.block([[noise, rows], [np.zeros((n, k)), factor]])
    array = lower_factor(joint)
    root, gain_root, posterior = array[:k, :k], array[k:, :k], array[k:, k:]
    whitened = np.linalg.solve(root, innovation)
    log_likelihood = (
        -0.5 * float(whitened @ whitened) - float(np.log(np.diag(root)).sum()) - 0.5 * k * np.log(2 * np.pi)
    )
    return mean + gain_root @ whitened, posterior, float(log_likelihood)


def reset(mean: Floats, factor: Floats, u: Floats, transition: Reset) -> tuple[Floats, Floats]:
    """Mean and factor after the affine reset of a transition."""
    a, _, _ = transition.matrices(mean.size, u.size)
    return transition.apply(mean, u), factor if transition.A is None else lower_factor(a @ factor)


def condition_on_pins(mean: Floats, factor: Floats, pins: Sequence[Pin]) -> tuple[Floats, Floats]:
    """Mean and factor given that a mode holds its pins: each pin is one measurement of its coordinate.

    A pin that follows another coordinate is one of the difference of the two.
    """
    for pin in pins:
        away, row = pin.value - mean[pin.coordinate], factor[pin.coordinate]
        if pin.follows is not None:
            away, row = away + mean[pin.follows], row - factor[pin.follows]
        mean, factor, _ = _given(mean, factor, np.array([away]), row[None], np.array([pin.std]))
    return mean, factor


def replaced_at_pins(mean: Floats, factor: Floats, pins: Sequence[Pin]) -> tuple[Floats, Floats]:
    """Mean and factor once a mode holds its pins at places that its guard defines.

    Where the state was before tells nothing of where exactly it is held, so the pin replaces what was known of the
    coordinate, whereas `condition_on_pins` adds to it. A place that follows another coordinate varies with that one.
    """
    mean, factor = mean.copy(), np.hstack([factor, np.zeros((mean.size, len(pins)))])
    for column, pin in enumerate(pins, start=mean.size):
        mean[pin.coordinate], factor[pin.coordinate] = pin.value, 0.0
        if pin.follows is not None:
            mean[pin.coordinate] += mean[pin.follows]
            factor[pin.coordinate] = factor[pin.follows]
        factor[pin.coordinate, column] = pin.std
    return mean, lower_factor(factor) if pins else factor


def margin(mean: Floats, factor: Floats, u: Floats, half_space: HalfSpace) -> tuple[float, float]:
    """Mean and std of a'x + b'u - c."""
    deviation = np.sqrt(np.square(np.array(half_space.a) @ factor).sum() + SMALLEST_STD**2)
    return float(half_space.margin(mean, u)), float(deviation)


def half_space_probability(mean: Floats, factor: Floats, u: Floats, half_space: HalfSpace) -> float:
    """Probability of a'x + b'u >= c: Φ(margin / std). For a half-space on u alone it is 0 or 1."""
    value, deviation = margin(mean, factor, u, half_space)
    if not half_space.on_state:
        return float(value > 0 or (value == 0 and not half_space.strict))
    return float(ndtr(value / deviation))
