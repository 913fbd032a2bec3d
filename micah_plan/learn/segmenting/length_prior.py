"""The length prior β of a segment and its cumulative B: a discretised gamma distribution over rows, normalised.

Source: MICAH, equation for p(τ_{i+1} = t | τ_i = j) = β(t - j); the open last segment uses the survival 1 - B.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import gammainc, gammaincc

from micah_plan.arrays import Floats
from micah_plan.errors import InputError
from micah_plan.learn.settings import LearnSettings
from micah_plan.learn.track import PartTrack

_SMALLEST = 1e-300


@dataclass(frozen=True)
class LengthPrior:
    """β(n) = G(n) - G(n - 1) for n = 1, 2, ... rows, with G the gamma distribution of a mean [rows] and a shape."""

    mean: float
    shape: float

    @classmethod
    def of_rows(cls, track: PartTrack, settings: LearnSettings) -> LengthPrior:
        """The prior of segments of a track, in its rows."""
        share = 0.5 if settings.mean_length is None else settings.mean_length / max(track.duration, 1e-12)
        return cls(max(share * len(track), 1.0), settings.length_shape)

    def __post_init__(self) -> None:
        if not (self.mean > 0 and self.shape > 0):
            raise InputError(f"a length prior needs a positive mean and shape. Got {self}")

    def log_probability(self, length: ArrayLike) -> Floats:
        """ln β(n): probability that a segment has exactly n rows (n >= 1)."""
        n = np.asarray(length, dtype=float)
        rate = self.shape / self.mean
        lower, upper = gammaincc(self.shape, (n - 1) * rate), gammaincc(self.shape, n * rate)
        from_start = gammainc(self.shape, n * rate) - gammainc(self.shape, (n - 1) * rate)
        # Differences of the small tail keep their digits: below the median the cdf is small, above it the survival.
        return np.asarray(np.log(np.maximum(np.where(lower > 0.5, from_start, lower - upper), _SMALLEST)))

    def log_survival(self, length: ArrayLike) -> Floats:
        """ln (1 - B(n)): probability that a segment has more than n rows (n >= 0)."""
        n = np.asarray(length, dtype=float)
        return np.asarray(np.log(np.maximum(gammaincc(self.shape, n * self.shape / self.mean), _SMALLEST)))
