"""Temporal noise of a tracker from the residuals of a fit: white noise, an Ornstein-Uhlenbeck process, a joint's
misfit.

The precision of an Ornstein-Uhlenbeck process sampled at any times is tridiagonal (it is Markov), so everything here
costs O(n). Scales come from the restricted likelihood (Patterson and Thompson, 1971), which accounts for the
parameters. Their posterior over a grid is kept: uncertainty about the wander then widens the covariance of a fit.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.linalg import lapack

from micah_plan.arrays import Floats
from micah_plan.learning.joints.misfit import misfit_prior, misfits_tried, without_misfit

_TIMES = 5  # correlation times tried
_LONGEST = 0.4  # of the duration; a slower wander looks like another joint
_RATIOS = (1.0, 6.0, 36.0, 216.0, 1296.0, 7776.0)  # noise a wander adds at slow frequencies, in units of the white
_LEANING = 0.2  # power of the correlation time in its prior
_FINE = 13  # correlation times, and ratios, that likelihoods are interpolated at
_CALM = 0.65  # probability, before anything is seen, that a tracker does not wander
_FASTEST = 2.0  # rows; a wander of shorter memory is white noise
_LEAST_INNOVATION = 1e-6  # of an Ornstein-Uhlenbeck step; rows at the same time would make it 0
_GAP = 10.0  # rows; a longer pause counts as one of this length


class OrnsteinUhlenbeck:
    """An Ornstein-Uhlenbeck process of variance 1 at given times."""

    def __init__(self, time: Floats, memory: float) -> None:
        """Times (n,) [s], not decreasing; memory is the correlation time [s]."""
        kept = np.exp(-np.diff(time) / memory)
        gain = 1 / np.maximum(1 - kept**2, _LEAST_INNOVATION)
        self.memory = memory
        self.diagonal = np.concatenate([[1.0], gain])
        self.diagonal[:-1] += kept**2 * gain
        self.beside = -kept * gain
        self.log_precision = float(np.log(gain).sum())

    def covariance_times(self, columns: Floats) -> Floats:
        """K X for columns (n, m)."""
        diagonal, beside, _ = lapack.dpttrf(self.diagonal, self.beside)
        return _solved(diagonal, beside, columns)

    def smoothed(self, ratio: float, columns: Floats) -> tuple[Floats, float]:
        """(K⁻¹ + ratio I)⁻¹ X for columns (n, m), and log det (I + ratio K)."""
        diagonal, beside, _ = lapack.dpttrf(self.diagonal + ratio, self.beside)
        return _solved(diagonal, beside, columns), float(np.log(diagonal).sum()) - self.log_precision

    def whiten(self, ratio: float, columns: Floats) -> Floats:
        """(I + ratio K)⁻¹ X for columns (n, m)."""
        return columns - ratio * self.smoothed(ratio, columns)[0]


@dataclass(frozen=True, eq=False)
class NoisePosterior:
    """Posterior of the noise of contrasts, for each of the `finer` correlation times.

    Attributes:
        log_likelihood: (f,) restricted, the ratios of wander and misfit to white noise integrated out.
        white, wander: (f,) mean variances, given each correlation time.
        chance, misfit: (s, f) probabilities of the tried sizes of a misfit, and mean variances there.
    """

    log_likelihood: Floats
    white: Floats
    wander: Floats
    chance: Floats
    misfit: Floats


def memories(time: Floats) -> Floats:
    """Candidate correlation times for rows at times (n,) [s]: from two rows to the whole duration."""
    steps = np.diff(time)
    typical = float(np.median(steps[steps > 0])) if (steps > 0).any() else 1.0
    duration = float(np.minimum(steps, _GAP * typical).sum())
    return np.geomspace(_FASTEST * typical, max(_LONGEST * duration, 2 * _FASTEST * typical), _TIMES)


def noise_posterior(
    processes: list[OrnsteinUhlenbeck], modes: Floats, error: Floats, design: Floats, scale: tuple[float, float]
) -> NoisePosterior | None:
    """Posterior of the noise shared by contrasts, given their residuals.

    Args:
        processes: one per correlation time.
        modes: (n, m) of a misfit of size 1 (`misfit_modes`).
        error: (n, k) of k contrasts of equal and independent noise.
        design: (n, k, p) their derivative by the parameters that were fitted, of any rank.
        scale: smallest variance to believe in, and that of a typical misfit.

    Returns:
        the posterior; None with too few rows to separate noise from parameters.
    """
    n, k = error.shape
    columns = _independent(design.reshape(n * k, -1))
    rank = columns.shape[1]
    degrees = n * k - rank
    if degrees < 3:
        return None
    both = np.concatenate([columns, error.reshape(n * k, 1)], axis=1)
    slowness = np.array([process.memory for process in processes]) / processes[0].memory
    products, log_dets = _products(processes, slowness, np.concatenate([both.reshape(n, -1), modes], axis=1))
    sizes = misfits_tried(modes)
    contrasts = [slice(i * (rank + 1), (i + 1) * (rank + 1)) for i in range(k)]
    grams, log_misfits = without_misfit(products, contrasts, sizes)
    residual, log_information = _marginal_residuals(grams, scale[0] * degrees)
    scores = -0.5 * (degrees * np.log(residual) + log_information + k * log_dets + log_misfits)
    # The first column is the likelihood without wander, which no correlation time changes.
    score, white = (
        _on_finer_grid(scores, len(processes)),
        np.exp(_on_finer_grid(np.log(residual), len(processes))) / max(degrees - 2, 1),
    )
    fine = np.exp(np.linspace(0, np.log(slowness[-1]), _FINE))
    level = np.append(0.0, np.exp(np.linspace(np.log(_RATIOS[0]), np.log(_RATIOS[-1]), _FINE)))
    wander = white * level / (2 * _FASTEST * fine[:, None])
    misfit = white * sizes[:, None, None]
    top = score.max()
    weight = np.exp(score - top) * _prior(fine) * misfit_prior(misfit, scale[1])
    total = np.maximum(weight.sum(axis=(0, 2)), 1e-300)
    of_size = np.maximum(weight.sum(axis=2), 1e-300)
    return NoisePosterior(
        log_likelihood=top + np.log(total),
        white=(weight * white).sum(axis=(0, 2)) / total,
        wander=(weight * wander).sum(axis=(0, 2)) / total,
        chance=of_size / total,
        misfit=(weight * misfit).sum(axis=2) / of_size,
    )


def _products(processes: list[OrnsteinUhlenbeck], slowness: Floats, columns: Floats) -> tuple[Floats, Floats]:
    """(g, m, m) products of columns (n, m) whitened by each process and, last, by none; and (g,) log determinants."""
    # Side by side, so that one tridiagonal solve serves all contrasts.
    beside = np.asfortranarray(columns)
    whole = beside.T @ beside
    products, log_dets = [], []
    for process, slow in zip(processes, slowness.tolist(), strict=True):
        for level in _RATIOS:
            ratio = level / (2 * _FASTEST * slow)
            solved, log_det = process.smoothed(ratio, beside)
            products.append(whole - ratio * (beside.T @ solved))
            log_dets.append(log_det)
    return np.array([*products, whole]), np.array([*log_dets, 0.0])


def finer(tried: Floats) -> Floats:
    """The correlation times of a `NoisePosterior`, from the candidates."""
    return np.geomspace(tried[0], tried[-1], _FINE)


def _on_finer_grid(values: Floats, times: int) -> Floats:
    """(s, f, 1 + f) values on the finer grid from the candidates (s, t r + 1), of which the last has no wander."""
    over_times, over_ratios = _spline(times), _spline(len(_RATIOS))
    wandering = over_times @ values[:, :-1].reshape(len(values), times, -1) @ over_ratios.T
    calm = np.broadcast_to(values[:, -1:, None], (len(values), _FINE, 1))
    return np.concatenate([calm, wandering], axis=2)


@lru_cache(maxsize=8)
def _spline(points: int) -> Floats:
    """(f, points) matrix that interpolates values at even points, by a cubic spline."""
    return np.asarray(CubicSpline(np.linspace(0, 1, points), np.eye(points))(np.linspace(0, 1, _FINE)))


def _prior(slowness: Floats) -> Floats:
    """(f, 1 + f) prior of correlation times and ratios.

    Likelihoods underrate slow wander, since a fit absorbs it: the prior compensates, as reference priors of
    autoregressions do (Berger and Yang, 1994).
    """
    slow = slowness**_LEANING
    prior = np.outer(slow / slow.sum(), np.full(_FINE + 1, (1 - _CALM) / _FINE))
    prior[:, 0] = _CALM / _FINE
    return np.asarray(prior)


def _marginal_residuals(grams: Floats, least: float) -> tuple[Floats, Floats]:
    """(residual sums of squares (...), log determinants of information) from Gram matrices (..., r + 1, r + 1)."""
    rank = grams.shape[-1] - 1
    lower = np.linalg.cholesky(grams[..., :rank, :rank])
    pulled = np.linalg.solve(lower, grams[..., :rank, rank:])[..., 0]
    squares = np.maximum(grams[..., rank, rank] - np.sum(pulled**2, axis=-1), least)
    return squares, 2 * np.log(np.diagonal(lower, axis1=-2, axis2=-1)).sum(axis=-1)


def _independent(columns: Floats) -> Floats:
    """An orthonormal basis of the columns (m, p), without directions at the level of round-off."""
    scaled = columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    values, vectors = np.linalg.eigh(scaled.T @ scaled)
    real = values > 1e-10 * max(float(values[-1]), 1e-300)
    return np.asarray(scaled @ (vectors[:, real] / np.sqrt(values[real])))


def _solved(diagonal: Floats, beside: Floats, columns: Floats) -> Floats:
    """(n, k) solution for columns of a tridiagonal system."""
    return np.asarray(lapack.dpttrs(diagonal, beside, columns)[0])
