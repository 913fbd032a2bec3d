"""Recovery of lost beliefs: after a contradicting measurement the state is at the measurement, in any mode.

One more hypothesis is added to the automaton's modes, as improbable as what filters drop: an unmodelled event made the
previous belief useless. Then the state lies anywhere that the modes allow, and only the measurement is known of it.

Source: Thrun, Burgard and Fox, Probabilistic Robotics, 2005, section 8.3.5 (recovering from failures by augmentation).
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.special import log_ndtr, logsumexp

from micah_plan.arrays import SMALLEST_STD, Floats
from micah_plan.automaton.contacts.values import COLLIDED
from micah_plan.automaton.hybrid import Mode
from micah_plan.belief.gaussian import (
    lower_factors,
)
from micah_plan.belief.hybrid_belief import BeliefBatch
from micah_plan.belief.layout import Layout
from micah_plan.belief.truncation import (
    NEGLIGIBLE,
)

# A coordinate without limits is within one metre or radian.
_WIDTH = 1.0


def most_evidence(layout: Layout, z: Floats) -> Floats:
    """(t,) upper bound of the log evidence of reinitialised beliefs for measurements z (own, t).

    Evidence of a belief above it needs no comparison: that is nearly always so, and cheap to know.
    """
    sharpest = np.maximum(np.min([sensing.std for sensing in layout.sensing], axis=0)[: len(z)], SMALLEST_STD)
    densest = np.maximum(-np.log(np.sqrt(2 * np.pi) * sharpest), -np.log(_widths(layout)[: len(z)]))
    return np.asarray(np.where(np.isfinite(z), densest[:, None], 0.0).sum(axis=0) + np.log(NEGLIGIBLE))


def reinitialise(layout: Layout, belief: BeliefBatch, z: Floats) -> tuple[BeliefBatch, float]:
    """(a belief that keeps only what z (own,) does not measure, its log evidence).

    In every mode that allows it the state is at the measurement, and at the mode's pins and ties. Modes of collision
    are excluded: they follow from a path, not from a place.
    """
    n, q, widths = layout.n, len(layout.modes), _widths(layout)
    modes = [index for index, mode in enumerate(layout.modes) if mode.mode.name != COLLIDED]
    before, spread = _marginals(belief)
    measured = np.full(n, np.nan)
    measured[: layout.own] = z
    scores, means, factors = np.full(q, -np.inf), np.tile(before[:, None, None], (1, q, 1)), np.zeros((n, n, q, 1))
    for index in modes:
        std = layout.sensing[index].std_at(np.where(np.isfinite(measured), measured, before))
        is_measured = np.isfinite(measured) & np.isfinite(std)
        mean, within = (
            np.where(is_measured, measured, before),
            np.where(is_measured, np.maximum(std, SMALLEST_STD), spread),
        )
        density = np.where(is_measured, -np.log(widths), 0.0)
        mean, covariance, score = _conditioned_on_mode(layout.modes[index].mode, mean, np.diag(within**2), density)
        scores[index] = score + _log_probability_in_mode(layout, index, mean, covariance) - np.log(len(modes))
        means[:, index, 0] = mean
        values, vectors = np.linalg.eigh(covariance)
        factors[:, :, index] = lower_factors((vectors * np.sqrt(np.maximum(values, 0.0)))[:, :, None])
    evidence = float(logsumexp(scores))
    weights = np.exp(scores - evidence)[:, None]
    return BeliefBatch.of(weights, means, factors, layout.own), evidence + float(np.log(NEGLIGIBLE))


def _conditioned_on_mode(mode: Mode, mean: Floats, covariance: Floats, density: Floats) -> tuple[Floats, Floats, float]:
    """Mean (n,) and covariance (n, n) conditioned on a mode's pins and ties, and the measurement's log density.

    Args:
        density: (n,) log density of each measured coordinate where the mode does not determine its place.
    """
    score = float(density.sum())
    for coordinate, row, value, std in _pin_and_tie_rows(mode, mean.size):
        across = covariance @ row
        variance, away = float(row @ across) + std**2, value - float(row @ mean)
        mean, covariance = mean + across * (away / variance), covariance - np.outer(across, across) / variance
        score -= float(density[coordinate]) + 0.5 * (away**2 / variance + np.log(2 * np.pi * variance))
    return mean, covariance, score


def _marginals(belief: BeliefBatch) -> tuple[Floats, Floats]:
    """(n,) mean and stds of a single belief over states and boundaries."""
    weights, means, factors = belief.weights[0], belief.joint_means[0], belief.joint_factors[0]
    positive = weights > 0
    weights, means = weights[positive], means[positive]
    mean = weights @ means
    return mean, np.sqrt(weights @ (np.square(factors[positive]).sum(axis=2) + np.square(means - mean)))


def _pin_and_tie_rows(mode: Mode, n: int) -> Iterator[tuple[int, Floats, float, float]]:
    """(coordinate, row (n,), value, std) of a mode's pins and ties, as row'x = value ± std."""
    unit = np.eye(n)
    for pin in mode.pins:
        yield (
            pin.coordinate,
            unit[pin.coordinate] - (0.0 if pin.follows is None else unit[pin.follows]),
            pin.value,
            pin.std,
        )
    for tie in mode.ties:
        yield tie.coordinate, unit[tie.coordinate] - np.array(tie.weights), tie.offset, SMALLEST_STD


def _log_probability_in_mode(layout: Layout, index: int, x: Floats, covariance: Floats) -> float:
    """Log probability that a state lies in a mode's invariant, outside its ending guards."""
    invariant = [h for h in layout.modes[index].mode.invariant.half_spaces if h.on_state and not h.on_input]
    rows = np.array([*(h.a for h in invariant), *layout.outside[0][:, :, index]]).reshape(-1, layout.n)
    offsets = np.array([*(h.c for h in invariant), *layout.outside[1][:, index]])
    stds = np.sqrt(np.maximum(np.einsum("ri,ij,rj->r", rows, covariance, rows), 0.0) + SMALLEST_STD**2)
    return float(log_ndtr((rows @ x - offsets) / stds).sum())


def _widths(layout: Layout) -> Floats:
    """(n,) width of each coordinate's range over the modes."""
    modes = [mode.mode for mode in layout.modes if mode.mode.name != COLLIDED]
    ranges = [layout.automaton.ranges(i, modes) for i in range(layout.n)]
    widths = np.array([own[-1][1] - own[0][0] if own else _WIDTH for own in ranges])
    return np.where(np.isfinite(widths) & (widths > 0), widths, _WIDTH)
