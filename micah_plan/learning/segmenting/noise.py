"""Noise of pose measurements: white, with fast and slow drift, and its prediction from earlier rows.

Measured pose = joint at its configuration + error e_t. Errors are white noise + a fast wander + a slow wander of the
tracker (Ornstein-Uhlenbeck each), of one scale for rotations and one for positions. A row's error given the p rows
before it is normal around a linear prediction (Levinson, Durbin), so that likelihoods are sums over rows. What is left,
the innovations, is correlated between channels (errors of rotation and position are tied by a lever arm, and a tracker
may have axes of its own) and has Student's tails.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Self

import numpy as np
from scipy.special import gammaln

from micah_plan.arrays import Floats, Ints

MEMORY = 8  # rows that a prediction looks back
_UNMEASURED = 0.05  # rad


@dataclass(frozen=True)
class MeasurementNoise:
    """Noise of one pose measurement in a few parameters.

    Attributes:
        position_std, rotation_std: total std per axis [m, rad]; rotation is a placeholder where it was not measured.
        position_white, rotation_white: std of the part that is independent from row to row [m, rad].
    """

    position_std: float
    position_white: float
    rotation_std: float
    rotation_white: float

    @property
    def rotation_length(self) -> float:
        """Ratio of position to rotation noise [m/rad]."""
        return self.position_std / self.rotation_std


@dataclass(frozen=True, eq=False)
class NoiseScales:
    """Noise of m poses or configurations, by channel (m, d) or along m joints (m,).

    Attributes:
        white, fast, slow: variances of the white noise and of two wanders.
        fast_kept, slow_kept: correlation of a wander in neighbouring rows.
    """

    white: Floats
    fast: Floats
    slow: Floats
    fast_kept: Floats
    slow_kept: Floats

    def take(self, index: slice | Sequence[int] | Ints) -> Self:
        """The entries with these indices."""
        return type(self)(**{name: value[index] for name, value in self._arrays().items()})

    def _arrays(self) -> dict[str, Floats]:
        return {field.name: getattr(self, field.name) for field in fields(self)}

    @property
    def renewed(self) -> Floats:
        """Variance of the drift's innovation per row."""
        return np.asarray(self.fast * (1 - self.fast_kept**2) + self.slow * (1 - self.slow_kept**2))


@dataclass(frozen=True, eq=False)
class NoiseModel(NoiseScales):
    """Noise of one pose measurement over d = 6 channels [rotation vector (rad), position (m)], or 3 of position.

    m noises at once: one for each of m hypotheses, or one (m = 1) for all of them.

    Attributes:
        correlation: (m, d, d) of the channels' innovations; 1 is the mean of its diagonal over the axes of a vector.
        dof: (m,) degrees of freedom of the innovations' tails.
        coefficients: (m, p + 1, p, d) predictions of an error from 0, 1, ... p errors before it, latest first.
        left: (m, p + 1, d) variances of the innovations.
    """

    correlation: Floats
    dof: Floats
    coefficients: Floats
    left: Floats

    def __len__(self) -> int:
        return len(self.dof)

    @cached_property
    def innovation(self) -> Floats:
        """(m, d, d) covariance of a row's innovation."""
        std = np.sqrt(self.left[:, -1])
        return np.asarray(std[:, :, None] * self.correlation * std[:, None])

    @property
    def information_share(self) -> Floats:
        """(m, d) information of a row about a constant, among many, over that of a single innovation's."""
        return np.asarray((1 - self.coefficients[:, -1].sum(axis=1)) ** 2)

    @cached_property
    def rotation_length(self) -> Floats:
        """(m, 1) ratio of position to rotation noise [m/rad]."""
        total = (self.white + self.fast + self.slow).reshape(len(self), -1, 3).mean(axis=2)
        rotation = np.sqrt(total[:, :1]) if total.shape[1] == 2 else _UNMEASURED
        return np.asarray(np.sqrt(total[:, -1:]) / rotation)

    def of_rows(self, rows: float) -> MeasurementNoise:
        """The noise of single rows, where the present one is of means of `rows` rows."""
        white = self.white[0] * rows
        total = white + self.fast[0] + self.slow[0]
        turns = slice(0, len(white) - 3)
        return MeasurementNoise(
            position_std=float(np.sqrt(np.mean(total[-3:]))),
            position_white=float(np.sqrt(np.mean(white[-3:]))),
            rotation_std=float(np.sqrt(np.mean(total[turns]))) if len(white) == 6 else _UNMEASURED,
            rotation_white=float(np.sqrt(np.mean(white[turns]))) if len(white) == 6 else _UNMEASURED,
        )

    def whitened(self, errors: Floats) -> Floats:
        """Errors (m, n, d) less their prediction from the p rows before, scaled to unit independent channels."""
        residual = errors.copy()
        for lag in range(1, self.left.shape[1]):
            residual[:, lag:] -= self.coefficients[:, -1, lag - 1, None] * errors[:, :-lag]
        residual /= np.sqrt(self.left[:, -1, None])
        return np.asarray(residual @ self.decorrelation.swapaxes(1, 2))

    def predicted_back(self, errors: Floats) -> Iterator[Floats]:
        """Errors (h, d, n) less their prediction from 0, 1, ... p rows before.

        By the lattice form: a row's error and that of the row before them, both predicted from the rows between.
        """
        ahead = behind = errors
        yield ahead
        for order in range(1, self.left.shape[1]):
            reflection = self.coefficients[:, order, order - 1, :, None]
            delayed = np.zeros_like(behind)
            delayed[..., 1:] = behind[..., :-1]
            ahead, behind = ahead - reflection * delayed, delayed - reflection * ahead
            yield ahead

    @cached_property
    def decorrelation(self) -> Floats:
        """(m, d, d) matrices that decorrelate scaled innovations."""
        return np.linalg.inv(np.linalg.cholesky(self.correlation))


def stacked(noises: Sequence[NoiseModel], counts: Sequence[int]) -> NoiseModel:
    """Noises (m = 1) repeated for given numbers of hypotheses."""
    arrays = [noise._arrays() for noise in noises]
    return NoiseModel(
        **{
            name: np.concatenate([np.repeat(array[name], k, axis=0) for array, k in zip(arrays, counts, strict=True)])
            for name in arrays[0]
        }
    )


def predictors(
    white: Floats, fast: Floats, slow: Floats, fast_kept: Floats, slow_kept: float, most: int
) -> tuple[Floats, Floats]:
    """Best linear predictions (Levinson, Durbin) of m models: (p + 1, p, m), and variances left (p + 1, m)."""
    lags = np.arange(most + 1)[:, None]
    covariance = fast * fast_kept**lags + slow * slow_kept**lags
    covariance[0] += white
    coefficients = np.zeros((most + 1, most, covariance.shape[1]))
    variances = np.zeros((most + 1, covariance.shape[1]))
    variances[0] = covariance[0]
    for order in range(1, most + 1):
        last = coefficients[order - 1, : order - 1]
        reflection = (covariance[order] - (last * covariance[order - 1 : 0 : -1]).sum(axis=0)) / variances[order - 1]
        coefficients[order, : order - 1] = last - reflection * last[::-1]
        coefficients[order, order - 1] = reflection
        variances[order] = variances[order - 1] * (1 - reflection**2)
    return coefficients, variances


def log_peak(size: int, dof: float | Floats) -> Floats:
    """ln of the peak of Student's density in `size` dimensions, as curved there as the normal of scale 1."""
    return np.asarray(gammaln((dof + size) / 2) - gammaln(dof / 2) - 0.5 * size * np.log((dof + size) * np.pi))
