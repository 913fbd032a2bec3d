"""Noise of a tracker in time: white noise plus an Ornstein-Uhlenbeck wander, estimated from what a fit leaves.

The precision of an Ornstein-Uhlenbeck process sampled at any times is tridiagonal (it is Markov), so everything here
costs O(n). Scales come from the restricted likelihood (Patterson and Thompson, 1971), which pays for the parameters.
Their posterior over a grid is kept: what the data cannot tell of the wander then widens the covariance of a fit.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack

Floats = NDArray[np.float64]

_TIMES = 4  # correlation times tried
_LONGEST = 0.3  # of the duration; a slower wander looks like another joint
_RATIOS = (0.0, 1.0, 4.0, 16.0, 64.0, 256.0)  # noise that a wander adds at slow frequencies, in units of the white
_LEANING = 0.5
_CALM = 0.45  # probability, before anything is seen, that a tracker does not wander
_FASTEST = 2.0  # rows; a wander of shorter memory is white noise
_LEAST_INNOVATION = 1e-6  # of an Ornstein-Uhlenbeck step; rows at the same time would make it 0
_GAP = 10.0  # rows; a longer pause counts as one of this length


class OrnsteinUhlenbeck:
    """A wander of variance 1 at given times."""

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

    def whiten(self, ratio: float, columns: Floats) -> tuple[Floats, float]:
        """(I + ratio K)⁻¹ X for columns (n, m), and log det (I + ratio K)."""
        if ratio <= 0:
            return columns, 0.0
        diagonal, beside, _ = lapack.dpttrf(self.diagonal + ratio, self.beside)
        log_det = float(np.log(diagonal).sum()) - self.log_precision
        return columns - ratio * _solved(diagonal, beside, columns), log_det


@dataclass(frozen=True, eq=False)
class NoisePosterior:
    """What is known of one channel's noise, for each correlation time tried.

    Attributes:
        log_likelihood: (t,) restricted, the ratios of wander to white noise integrated out.
        white, wander: (t,) mean variances, given each correlation time.
    """

    log_likelihood: Floats
    white: Floats
    wander: Floats


def memories(time: Floats) -> Floats:
    """Correlation times worth trying for rows at these times (n,) [s]: from two rows to the whole duration."""
    steps = np.diff(time)
    typical = float(np.median(steps[steps > 0])) if (steps > 0).any() else 1.0
    duration = float(np.minimum(steps, _GAP * typical).sum())
    return np.geomspace(_FASTEST * typical, max(_LONGEST * duration, 2 * _FASTEST * typical), _TIMES)


def noise_posterior(
    processes: list[OrnsteinUhlenbeck], error: Floats, design: Floats, least: float
) -> NoisePosterior | None:
    """Posterior of the noise that channels share, given what a fit leaves of them.

    Args:
        processes: one per correlation time.
        error: (n, k) of k channels of equal and independent noise.
        design: (n, k, p) their derivative by the parameters that were fitted, of any rank.
        least: smallest variance to believe in.

    Returns:
        the posterior; None where the rows are too few to tell noise from parameters.
    """
    n, k = error.shape
    columns = _independent(design.reshape(n * k, -1))
    rank = columns.shape[1]
    degrees = n * k - rank
    if degrees < 3:
        return None
    # Columns of one channel stay together, so that one tridiagonal solve serves them all.
    both = np.concatenate([columns, error.reshape(n * k, 1)], axis=1).reshape(n, -1)
    flat = both.reshape(n * k, rank + 1)
    prior = _prior(np.array([process.memory for process in processes]))
    scores, variances = np.zeros_like(prior), np.zeros_like(prior)
    ratios = np.array(
        [np.array(_RATIOS) * processes[0].memory / (2 * _FASTEST * process.memory) for process in processes]
    )
    for t, process in enumerate(processes):
        for i, ratio in enumerate(ratios[t].tolist()):
            if t and not i:
                scores[t, 0], variances[t, 0] = scores[0, 0], variances[0, 0]
                continue
            solved, log_det = process.whiten(ratio, both)
            squares, log_information = _left(flat.T @ solved.reshape(n * k, rank + 1), least * degrees)
            scores[t, i] = -0.5 * (degrees * np.log(squares) + k * log_det + log_information)
            variances[t, i] = squares / max(degrees - 2, 1)
    top = scores.max()
    weight = np.exp(scores - top) * prior
    total = weight.sum(axis=1, keepdims=True)
    weight /= total
    white = (weight * variances).sum(axis=1)
    return NoisePosterior(top + np.log(total[:, 0]), white, (weight * variances * ratios).sum(axis=1))


def _prior(tried: Floats) -> Floats:
    """(t, r) what is believed of correlation times and ratios before anything is seen.

    Likelihoods underrate slow wander, for a fit absorbs it: the prior leans that way, as reference priors of
    autoregressions do (Berger and Yang, 1994).
    """
    slow = (tried / tried[0]) ** _LEANING
    prior = np.outer(slow / slow.sum(), np.full(len(_RATIOS), (1 - _CALM) / (len(_RATIOS) - 1)))
    prior[:, 0] = _CALM / len(tried)
    return prior


def _left(gram: Floats, least: float) -> tuple[float, float]:
    """Squares that a fit leaves and log det of its information, from the products of [columns, errors]."""
    rank = len(gram) - 1
    lower = np.linalg.cholesky(gram[:rank, :rank])
    pulled = np.linalg.solve(lower, gram[:rank, rank])
    return max(float(gram[rank, rank] - pulled @ pulled), least), 2 * float(np.log(np.diag(lower)).sum())


def _independent(columns: Floats) -> Floats:
    """An orthonormal basis of the columns (m, p), without directions that are nothing but round-off."""
    scaled = columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    values, vectors = np.linalg.eigh(scaled.T @ scaled)
    real = values > 1e-10 * max(float(values[-1]), 1e-300)
    return np.asarray(scaled @ (vectors[:, real] / np.sqrt(values[real])))


def _solved(diagonal: Floats, beside: Floats, columns: Floats) -> Floats:
    return np.asarray(lapack.dpttrs(diagonal, beside, columns)[0])
