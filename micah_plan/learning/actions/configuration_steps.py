"""Steps of a joint's configuration between measured rows, with their commands and noise.

A step is c' - c = g J⁻¹(c) R ΔA + w + v' - v, with ΔA the command given meanwhile, w a random walk and v the white
noise of a row. So the steps of a piece have a tridiagonal covariance (the innovations form of a scalar Kalman filter),
and the model is linear in the nine numbers of g R. No part makes a step more exactly than by a share of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack
from scipy.spatial.transform import Rotation

from micah_plan.arrays import VANISHING, Booleans, Floats
from micah_plan.automaton.joint import Joint
from micah_plan.automaton.kinematics import inverse
from micah_plan.learning.actions.command_path import CommandPath, leverage
from micah_plan.learning.track import PartTrack

Rows = NDArray[np.intp]

INEXACT = 0.02
"""Share of a step by which no part makes it more exactly."""
_WHITE_SPREAD = 0.4  # std of ln r about what the caller believes of the white variance r
_WALK_DECADES = np.arange(-9.0, 1.1)  # ln-grid of the random walk's variance, of the mean squared step
_REFINEMENTS = 4
_CALM = 64  # windows per run that configurations are averaged over


@dataclass(frozen=True, eq=False)
class ConfigurationSteps:
    """m steps of the configuration between measured rows.

    Attributes:
        start, end: (m,) when they begin and end, as shares of the run's duration.
        size: (m,) measured c' - c [rad or m].
        leverage: (m, 3) J⁻¹ halfway, of displacements in the base frame [rad or m per m].
        linked: (m - 1,) whether a step begins with the row that the one before it ends with.
        white: assumed white variance of one row [rad² or m²].
    """

    start: Floats
    end: Floats
    size: Floats
    leverage: Floats
    linked: Booleans
    white: float

    def __len__(self) -> int:
        return len(self.size)

    def predictors(self, command: CommandPath, delays: Floats) -> Floats:
        """(d, 9, m) regressors of the steps for the entries of g R (row by row), at delays (d,) [share of the run]."""
        ends = np.concatenate([self.start, self.end])
        path = command.at(ends - delays[:, None])
        commanded = path[:, len(self) :] - path[:, : len(self)]
        if commanded.shape[-1] == 1:  # along the joint, in the direction that it has there
            commanded = commanded * (self.leverage / np.maximum(np.sum(self.leverage**2, axis=1), VANISHING)[:, None])
        product = self.leverage.T[None, :, None, :] * commanded.transpose(0, 2, 1)[:, None, :, :]
        return product.reshape(len(delays), 9, len(self))


@dataclass(frozen=True, eq=False)
class StepNoise:
    """Covariance of the steps, factored.

    Attributes:
        walk: variance of the random walk per run [rad² or m²].
        white: variance of the white noise of a row [rad² or m²].
        log_density: of the steps it was fitted to, with the prior of `white` [nats].
    """

    walk: float
    white: float
    log_density: float
    diagonal: Floats
    below: Floats

    def solve(self, signals: Floats) -> Floats:
        """(k, m) signals multiplied by the inverse covariance."""
        # LAPACK wants columns: the transpose of rows is that without a copy.
        return np.asarray(lapack.dpttrs(self.diagonal, self.below, signals.T)[0].T)


def configuration_steps(
    joint: Joint, pieces: Sequence[tuple[int, int]], track: PartTrack, inlier: Booleans, white: float, most: int | None
) -> ConfigurationSteps:
    """Steps of the counted rows of pieces; with `most`, about that many per run, between averages of rows.

    Args:
        white: variance of one measured configuration [rad² or m²].
    """
    configuration = configurations_along(joint, pieces, track, inlier)
    time = (track.time - track.time[0]) / track.duration
    group = 1 if most is None else max(1, round(len(track) / most))
    blocks = [
        (_averaged(time[rows], group), _averaged(c, group), _averaged(calm, group)) for rows, c, calm in configuration
    ]
    start = np.concatenate([t[:-1] for t, _, _ in blocks])
    end = np.concatenate([t[1:] for t, _, _ in blocks])
    size = np.concatenate([np.diff(c) for _, c, _ in blocks])
    # Noise of the configuration that a direction is taken at would weaken what is explained.
    halfway = np.concatenate([0.5 * (calm[:-1] + calm[1:]) for _, _, calm in blocks])
    lengths = np.array([max(len(t) - 1, 0) for t, _, _ in blocks])
    linked = np.ones(max(len(size) - 1, 0), dtype=bool)
    ends = np.cumsum(lengths)[:-1]
    linked[ends[(ends > 0) & (ends < len(size))] - 1] = False
    return ConfigurationSteps(start, end, size, leverage(joint, halfway), linked, white / group)


def configurations_along(
    joint: Joint, pieces: Sequence[tuple[int, int]], track: PartTrack, inlier: Booleans
) -> list[tuple[Rows, Floats, Floats]]:
    """Per piece: counted rows, their measured configurations, and the smoothed ones.

    A row counts in its average no more than its neighbours, so the remaining noise is independent of that of a step
    from row to row.
    """
    steps_of_pieces = []
    half = max(1, round(len(track) / (2 * _CALM)))
    for first, last in pieces:
        rows = np.arange(first, last + 1)[inlier[first : last + 1]]
        rotation = None if track.quaternion is None else Rotation.from_quat(track.quaternion[rows])
        measured = inverse(joint, track.position[rows], rotation)
        if joint.turns:
            measured = np.unwrap(measured)
        steps_of_pieces.append((rows, measured, _running_mean(measured, half)))
    return steps_of_pieces


def fit_noise(steps: ConfigurationSteps, residual: Floats, extra: Floats) -> StepNoise:
    """The most probable random walk and white noise behind the residuals (m,) of the steps.

    Args:
        extra: (m,) additional known variance [rad² or m²].
    """
    scale = max(float(np.mean(residual**2 / (steps.end - steps.start))), steps.white * 1e-6, 1e-24)

    def tried(walk: float, white: float) -> StepNoise:
        return step_noise_of(steps, residual, extra, np.exp(walk) * scale, np.exp(white) * steps.white)

    best, at = max(((tried(w, 0.0), (w, 0.0)) for w in _WALK_DECADES), key=lambda pair: pair[0].log_density)
    width = np.array([0.5, 0.4])
    for _ in range(_REFINEMENTS):
        for i in range(2):
            for sign in (1.0, -1.0):
                moved = list(at)
                moved[i] += sign * width[i]
                trial = tried(moved[0], moved[1])
                if trial.log_density > best.log_density:
                    best, at = trial, (moved[0], moved[1])
                    break
        width *= 0.6
    return best


def step_noise_of(steps: ConfigurationSteps, residual: Floats, extra: Floats, walk: float, white: float) -> StepNoise:
    """Given noise (variances, see StepNoise), with the log density of the residuals (m,) of the steps."""
    diagonal = walk * (steps.end - steps.start) + extra + 2 * white * (1 + 1e-9)
    below = np.where(steps.linked, -white, 0.0)
    pivots, factor, _ = lapack.dpttrf(diagonal, below)
    solved = lapack.dpttrs(pivots, factor, residual[:, None])[0][:, 0]
    misfit = (
        float(residual @ solved)
        + float(np.sum(np.log(np.maximum(pivots, VANISHING))))
        + len(residual) * np.log(2 * np.pi)
    )
    prior = (np.log(white / steps.white) / _WHITE_SPREAD) ** 2
    return StepNoise(walk, white, -0.5 * (misfit + prior), pivots, factor)


def inexact(steps: ConfigurationSteps) -> Floats:
    """(m,) variance of imprecise motion, proportional to the step."""
    return np.asarray((INEXACT * steps.size) ** 2)


def _averaged(value: Floats, group: int) -> Floats:
    """Means of groups of rows; a last group that is not full is left out."""
    full = len(value) // group * group
    return np.asarray(value[:full].reshape(-1, group).mean(axis=1))


def _running_mean(value: Floats, half: int) -> Floats:
    """Means over as many rows before as after, `half` at most."""
    n = len(value)
    total = np.concatenate([[0.0], np.cumsum(value)])
    reach = np.minimum(np.minimum(np.arange(n), np.arange(n)[::-1]), half)
    at = np.arange(n)
    return np.asarray((total[at + reach + 1] - total[at - reach]) / (2 * reach + 1))
