"""Posterior over segmentations by forward-backward sums: number and places of changepoints.

Source: Fearnhead and Liu, JRSS B 2007; the sums run over all segmentations where the MAP recursion takes the best one.
Two neighbouring segments never have the same joint: that is one segment.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from micah_plan.arrays import Floats
from micah_plan.changepoints import LengthPrior, reached

_MOST_SEGMENTS = 8  # that are summed over
_MORE_SEGMENTS = 3  # than there are in the most probable segmentation


@dataclass(frozen=True, eq=False)
class ChangepointPosterior:
    """Posterior of the starts of a track's segments.

    Attributes:
        counts: (m,) probability of 0, 1, ... m - 1 changepoints.
        starts: (c, n) posterior of the row at which each segment but the first begins, given that there are c.
        changepoint: (n,) probability that a segment begins at a row, over all counts.
        log_evidence: ln probability of the rows, all segmentations summed [nats].
    """

    counts: Floats
    starts: Floats
    changepoint: Floats
    log_evidence: float


def without_changepoints(posterior: ChangepointPosterior, probability: float) -> ChangepointPosterior:
    """The posterior mixed with the hypothesis of no changepoint."""
    counts = (1 - probability) * posterior.counts
    counts[0] += probability
    return replace(posterior, counts=counts, changepoint=(1 - probability) * posterior.changepoint)


def with_another_changepoint(posterior: ChangepointPosterior, probability: float) -> ChangepointPosterior:
    """The posterior mixed with the hypothesis of one more changepoint at any row."""
    counts = (1 - probability) * np.append(posterior.counts, 0.0) + probability * np.append(0.0, posterior.counts)
    changepoint = posterior.changepoint.copy()
    changepoint[1:] += probability / max(len(changepoint) - 1, 1)
    return replace(posterior, counts=counts, changepoint=changepoint)


def changepoint_posterior(worth: Floats, apart: Floats, prior: LengthPrior, changepoints: int) -> ChangepointPosterior:
    """Posterior summed over segmentations with up to a few changepoints more than the best.

    Args:
        worth: (h, n, n) evidence of every segment (first, last row) under h hypotheses, minus its cost [nats].
        apart: (h, h) cost of a segment of one hypothesis followed by one of another; inf if it is impossible.
        prior: of segment lengths.
        changepoints: c, of the most probable segmentation.
    """
    n = worth.shape[1]
    most = min(max(changepoints + 1 + _MORE_SEGMENTS, 2), max(_MOST_SEGMENTS, changepoints + 1), n)
    every = np.arange(1, n + 1)
    lengths = np.arange(n)[None] - np.arange(n)[:, None]
    of_length = np.where(lengths >= 0, prior.log_probability(every)[np.maximum(lengths, 0)], -np.inf)
    inner = worth + of_length
    last = worth[:, :, -1] + prior.log_survival(every - 1)[::-1]
    best_before = reached(inner.max(axis=0))
    # Everything is counted relative to the best segments before a row: sums are products of matrices then, and what is
    # too small for a number is too small to matter.
    best = float((last + best_before[:-1]).max())
    chances = np.exp(inner + (best_before[:-1, None] - best_before[1:]))
    follows = np.exp(-apart)
    ahead = _forward(chances, follows, most)
    behind = _backward(chances, np.exp(last + best_before[:-1] - best), follows, most)
    totals = np.array([np.sum(row * behind[0]) for row in ahead])
    counts = totals / totals.sum()
    changepoint = np.zeros(n)
    starts = np.zeros((changepoints, n))
    for m in range(1, most):
        for j in range(1, m + 1):
            share = _normalised((ahead[j] * behind[m - j]).sum(axis=0))
            changepoint += counts[m] * share
            if m == changepoints:
                starts[j - 1] = share
    log_evidence = best + float(np.log(totals.sum()))
    return ChangepointPosterior(counts, starts, np.minimum(changepoint, 1.0), log_evidence)


def _forward(chances: Floats, follows: Floats, most: int) -> list[Floats]:
    """(h, n) each: probability of the rows before s in j segments and that one of hypothesis h may begin at s."""
    h, n, _ = chances.shape
    first = np.zeros((h, n))
    first[:, 0] = 1.0
    forward = [first]
    for _ in range(1, most):
        # Rows up to t explained, the last segment of hypothesis h; then what may follow it at t + 1.
        ended = (forward[-1][:, None] @ chances)[:, 0]
        begun = np.zeros((h, n))
        begun[:, 1:] = follows.T @ ended[:, :-1]
        forward.append(begun)
    return forward


def _backward(chances: Floats, last: Floats, follows: Floats, most: int) -> list[Floats]:
    """(h, n) each: probability of the rows from s on, in 1, 2, ... segments, the first of hypothesis h."""
    backward = [last]
    for _ in range(1, most):
        after = np.zeros_like(last)
        after[:, :-1] = follows @ backward[-1][:, 1:]
        backward.append((chances @ after[:, :, None])[..., 0])
    return backward


def _normalised(weights: Floats) -> Floats:
    """Weights with sum 1; zeros if all are 0."""
    total = weights.sum()
    return np.asarray(weights / total) if total > 0 else np.zeros(len(weights))
