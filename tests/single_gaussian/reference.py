"""One Gaussian at a time: prediction, reset, half-spaces, on lower Cholesky factors by QR."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg.lapack import dgeqrf
from scipy.special import ndtr

from micah_plan.automaton.hybrid import Reset
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


def reset(mean: Floats, factor: Floats, u: Floats, transition: Reset) -> tuple[Floats, Floats]:
    """Mean and factor after the affine reset of a transition."""
    a, _, _ = transition.matrices(mean.size, u.size)
    return transition.apply(mean, u), factor if transition.A is None else lower_factor(a @ factor)


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
