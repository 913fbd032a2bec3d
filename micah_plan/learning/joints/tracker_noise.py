"""Noise of a tracker's poses, white and drifting, and its posterior given the residuals of a joint's fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from micah_plan.arrays import Floats
from micah_plan.learning.joints.error_contrasts import Contrasts
from micah_plan.learning.joints.misfit import misfit_modes
from micah_plan.learning.joints.parametrization import FRAME_NUMBERS
from micah_plan.learning.joints.tracker_wander import (
    NoisePosterior,
    OrnsteinUhlenbeck,
    finer,
    memories,
    noise_posterior,
)

_UNLIKELY = 0.05  # of the likeliest correlation time; others add little but time


@dataclass(frozen=True)
class Scales:
    """Prior scales of errors.

    Attributes:
        least: smallest stds of noise to believe in, of a rotation [rad] and a position [m].
        misfit: size of a typical misfit of a joint, of both.
    """

    least: tuple[float, float]
    misfit: tuple[float, float]


@dataclass(frozen=True, eq=False)
class NoiseVariances:
    """Variances of a tracker's noise per axis [m², rad²], with a drift of one correlation time if any."""

    position_white: float
    position_wander: float
    rotation_white: float
    rotation_wander: float
    process: OrnsteinUhlenbeck | None

    @property
    def stds(self) -> tuple[float, float]:
        """Total std of a rotation [rad] and a position [m]."""
        return (
            float(np.sqrt(self.rotation_white + self.rotation_wander)),
            float(np.sqrt(self.position_white + self.position_wander)),
        )

    def of(self, contrast: Contrasts) -> tuple[float, float]:
        """White and drift variance of contrasts."""
        turns = contrast.reach**2 if contrast.position is not None else 1.0
        white = wander = 0.0
        if contrast.position is not None:
            white, wander = self.position_white, self.position_wander
        if contrast.rotation is not None:
            white, wander = white + turns * self.rotation_white, wander + turns * self.rotation_wander
        return white, wander


@dataclass(frozen=True, eq=False)
class ErrorPosterior:
    """Posterior of pose errors, given the residuals of a fit.

    Attributes:
        noises: probabilities of correlation times, with the tracker's noise there.
        modes: (n, m) of a misfit of the joint at the rows (`misfit_modes`).
        chance: (s,) probabilities of sizes of that misfit.
        position, rotation: (s,) its variances [m², rad²].
    """

    noises: tuple[tuple[float, NoiseVariances], ...]
    modes: Floats
    chance: Floats
    position: Floats
    rotation: Floats

    @property
    def likeliest(self) -> NoiseVariances:
        """The noise at the likeliest correlation time."""
        return max(self.noises, key=lambda pair: pair[0])[1]


def white_noise(stds: tuple[float, float]) -> NoiseVariances:
    """Noise without drift, with stds of rotations [rad] and positions [m]."""
    return NoiseVariances(stds[1] ** 2, 0.0, stds[0] ** 2, 0.0, None)


def noise_of(
    contrasts: Sequence[Contrasts],
    within: Floats,
    time: Floats,
    configuration: Floats,
    stds: tuple[float, float],
    scales: Scales,
) -> ErrorPosterior | None:
    """Posterior of the noise and of the joint's misfit; None with too few rows.

    Args:
        contrasts: residuals of a fit.
        within: (11, p) the parameters that were fitted (`Chart.in_frame`).
        time, configuration: (n,) of the fitted rows [s], [rad or m].
        stds: rough ones, of a rotation [rad] and a position [m].
        scales: prior values.
    """
    tried = memories(time)
    modes = misfit_modes(configuration)
    posteriors = _posteriors(contrasts, within, wanders(time), modes, scales)
    if posteriors is None:
        return None
    score = np.sum([posterior.log_likelihood for posterior in posteriors], axis=0)
    probability = np.exp(score - score.max())
    probability[probability < _UNLIKELY] = 0.0
    probability /= probability.sum()
    position, rotation = posteriors[0], posteriors[1] if len(posteriors) > 1 else None
    noises = tuple(
        (
            float(probability[i]),
            NoiseVariances(
                float(position.white[i]),
                float(position.wander[i]),
                float(rotation.white[i]) if rotation else stds[0] ** 2,
                float(rotation.wander[i]) if rotation else 0.0,
                OrnsteinUhlenbeck(time, float(memory)),
            ),
        )
        for i, memory in enumerate(finer(tried))
        if probability[i]
    )
    chance, size = _sizes(position, probability)
    if rotation is None:
        return ErrorPosterior(noises, modes, chance, size, np.zeros_like(size))
    turning_chance, turning_size = _sizes(rotation, probability)
    # A position and a rotation miss by sizes of their own: every pair of these.
    both = np.outer(chance, turning_chance).ravel()
    sizes = np.repeat(size, len(turning_size)), np.tile(turning_size, len(size))
    return ErrorPosterior(noises, modes, both, *sizes)


def _sizes(posterior: NoisePosterior, probability: Floats) -> tuple[Floats, Floats]:
    """(s,) probabilities and variances of a misfit, over correlation times of given probabilities (f,)."""
    chance = posterior.chance @ probability
    return chance, (posterior.chance * posterior.misfit) @ probability / np.maximum(chance, 1e-300)


def wanders(time: Floats) -> list[OrnsteinUhlenbeck]:
    """Candidate drift processes for rows at times (n,) [s]."""
    return [OrnsteinUhlenbeck(time, memory) for memory in memories(time).tolist()]


def log_evidence(
    contrasts: Sequence[Contrasts],
    within: Floats,
    tried: list[OrnsteinUhlenbeck],
    configuration: Floats,
    scales: Scales,
) -> float:
    """Log evidence of the positions' residuals, with parameters (flat prior) and noise marginalised; 0 with too few
    rows.

    Args:
        contrasts, configuration, scales: as in `noise_of`.
        within: (11, r) of the r numbers that were fitted.
        tried: `wanders` at the times of the rows.
    """
    posteriors = _posteriors(contrasts, within, tried, misfit_modes(configuration), scales)
    if posteriors is None:
        return 0.0
    columns = np.concatenate([c.design.reshape(-1, FRAME_NUMBERS) @ within for c in contrasts])
    # The posteriors integrate over orthonormal parameters; directions known worse than 1 m or 1 rad have no volume.
    squares = np.linalg.eigvalsh(columns.T @ columns)
    volume = 0.5 * float(np.log(np.maximum(squares, scales.least[1] ** 2)).sum())
    return float(np.logaddexp.reduce(np.sum([posterior.log_likelihood for posterior in posteriors], axis=0))) - volume


def _posteriors(
    contrasts: Sequence[Contrasts],
    within: Floats,
    processes: list[OrnsteinUhlenbeck],
    modes: Floats,
    scales: Scales,
) -> list[NoisePosterior] | None:
    """Posteriors of the pure contrasts, positions first."""
    posteriors: list[NoisePosterior] = []
    for contrast in contrasts:
        if contrast.reach:
            continue
        sort = 1 if contrast.rotation is None else 0
        scale = scales.least[sort] ** 2, scales.misfit[sort] ** 2
        posterior = noise_posterior(processes, modes, contrast.error, contrast.design @ within, scale)
        if posterior is None:
            return None
        posteriors.append(posterior)
    return posteriors
