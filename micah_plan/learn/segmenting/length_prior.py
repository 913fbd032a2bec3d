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


def length_priors(track: PartTrack, settings: LearnSettings) -> list[LengthPrior]:
    """Priors of the lengths of a track's segments, in its rows, the longest first: how often a part stops is unknown.

    Where it moves once there and back, a segment lasts half of the track. Where it moves there and back many times it
    may be one segment as before, or segments may last as long as they do there, or anything between: each halving is a
    hypothesis of its own. A mean that was set is the only one.
    """
    if settings.mean_length is not None:
        means = [settings.mean_length / max(track.duration, 1e-12)]
    else:
        means = [0.5 ** (1 + i) for i in range(1 + round(float(np.log2(max(settings.sweeps or 1.0, 1.0)))))]
    return [LengthPrior(max(share * len(track), 1.0), settings.length_shape) for share in means]


@dataclass(frozen=True)
class LengthPrior:
    """β(n) = G(n) - G(n - 1) for n = 1, 2, ... rows, with G the gamma distribution of a mean [rows] and a shape."""

    mean: float
    shape: float

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
