"""Many Gaussians split by half-spaces at once. Twin of `belief.truncation`, where the mathematics is explained."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import erfcx, log_ndtr, ndtr

from micah_plan.belief.batch.corners import Moments, corner, half_plane, whole_plane
from micah_plan.belief.batch.gaussian import lower_factors
from micah_plan.belief.filter import NEGLIGIBLE
from micah_plan.belief.gaussian import SMALLEST_STD
from micah_plan.belief.truncation import REACH

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Booleans = NDArray[np.bool_]
Affine = tuple[Floats, Floats]
"""(p, N) weights and (p,) offsets of margins."""

_NOTHING = 1e-30
# What is this many standard deviations short of a half-space does not reach it (mass 2e-11, less than filters keep).
_NEAR = 6.6
# Closed forms are exact to 1e-15 absolutely: for shares above this one they are as good as quadrature, and for those
# that are passed over. Where the two margins move nearly as one, their corner has its point far out.
_SURE = 1e-9
_PASSED_OVER = 1e-11
_SINE = 1e-3
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(10)


@dataclass(frozen=True, eq=False)
class Parts:
    """A share of each Gaussian: probabilities (p,), means (p, N) and square roots (p, N, K) of the covariances."""

    probability: Floats
    mean: Floats
    factor: Floats


def split(mean: Floats, factor: Floats, before: Affine, after: Affine) -> tuple[Parts, Parts]:
    """What crosses into each half-space and what stays; factors may get two more columns.

    Args:
        mean, factor: (p, N) and (p, N, K).
        before, after: the margins m0 and m1; positive inside the half-space.
    """
    m0, m1 = _dot(before[0], mean) - before[1], _dot(after[0], mean) - after[1]
    basis, s0, k, t = _whitened(_rows(before[0], factor), _rows(after[0], factor))
    near = ~((m1 < -_NEAR * np.hypot(k, t) - SMALLEST_STD) & (m0 <= SMALLEST_STD))
    if not near.any():
        return Parts(np.zeros(len(mean)), mean, factor), Parts(np.ones(len(mean)), mean, factor)
    padded = np.concatenate([np.zeros((*mean.shape, 2)), factor], axis=2)
    crossing = Parts(np.zeros(len(mean)), mean.copy(), padded)
    staying = Parts(np.ones(len(mean)), mean.copy(), padded.copy())
    margins = (m0[near] - SMALLEST_STD, s0[near], m1[near] - SMALLEST_STD, k[near], t[near])
    inside = m0[near] > SMALLEST_STD
    crossed, stayed, tail = _shares(*margins, inside)
    # Without any mass to fit moments to, nothing crosses.
    some = crossed.mass >= _NOTHING
    share = np.where(some, np.minimum(1.0, crossed.mass + tail), 0.0)
    chosen = np.flatnonzero(near)
    _fill(crossing, chosen, share, crossed, some, basis[near])
    _fill(staying, chosen, 1.0 - share, stayed, some, basis[near])
    return crossing, staying


def log_inside(mean: Floats, factor: Floats, weights: Floats, offset: float) -> Floats:
    """log P(m > 0) (p,), with m = weights @ x - offset; weights (n,)."""
    return np.asarray(log_ndtr(_in_stds(mean, factor, weights, offset)[0]))


def truncate(mean: Floats, factor: Floats, weights: Floats, offset: float) -> tuple[Floats, Floats]:
    """Means and factors given m > 0, with m = weights @ x - offset; weights (n,)."""
    z, std, row = _in_stds(mean, factor, weights, offset)
    mills = np.sqrt(2 / np.pi) / erfcx(-z / np.sqrt(2))
    direction = row / std[:, None]
    with np.errstate(divide="ignore"):
        variance = np.where(z > -100.0, 1.0 - mills * (mills + z), 1.0 / z**2)
    shrink = 1.0 - np.sqrt(variance)
    along = (factor @ direction[:, :, None])[:, :, 0]
    narrowed = factor - (shrink[:, None] * along)[:, :, None] * direction[:, None, :]
    return mean + along * mills[:, None], lower_factors(narrowed)


def _in_stds(mean: Floats, factor: Floats, weights: Floats, offset: float) -> tuple[Floats, Floats, Floats]:
    """Margins in stds (p,), the stds (p,), and the margins' rows (p, K) of the factors."""
    row = np.zeros((len(factor), factor.shape[2]))
    for i in np.flatnonzero(weights):
        row += weights[i] * factor[:, i]
    std = np.sqrt(np.einsum("pk,pk->p", row, row) + SMALLEST_STD**2)
    return (mean @ weights - offset) / std, std, row


def _dot(a: Floats, b: Floats) -> Floats:
    return np.asarray(np.einsum("pi,pi->p", a, b))


def _rows(weights: Floats, factor: Floats) -> Floats:
    return np.asarray((weights[:, None, :] @ factor)[:, 0])


def _whitened(row0: Floats, row1: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    """Orthonormal bases (p, 2, K): about their means m0 = s0 ζ0, m1 = k ζ0 + t ζ1."""
    s0 = np.linalg.norm(row0, axis=1)
    known = s0 < SMALLEST_STD
    first = np.where(known[:, None], row1, row0)
    q0 = _normalised(first, np.linalg.norm(first, axis=1))
    k = _dot(row1, q0)
    rest = row1 - k[:, None] * q0
    t = np.linalg.norm(rest, axis=1)
    t = np.where(t > 1e-9 * (np.abs(k) + SMALLEST_STD), t, 0.0)
    q1 = _normalised(rest, t)
    return np.stack([q0, q1], axis=1), np.where(known, 0.0, s0), k, t


def _normalised(rows: Floats, lengths: Floats) -> Floats:
    return np.where(lengths[:, None] > 0, rows / np.where(lengths > 0, lengths, 1.0)[:, None], 0.0)


def _shares(
    m0: Floats, s0: Floats, m1: Floats, k: Floats, t: Floats, inside: Booleans
) -> tuple[Moments, Moments, Floats]:
    """Moments of what crosses and of what stays, and the mass of the tail that crosses (p,): closed forms, if any."""
    crossing, staying, tail = Moments.empty(len(k)), Moments.empty(len(k)), np.zeros(len(k))
    left = np.ones(len(k), dtype=bool)
    known = ~inside & (s0 == 0) & (k > 0)
    if known.any():
        offset, ones = -m1[known] / k[known], np.ones(int(known.sum()))
        crossing.put(known, half_plane(ones, offset))
        staying.put(known, half_plane(-ones, -offset))
        left &= ~known
    sines = np.minimum(t / (np.hypot(k, t) + SMALLEST_STD), t / (np.hypot(k - 2 * s0, t) + SMALLEST_STD))
    moved = ~inside & (s0 > 0) & (sines > _SINE)
    if moved.any():
        crossed, stayed, behind = _corners(m0[moved], s0[moved], m1[moved], k[moved], t[moved])
        sure = (crossed.mass > _SURE) | (crossed.mass + behind < _PASSED_OVER)
        sure &= (stayed.mass > _SURE) | (stayed.mass < _PASSED_OVER)
        moved[moved] = sure
        crossing.put(moved, crossed.where(sure))
        staying.put(moved, stayed.where(sure))
        tail[moved] = behind[sure]
        left &= ~moved
    if left.any():
        crossed, stayed, tail[left] = _integrate(m0[left], s0[left], m1[left], k[left], t[left], inside[left])
        crossing.put(left, crossed)
        staying.put(left, stayed)
    return crossing, staying, tail


def _corners(m0: Floats, s0: Floats, m1: Floats, k: Floats, t: Floats) -> tuple[Moments, Moments, Floats]:
    """As `_shares`, for margins that both move: what crosses fills a corner of the plane, the tail that does another.

    The first is m0 < 0 and m1 > 0, the second m0 > 0 and m1 > 2 m0.
    """
    ones = np.ones(len(k))
    parts = []
    for sign, end, slope in ((-1.0, m1, k), (1.0, m1 - 2 * m0, k - 2 * s0)):
        size = np.hypot(slope, t)
        normal = np.stack([slope, t], axis=1) / size[:, None]
        parts.append(corner(sign * ones, -sign * m0 / s0, normal, -end / size))
    crossing, behind = parts
    return crossing, whole_plane(len(k)).without(crossing, behind), behind.mass


def _breaks(m0: Floats, s0: Floats, m1: Floats, k: Floats, t: Floats) -> Floats:
    """(p, 18) sorted ends of the intervals of quadrature; those that are not needed are empty."""
    fixed = np.array([-REACH, -4.0, -1.5, 0.0, 1.5, 4.0, REACH])
    columns = [np.broadcast_to(fixed, (len(k), fixed.size))]
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        columns.append(np.where(s0 > 0, -m0 / s0, REACH)[:, None])
        for offset, slope in ((m1, k), (m1 - 2 * m0, k - 2 * s0)):
            ends = (np.array([-6.0, -2.0, 0.0, 2.0, 6.0]) * t[:, None] - offset[:, None]) / slope[:, None]
            columns.append(np.where(np.abs(slope)[:, None] * REACH > SMALLEST_STD, ends, REACH))
    return np.sort(np.clip(np.concatenate(columns, axis=1), -REACH, REACH), axis=1)


def _integrate(
    m0: Floats, s0: Floats, m1: Floats, k: Floats, t: Floats, inside: Booleans
) -> tuple[Moments, Moments, Floats]:
    """Moments of what crosses and of what stays, and the mass of the tail that crosses (p,)."""
    edges = _breaks(m0, s0, m1, k, t)
    # Only intervals that are not empty: (i, nodes) of them, each with the number of its Gaussian.
    owner, number = np.nonzero(np.diff(edges, axis=1) > 0.0)
    left, right = edges[owner, number][:, None], edges[owner, number + 1][:, None]
    half = (right - left) / 2
    zeta = (left + right) / 2 + half * _NODES
    mass = half * _WEIGHTS * np.exp(-0.5 * zeta**2) / np.sqrt(2 * np.pi)
    m0, s0, m1, k, t = (value[owner, None] for value in (m0, s0, m1, k, t))
    start, reach = m0 + s0 * zeta, m1 + k * zeta
    behind, known = start > 0, inside[owner, None]
    reach = np.where(behind, np.where(known, np.inf, reach - 2 * start), reach)
    with np.errstate(divide="ignore", invalid="ignore"):
        spread = np.clip(-reach / t, -40.0, 40.0)
    limit = np.where(t > 0, spread, np.where(reach > 0, -40.0, 40.0))
    above, density = ndtr(-limit), np.exp(-0.5 * limit**2) / np.sqrt(2 * np.pi)
    counted = np.where(known | ~behind, mass, 0.0)
    first = np.searchsorted(owner, np.arange(len(inside)))
    crossing = _moments(first, counted, zeta, above, density, limit)
    staying = _moments(first, mass, zeta, 1 - above, -density, limit)
    tail = np.add.reduceat(((mass - counted) * above).sum(axis=1), first)
    return crossing, staying, np.asarray(tail)


def _moments(
    first: NDArray[np.intp], mass: Floats, zeta: Floats, zeroth: Floats, density: Floats, limit: Floats
) -> Moments:
    """Sums over the intervals of each Gaussian, which begin at `first`."""

    def total(values: Floats, weights: Floats) -> Floats:
        return np.asarray(np.add.reduceat(np.einsum("ik,ik->i", values, weights), first))

    once = mass * zeta
    cross = total(once, density)
    second = zeroth + limit * density
    along = np.stack([total(once * zeta, zeroth), cross], axis=1)
    across = np.stack([cross, total(mass, second)], axis=1)
    return Moments(
        total(mass, zeroth),
        np.stack([total(once, zeroth), total(mass, density)], axis=1),
        np.stack([along, across], axis=1),
    )


def _fill(
    parts: Parts, chosen: NDArray[np.int64], share: Floats, moments: Moments, some: Booleans, basis: Floats
) -> None:
    """Write shares and moments of the chosen Gaussians; one that filters pass over keeps the moments of the whole."""
    parts.probability[chosen] = share
    has = some & (share >= NEGLIGIBLE) & (moments.mass >= _NOTHING)
    parts.probability[chosen[some & ~has]] = 0.0
    rows = chosen[has]
    if not rows.size:
        return
    mass, inner_basis = moments.mass[has], basis[has]
    center = moments.first[has] / mass[:, None]
    second = moments.second[has] / mass[:, None, None] - center[:, :, None] * center[:, None, :]
    factor = parts.factor[rows, :, 2:]
    inner = factor @ inner_basis.transpose(0, 2, 1)
    parts.mean[rows] += (inner @ center[:, :, None])[:, :, 0]
    parts.factor[rows, :, :2] = inner @ _root(second)
    parts.factor[rows, :, 2:] = factor - inner @ inner_basis


def _root(second: Floats) -> Floats:
    """(p, 2, 2) lower square roots of covariances, which rounding may leave a hair short of positive."""
    root = np.zeros_like(second)
    root[:, 0, 0] = np.sqrt(np.maximum(second[:, 0, 0], 0.0))
    has = root[:, 0, 0] > 0
    root[has, 1, 0] = second[has, 1, 0] / root[has, 0, 0]
    root[:, 1, 1] = np.sqrt(np.maximum(second[:, 1, 1] - root[:, 1, 0] ** 2, 0.0))
    return root
