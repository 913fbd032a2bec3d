"""The most probable changepoints: the MAP recursion of CHAMP, exact, over the evidence of all segments at once.

Sources: MICAH, equation for P_t and P_t^MAP; Fearnhead and Liu, JRSS B 2007. In logarithms, with segments s..t-1:
P_t(s, M) = survival(t - s - 1) L(s, t, M) p(M) P_s^MAP and
P_t^MAP = max_{s, M} β(t - s) / survival(t - s - 1) P_t(s, M).
Which model is best for a segment does not depend on the others, so it is chosen for all of them before the recursion
begins.

The length prior: β of a segment and its cumulative B: a discretised gamma distribution over rows, normalised.

Source: MICAH, equation for p(τ_{i+1} = t | τ_i = j) = β(t - j); the open last segment uses the survival 1 - B.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import gammainc, gammaincc

from micah_plan.arrays import VANISHING, Floats
from micah_plan.errors import InputError


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
        return np.asarray(np.log(np.maximum(np.where(lower > 0.5, from_start, lower - upper), VANISHING)))

    def log_survival(self, length: ArrayLike) -> Floats:
        """ln (1 - B(n)): probability that a segment has more than n rows (n >= 0)."""
        n = np.asarray(length, dtype=float)
        return np.asarray(np.log(np.maximum(gammaincc(self.shape, n * self.shape / self.mean), VANISHING)))


def most_probable_spans(worth: Floats) -> tuple[list[tuple[int, int]], float]:
    """(spans of the most probable segments, their log probability [nats]).

    Args:
        worth: (n, n) ln probability of a segment (first, last row) with its length; -inf where the last row is before
            the first.
    """
    before = reached(worth)
    first = (worth + before[:-1, None]).argmax(axis=0)
    spans: list[tuple[int, int]] = []
    end = len(worth)
    while end > 0:
        start = int(first[end - 1])
        spans.append((start, end - 1))
        end = start
    return spans[::-1], float(before[-1])


def reached(worth: Floats) -> Floats:
    """(n + 1,) log probability of the rows before each under their best segments (n, n)."""
    columns = np.ascontiguousarray(worth.T)
    best = np.zeros(len(columns) + 1)
    for row, column in enumerate(columns):
        best[row + 1] = (best[: row + 1] + column[: row + 1]).max()
    return best


@lru_cache(maxsize=4)
def length_terms(prior: LengthPrior, n: int) -> Floats:
    """(n, n) ln prior of the length of a segment (first, last row); the last row leaves it open."""
    every = np.arange(1, n + 1)
    log_length, log_survival = prior.log_probability(every), prior.log_survival(every - 1)
    lengths = np.maximum(np.arange(n)[None] - np.arange(n)[:, None], 0)
    terms = log_length[lengths]
    terms[:, -1] = log_survival[lengths[:, -1]]
    terms[np.tril_indices(n, -1)] = -np.inf
    return np.asarray(terms)
