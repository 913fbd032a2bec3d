"""Stratified optimal resampling of weighted particles.

Source: Fearnhead and Liu, "On-line inference for multiple changepoint problems", JRSS B 2007, section 3.2, algorithm
SOR: heavy particles are kept as they are, light ones are resampled with stratification and share one weight, so that
every expected weight is preserved and the Kolmogorov-Smirnov distance is small.
"""

from __future__ import annotations

import numpy as np

from micah_plan.arrays import Floats, Ints
from micah_plan.errors import InputError


def resample(weights: Floats, count: int, rng: np.random.Generator) -> tuple[Ints, Floats]:
    """At most `count` of the particles, in their order.

    Args:
        weights: (m,) non-negative, not all zero.
        count: particles to keep.

    Returns:
        their indices and new weights, with E[new weight of particle i] = weights[i] / sum(weights).
    """
    total = float(weights.sum())
    if count < 1 or not np.isfinite(total) or total <= 0 or (weights < 0).any():
        raise InputError("resampling needs weights >= 0 with a positive sum, and a count >= 1")
    normalised = weights / total
    if np.count_nonzero(normalised) <= count:
        kept = np.flatnonzero(normalised)
        return kept, normalised[kept]
    threshold = _threshold(normalised, count)
    heavy = normalised >= threshold
    light = np.flatnonzero(~heavy)
    places = count - int(heavy.sum())
    chosen = light[:0]
    if places > 0:
        # Strata of width `threshold` along the cumulative weight of the light particles, one uniform offset for all.
        cumulated = np.cumsum(normalised[light]) / threshold
        marks = rng.uniform() + np.arange(places)
        picked = np.searchsorted(cumulated, marks, side="right")
        chosen = light[np.minimum(picked, len(light) - 1)]
    kept = np.sort(np.concatenate([np.flatnonzero(heavy), chosen]))
    return kept, np.where(heavy[kept], normalised[kept], threshold)


def _threshold(weights: Floats, count: int) -> float:
    """The α with sum(min(1, w / α)) = count."""
    ordered = np.sort(weights).tolist()
    below, free = 0.0, count - len(ordered)
    # If only those up to the i-th are light, α = (their sum) / (places left to them); it fits if it separates.
    for weight, above in zip(ordered, [*ordered[1:], np.inf], strict=True):
        below, free = below + weight, free + 1
        if free > 0 and weight * (1 - 1e-12) <= below / free <= above * (1 + 1e-12):
            break
    return below / free
