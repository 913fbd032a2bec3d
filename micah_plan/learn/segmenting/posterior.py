"""The posterior over segmentations: how many changepoints there are, and where (forward and backward sums).

Source: Fearnhead and Liu, JRSS B 2007; the sums run over all segmentations where the MAP recursion takes the best one.
Two neighbouring segments never have the same joint: that is one segment.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from micah_plan.learn.segmenting.evidence import EvidenceTable
from micah_plan.learn.segmenting.length_prior import LengthPrior

Floats = NDArray[np.float64]

_MOST_SEGMENTS = 8
_MORE_SEGMENTS = 3  # than there are in the most probable segmentation


@dataclass(frozen=True, eq=False)
class ChangepointPosterior:
    """Where the segments of a track begin.

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


def changepoint_posterior(
    table: EvidenceTable, cost: Floats, apart: Floats, prior: LengthPrior, kinds: int, changepoints: int
) -> ChangepointPosterior:
    """Sum over segmentations with up to a few more changepoints than the most probable one.

    Args:
        table: densities of n rows under h hypotheses.
        cost: (h,) what a segment pays for using a hypothesis [nats].
        apart: (h, h) what it costs that a segment of one hypothesis is followed by one of another; inf if it cannot.
        prior: of segment lengths.
        kinds: number of candidate kinds.
        changepoints: c, of the most probable segmentation.
    """
    n = table.log_density.shape[1]
    most = min(max(changepoints + 1 + _MORE_SEGMENTS, 2), max(_MOST_SEGMENTS, changepoints + 1), n)
    lengths = np.arange(n)[None] - np.arange(n)[:, None] + 1
    sums = table.sums - cost[:, None, None] - np.log(kinds)
    valid = np.maximum(lengths, 1)
    inner = np.where(lengths > 0, sums + prior.log_probability(valid), -np.inf)
    last = sums[:, :, -1] + prior.log_survival(valid[:, -1] - 1)
    ahead = _forward(inner, apart, most)
    behind = _backward(inner, last, apart, most)
    totals = np.array([_log_sum(ahead[m] + behind[0].T) for m in range(most)])
    log_evidence = float(_log_sum(totals))
    counts = np.exp(totals - log_evidence)
    changepoint = np.zeros(n)
    starts = np.zeros((changepoints, n))
    for m in range(1, most):
        for j in range(1, m + 1):
            share = _normalised(_log_sum(ahead[j] + behind[m - j].T, axis=1))
            changepoint += counts[m] * share
            if m == changepoints:
                starts[j - 1] = share
    return ChangepointPosterior(counts, starts, np.minimum(changepoint, 1.0), log_evidence)


def _forward(inner: Floats, apart: Floats, most: int) -> list[Floats]:
    """(n, h) each: ln probability of the rows before s in j segments and that one of hypothesis h may begin at s."""
    h, n, _ = inner.shape
    first = np.full((n, h), -np.inf)
    first[0] = 0.0
    found = [first]
    for _ in range(1, most):
        # Rows up to t explained, the last segment of hypothesis h; then what may follow it at t + 1.
        ended = np.stack([_log_sum(found[-1][:, i, None] + inner[i], axis=0) for i in range(h)], axis=1)
        follows = np.full((n, h), -np.inf)
        follows[1:] = _log_sum(ended[:-1, :, None] - apart[None], axis=1)
        found.append(follows)
    return found


def _backward(inner: Floats, last: Floats, apart: Floats, most: int) -> list[Floats]:
    """(h, n) each: ln probability of the rows from s on, in 1, 2, ... segments, the first of hypothesis h."""
    h, n, _ = inner.shape
    found = [last]
    for _ in range(1, most):
        after = np.full((h, n), -np.inf)
        after[:, :-1] = _log_sum(found[-1][None, :, 1:] - apart[:, :, None], axis=1)
        found.append(np.stack([_log_sum(inner[i] + after[i][None], axis=1) for i in range(h)]))
    return found


def _normalised(log_weights: Floats) -> Floats:
    top = log_weights.max()
    if not np.isfinite(top):
        return np.zeros(len(log_weights))
    weights = np.exp(log_weights - top)
    return np.asarray(weights / weights.sum())


def _log_sum(values: Floats, axis: int | None = None) -> Floats:
    """ln of the sum of exponentials, -inf where all are; without the general one's overhead on small arrays."""
    top = values.max(axis=axis, keepdims=True)
    top = np.where(np.isfinite(top), top, 0.0)
    with np.errstate(divide="ignore"):
        total = np.log(np.exp(values - top).sum(axis=axis))
    return np.asarray(total + (top.squeeze(axis) if axis is not None else top.ravel()[0]))
