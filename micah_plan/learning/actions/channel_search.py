"""The posterior of a frame's rotation R and a gain g, where the data's log-likelihood is quadratic in g R.

Given a delay, the likelihood of the steps is exp(b'm - m'N m / 2) with m the nine entries of g R; whatever the number
of rows, rotations and gains are searched and integrated over N and b alone, for many delays at once. A rotation e of R
is exp(e) R: e is in the base frame, where rotations that no recording separates (about the direction of a prismatic
joint) lie on a straight line.

Priors: a rotation by θ has density ∝ exp(-θ²/2σ²) on the group of rotations (σ = 1.3 rad where the frame is not
known); ln g ~ N(0, 1.5²).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from micah_plan.arrays import Floats
from micah_plan.learning.joints.quaternions import rotation_matrix, rotation_quaternion, rotation_vector, times

ROTATION_STD = 1.3  # rad; frames are mostly right, but reversed ones exist
LOG_GAIN_STD = 1.5
_GRID_ROTATIONS = 600
_PARTS = 4  # that products over the grid are computed in
_DAMPING = 1e-3
_NEGLIGIBLE = 2e-3  # nats
_ENOUGH_DRAWS = 50.0  # effective ones
_FEWEST_DRAWS = 8.0  # to improve on Laplace's approximation with
_DRAWS = 255
_TURNS = np.array(  # derivative of exp(e) at 0 by each component of e
    [[[0, 0, 0], [0, 0, -1], [0, 1, 0]], [[0, 0, 1], [0, 0, 0], [-1, 0, 0]], [[0, -1, 0], [1, 0, 0], [0, 0, 0]]],
    dtype=float,
)


@dataclass(frozen=True, eq=False)
class Quadratic:
    """ln likelihood (up to a constant) b'm - m'N m / 2 of m = vec(g R) for d delays.

    Attributes:
        normal: (d, 9, 9) N.
        target: (d, 9) b.
        rotation_std: of the prior of R [rad].
    """

    normal: Floats
    target: Floats
    rotation_std: float = ROTATION_STD

    def take(self, index: NDArray[np.intp] | slice) -> Quadratic:
        return Quadratic(self.normal[index], self.target[index], self.rotation_std)

    @property
    def precision(self) -> Floats:
        """(4,) of the prior of (e, ln g)."""
        return np.array([self.rotation_std**-2] * 3 + [LOG_GAIN_STD**-2])


@dataclass(frozen=True, eq=False)
class Channels:
    """k rotations and gains.

    Attributes:
        rotation: (k, 4) unit quaternions, scalar last.
        log_gain: (k,).
        score: (k,) ln likelihood x prior densities, relative to no channel [nats].
    """

    rotation: Floats
    log_gain: Floats
    score: Floats


def scan(quadratic: Quadratic, log_prior: Floats) -> tuple[NDArray[np.intp], Floats, Floats]:
    """The best rotation of a grid over all, with its ln gain, at the delays that are best in their surroundings.

    Args:
        log_prior: (d,) of the delays.

    Returns:
        Up to 4 indices of delays (k,), the best first, with quaternions (k, 4) and ln gains (k,).
    """
    quaternions, monomials, entries, squared_angles = _rotation_grid()
    # In parts: waking a second thread of the linear algebra costs more than such a product.
    folded = _upper_triangles(quadratic.normal)
    squares = np.concatenate([folded @ part.T for part in np.array_split(monomials, _PARTS)], axis=1)
    along = np.maximum(quadratic.target @ entries.T, 0.0)
    score = 0.5 * along**2 / np.maximum(squares, 1e-300) + log_prior[:, None]
    score -= 0.5 * squared_angles / quadratic.rotation_std**2
    best = np.argmax(score, axis=1)
    every = np.arange(len(best))
    remaining = score[every, best]
    gain = along[every, best] / np.maximum(squares[every, best], 1e-300)
    minima: list[int] = []
    while len(minima) < 4 and np.isfinite(remaining).any():
        minima.append(int(np.argmax(remaining)))
        remaining[max(minima[-1] - 2, 0) : minima[-1] + 3] = -np.inf
    index = np.array(minima, dtype=np.intp)
    return index, quaternions[best[index]], np.log(np.clip(gain[index], 1e-3, 1e3))


def climb(quadratic: Quadratic, rotation: Floats, log_gain: Floats, iterations: int = 8) -> tuple[Channels, Floats]:
    """The most probable rotation and gain for each delay, from starts (d, 4), (d,), and the information (d, 4, 4).

    Gauss-Newton steps with Levenberg's damping, each delay on its own; information of (e, ln g).
    """
    damping = np.full(len(log_gain), _DAMPING)
    score, slope, information = _expanded(quadratic, rotation, log_gain)
    for _ in range(iterations):
        damped = information * (1 + damping[:, None, None] * np.eye(4))
        step: Floats = np.asarray(np.linalg.solve(damped, slope[..., None])[..., 0], dtype=np.float64)
        if float(np.max(np.sum(step * slope, axis=1))) < _NEGLIGIBLE:
            break
        step[:, 3] = np.clip(step[:, 3], -1.0, 1.0)
        step[:, :3] /= np.maximum(np.sqrt(np.sum(step[:, :3] ** 2, axis=1, keepdims=True)), 1.0)
        moved_rotation, moved_gain = times(rotation_quaternion(step[:, :3]), rotation), log_gain + step[:, 3]
        moved = _expanded(quadratic, moved_rotation, moved_gain)
        better = moved[0] > score
        rotation = np.where(better[:, None], moved_rotation, rotation)
        log_gain = np.where(better, moved_gain, log_gain)
        score = np.where(better, moved[0], score)
        slope = np.where(better[:, None], moved[1], slope)
        information = np.where(better[:, None, None], moved[2], information)
        damping = np.where(better, damping * 0.1, np.minimum(damping * 10.0, 1e6))
    return Channels(rotation, log_gain, score), information


def _expanded(quadratic: Quadratic, rotation: Floats, log_gain: Floats) -> tuple[Floats, Floats, Floats]:
    """Score (d,), gradient (d, 4) and information (d, 4, 4) with respect to (e, ln g)."""
    matrix = np.exp(log_gain)[:, None, None] * rotation_matrix(rotation)
    m = matrix.reshape(-1, 9)
    turned = np.matmul(_TURNS, matrix[:, None]).reshape(-1, 3, 9)
    jacobian = np.concatenate([turned, m[:, None]], axis=1)
    pulled = np.matmul(quadratic.normal, m[..., None])[..., 0]
    prior = np.concatenate([rotation_vector(rotation), log_gain[:, None]], axis=1)
    precision = quadratic.precision
    score = np.sum(m * (quadratic.target - 0.5 * pulled), axis=1) - 0.5 * (prior**2) @ precision
    slope = np.matmul(jacobian, (quadratic.target - pulled)[..., None])[..., 0] - prior * precision
    information = jacobian @ quadratic.normal @ jacobian.transpose(0, 2, 1) + np.diag(precision)
    return score, slope, information


def _upper_triangles(normal: Floats) -> Floats:
    """(d, 45) upper triangles of symmetric matrices (d, 9, 9), with off-diagonal entries doubled."""
    rows, columns = np.triu_indices(9)
    return np.asarray(normal[:, rows, columns] * np.where(rows == columns, 1.0, 2.0))


def _monomials(entries: Floats) -> Floats:
    """(k, 45) products of the nine entries of matrices, in the order of _folded."""
    rows, columns = np.triu_indices(9)
    return np.asarray(entries[:, rows] * entries[:, columns])


@dataclass(frozen=True, eq=False)
class Posterior:
    """Moments of the turn e (from a centre) and ln g, over rotations, gains and d delays.

    Attributes:
        log_evidence: ln of the integral of likelihood x prior over all [nats].
        delays: (d,) probabilities of the delays.
        mean: (d, 4) of (e, ln g - ln of the centre) given the delay [rad, 1].
        square: (4, 4) second moments of the same, over all delays.
        effective: effective sample size of the estimate.
    """

    log_evidence: float
    delays: Floats
    mean: Floats
    square: Floats
    effective: float


def integrate(
    quadratic: Quadratic,
    log_weight: Floats,
    rotation: Floats,
    log_gain: float,
    covariance: Floats,
    groups: int,
    likely: int,
) -> Posterior:
    """The posterior by importance sampling of rotations; gains by Laplace's method for each.

    Rotations are placed (a lattice, not random) around the most probable one with its covariance, and around the prior;
    then again with the moments found, and with more points where the posterior is far from normal.

    Args:
        log_weight: (d,) ln prior mass of each delay, with the part of the likelihood that no channel changes.
        rotation: (4,) unit quaternion of the centre; `log_gain`: its ln gain.
        covariance: (3, 3) of the turn about it [rad²].
        groups: blocks of the likelihood's entries: the same delays under each noise.
        likely: the most likely group.
    """
    center, first = np.zeros(3), covariance
    widest = min(quadratic.rotation_std, 1.0) ** 2 * np.eye(3)
    best = len(log_weight) // groups * likely
    likely_delays = slice(best, best + len(log_weight) // groups)
    for part, draws in ((likely_delays, 3 * _DRAWS), (slice(None), _DRAWS), (slice(None), 5 * _DRAWS)):
        turns, log_density = _draws(
            draws, [(center, covariance * 1.3), (np.zeros(3), first * 1.7), (np.zeros(3), widest)]
        )
        angle = np.linalg.norm(turns, axis=1)
        halves = np.sinc(0.5 * angle / np.pi) ** 2
        log_volume = np.where(angle < np.pi, np.log(np.maximum(halves, 1e-300)), -np.inf)
        drawn = times(rotation_quaternion(turns), rotation)
        log_value, gains, spread = _over_gains(quadratic.take(part), rotation_matrix(drawn).reshape(-1, 9))
        prior = -0.5 * np.sum(rotation_vector(drawn) ** 2, axis=1) / quadratic.rotation_std**2
        log_value = log_value + log_weight[part, None] + prior
        log_value += log_volume - log_density - np.log(_rotation_volume(quadratic.rotation_std))
        top = float(log_value.max())
        weight = np.exp(log_value - top)
        total = float(weight.sum())
        over_draws = weight.sum(axis=0) / total
        mean = over_draws @ turns
        spread_now = (turns - mean).T @ ((turns - mean) * over_draws[:, None])
        effective = 1.0 / float(np.sum(over_draws**2))
        if len(weight) == len(log_weight) and effective > _ENOUGH_DRAWS:
            break
        if effective > _FEWEST_DRAWS:
            center, covariance = mean, spread_now + 1e-12 * np.eye(3)
    delays = len(log_weight) // groups
    offset = gains - log_gain
    points = np.concatenate([np.broadcast_to(turns, (len(weight), *turns.shape)), offset[..., None]], axis=2)
    weighed = points * weight[..., None]
    square = np.matmul(weighed.transpose(0, 2, 1), points)
    square[:, 3, 3] += np.sum(weight * spread, axis=1)
    mass = weight.sum(axis=1).reshape(groups, delays).sum(axis=0)
    mean = weighed.sum(axis=1).reshape(groups, delays, 4).sum(axis=0) / np.maximum(mass, 1e-300)[:, None]
    log_evidence = top + float(np.log(total / len(turns)))
    return Posterior(log_evidence, mass / total, mean, square.sum(axis=0) / total, effective)


def _over_gains(quadratic: Quadratic, entries: Floats) -> tuple[Floats, Floats, Floats]:
    """(d, k) ln of the integral over gains for each rotation, and mode and variance of ln g."""
    squares = np.maximum(_upper_triangles(quadratic.normal) @ _monomials(entries).T, 0.0)
    along = quadratic.target @ entries.T
    precision = quadratic.precision[3]
    log_gain = np.clip(np.log(np.maximum(along, 1e-300) / np.maximum(squares, 1e-300)), -4.0, 4.0)
    for _ in range(4):
        gain = np.exp(log_gain)
        slope = gain * (along - gain * squares) - precision * log_gain
        curvature = np.maximum(gain * (2 * gain * squares - along), gain**2 * squares) + precision
        log_gain = log_gain + np.clip(slope / curvature, -1.0, 1.0)
    gain = np.exp(log_gain)
    curvature = np.maximum(gain * (2 * gain * squares - along), 0.0) + precision
    value = gain * along - 0.5 * gain**2 * squares - 0.5 * precision * log_gain**2
    return value - 0.5 * np.log(curvature / precision), log_gain, 1.0 / curvature


def _draws(number: int, normals: list[tuple[Floats, Floats]]) -> tuple[Floats, Floats]:
    """(k, 3) samples of an equal mixture of normal distributions, with their log density."""
    points = _normal_lattice(number)
    turns, densities = [], []
    factors = [np.linalg.cholesky(covariance) for _, covariance in normals]
    for i, ((mean, _), factor) in enumerate(zip(normals, factors, strict=True)):
        turns.append(mean + points[i :: len(normals)] @ factor.T)
    every = np.concatenate(turns)
    for (mean, _), factor in zip(normals, factors, strict=True):
        reduced = np.linalg.solve(factor, (every - mean).T)
        densities.append(-0.5 * np.sum(reduced**2, axis=0) - np.sum(np.log(np.diag(factor))))
    log_density = np.logaddexp.reduce(densities, axis=0) - np.log(len(normals)) - 1.5 * np.log(2 * np.pi)
    return every, np.asarray(log_density)


@lru_cache(maxsize=3)
def _normal_lattice(number: int) -> Floats:
    """(k, 3) normally distributed points of an additive recurrence (Roberts' generalised golden ratio)."""
    ratio = 1.2207440846057596
    uniform = (0.5 + np.arange(1, number + 1)[:, None] * ratio ** -np.arange(1.0, 4.0)) % 1.0
    return np.asarray(ndtri(uniform))


@lru_cache(maxsize=1)
def _rotation_grid() -> tuple[Floats, Floats, Floats, Floats]:
    """Evenly spread rotations (Alexa, "Super-Fibonacci spirals", CVPR 2022), the identity first.

    Returns:
        (k, 4) quaternions, (k, 45) monomials and (k, 9) entries of their matrices, (k,) squared angles [rad²].
    """
    s = np.arange(_GRID_ROTATIONS) + 0.5
    inner, outer = np.sqrt(s / _GRID_ROTATIONS), np.sqrt(1 - s / _GRID_ROTATIONS)
    alpha, beta = 2 * np.pi * s / np.sqrt(2), 2 * np.pi * s / 1.533751168755204288118041
    spiral = np.stack([inner * np.sin(alpha), inner * np.cos(alpha), outer * np.sin(beta), outer * np.cos(beta)], 1)
    quaternions = np.concatenate([[[0.0, 0.0, 0.0, 1.0]], spiral])
    entries = rotation_matrix(quaternions).reshape(-1, 9)
    return quaternions, _monomials(entries), entries, np.sum(rotation_vector(quaternions) ** 2, axis=1)


@lru_cache(maxsize=4)
def _rotation_volume(std: float) -> float:
    """∫ exp(-θ²/2σ²) over all rotations, in rad³ about the identity."""
    angle = np.linspace(0, min(np.pi, 12.0 * std), 2001)
    return float(np.trapezoid(8 * np.pi * (1 - np.cos(angle)) * np.exp(-0.5 * (angle / std) ** 2), angle))
