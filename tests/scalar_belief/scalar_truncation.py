"""A Gaussian split by a half-space that it moves into: how much crosses, the moments of what crosses and what stays.

The state before a step has margin m0 to a guard and the state after it m1; both are Gaussian and correlated. Crossing
is m0 <= 0 and m1 > 0: a state that is outside and comes inside. Testing m1 > 0 alone would let mass leak at rest,
because the Gaussian fitted to a density that ends at the guard has a tail behind it. A state of that tail at m0 = y
stands for one as far in front of the guard, at -y, and crosses if the step moves it by more than y.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scalar_belief.scalar_gaussian import SMALLEST_STD, lower_factor
from scipy.special import erfcx, log_ndtr, ndtr

Floats = NDArray[np.float64]

# Beyond this many standard deviations a Gaussian counts as zero (mass 1e-19).
REACH = 9.0
_NOTHING = 1e-30
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(16)


@dataclass(frozen=True, eq=False)
class Part:
    """A share of a Gaussian as one of its own: probability, mean (N,) and any square root (N, K) of its covariance."""

    probability: float
    mean: Floats
    factor: Floats


@dataclass(frozen=True, eq=False)
class _Moments:
    """Mass, first and second moments of the two whitened coordinates over a region; not normalised."""

    mass: float
    first: Floats
    second: Floats


def split(mean: Floats, factor: Floats, before: tuple[Floats, float], after: tuple[Floats, float]) -> tuple[Part, Part]:
    """What crosses into a half-space and what stays.

    Moments are exact up to quadrature (1e-9), those of what crosses without the tail behind the guard. Only if the mean
    itself starts behind the guard, the mass there is no tail: it counts as inside, and crosses.

    Args:
        mean, factor: (N,) and (N, K) of a Gaussian; the covariance is factor @ factor.T.
        before, after: ((N,) weights, offset) of the affine margins m0 and m1; positive inside the half-space.

    Returns:
        (crossing, staying), whose probabilities sum to 1; a part without probability has the moments of the whole.
    """
    m0, m1 = float(before[0] @ mean - before[1]), float(after[0] @ mean - after[1])
    basis, s0, k, t = _whitened(before[0] @ factor, after[0] @ factor)
    if m1 < -REACH * np.hypot(k, t) - SMALLEST_STD and m0 <= SMALLEST_STD:
        return Part(0.0, mean, factor), Part(1.0, mean, factor)
    inside = m0 > SMALLEST_STD
    crossing, staying, tail = _integrate(m0 - SMALLEST_STD, s0, m1 - SMALLEST_STD, k, t, inside)
    share = min(1.0, crossing.mass + tail)
    if crossing.mass < _NOTHING:
        return Part(0.0, mean, factor), Part(1.0, mean, factor)
    return _part(share, crossing, mean, factor, basis), _part(1.0 - share, staying, mean, factor, basis)


def truncate(mean: Floats, factor: Floats, weights: Floats, offset: float) -> tuple[float, Floats, Floats]:
    """log P(m > 0), mean and factor of a Gaussian given m > 0, with m = weights @ x - offset; exact."""
    row = weights @ factor
    std = float(np.sqrt(row @ row + SMALLEST_STD**2))
    z = float(weights @ mean - offset) / std
    log_probability = float(log_ndtr(z))
    mills = float(np.sqrt(2 / np.pi) / erfcx(-z / np.sqrt(2)))
    direction = row / std
    variance = 1.0 - mills * (mills + z) if z > -100.0 else 1.0 / z**2
    shrink = 1.0 - np.sqrt(variance)
    narrowed = factor - shrink * np.outer(factor @ direction, direction)
    return log_probability, mean + factor @ direction * mills, lower_factor(narrowed)


def mixed(probabilities: ArrayLike, means: Floats, factors: list[Floats]) -> tuple[Floats, Floats]:
    """Mean (n,) and lower factor (n, n) of a mixture of Gaussians (moment matching); the weights need not sum to 1."""
    weights = np.asarray(probabilities, dtype=float)
    weights = weights / weights.sum()
    mean = weights @ means
    columns = [np.sqrt(w) * factor for w, factor in zip(weights, factors, strict=True)]
    spread = np.sqrt(weights)[:, None] * (means - mean)
    return mean, lower_factor(np.hstack([*columns, spread.T]))


def _whitened(row0: Floats, row1: Floats) -> tuple[Floats, float, float, float]:
    """Orthonormal basis (2, K) of the noise that moves the margins: about their means m0 = s0 ζ0, m1 = k ζ0 + t ζ1."""
    s0 = float(np.linalg.norm(row0))
    known = s0 < SMALLEST_STD
    first = row1 if known else row0
    length = float(np.linalg.norm(first))
    q0 = first / length if length > 0 else np.zeros_like(first)
    k = float(row1 @ q0)
    rest = row1 - k * q0
    t = float(np.linalg.norm(rest))
    independent = t > 1e-9 * (abs(k) + SMALLEST_STD)
    q1 = rest / t if independent else np.zeros_like(rest)
    return np.stack([q0, q1]), 0.0 if known else s0, k, t if independent else 0.0


def _integrate(m0: float, s0: float, m1: float, k: float, t: float, inside: bool) -> tuple[_Moments, _Moments, float]:
    """Moments of what crosses and of what stays, and the mass of the tail that crosses.

    Quadrature over ζ0, closed form over ζ1. `inside`: the mass that starts behind the guard is no tail and crosses.
    """
    breaks = [-REACH, -4.0, -1.5, 0.0, 1.5, 4.0, REACH]
    breaks += [-m0 / s0] if s0 > 0 else []
    for offset, slope in ((m1, k), (m1 - 2 * m0, k - 2 * s0)):
        if abs(slope) * REACH > SMALLEST_STD:
            breaks += [(step * t - offset) / slope for step in (-6.0, -2.0, 0.0, 2.0, 6.0)]
    edges = np.unique(np.clip(breaks, -REACH, REACH))
    half = np.diff(edges)[:, None] / 2
    zeta = ((edges[:-1, None] + edges[1:, None]) / 2 + half * _NODES).ravel()
    mass = (half * _WEIGHTS).ravel() * np.exp(-0.5 * zeta**2) / np.sqrt(2 * np.pi)
    start, end = m0 + s0 * zeta, m1 + k * zeta
    behind = start > 0
    reach = np.where(behind, np.inf if inside else end - 2 * start, end)
    limit = np.clip(-reach / t, -40.0, 40.0) if t > 0 else np.where(reach > 0, -40.0, 40.0)
    above, density = ndtr(-limit), np.exp(-0.5 * limit**2) / np.sqrt(2 * np.pi)
    counted = mass if inside else mass * ~behind
    crossing = _moments(counted, zeta, above, density, above + limit * density)
    staying = _moments(mass, zeta, 1 - above, -density, 1 - above - limit * density)
    return crossing, staying, float((mass - counted) @ above)


def _moments(mass: Floats, zeta: Floats, zeroth: Floats, first: Floats, second: Floats) -> _Moments:
    cross = float(mass @ (zeta * first))
    return _Moments(
        float(mass @ zeroth),
        np.array([mass @ (zeta * zeroth), mass @ first]),
        np.array([[mass @ (zeta**2 * zeroth), cross], [cross, mass @ second]]),
    )


def _part(share: float, moments: _Moments, mean: Floats, factor: Floats, basis: Floats) -> Part:
    if share <= 0.0 or moments.mass < _NOTHING:
        return Part(0.0, mean, factor)
    center = moments.first / moments.mass
    values, vectors = np.linalg.eigh(moments.second / moments.mass - np.outer(center, center))
    inner = factor @ basis.T
    changed = inner @ (vectors * np.sqrt(np.maximum(values, 0.0)))
    return Part(share, mean + inner @ center, np.hstack([changed, factor - inner @ basis]))
