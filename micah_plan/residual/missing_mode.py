"""Missing modes: changepoints of the residual along the configuration, by the recursion also used for poses.

Rows sorted by configuration are segmented by the changepoint recursion. In each segment the innovation is either noise
as modelled, or noise about a line in the command (another motion: gain and drift) with its coefficients integrated out.
A gradual change is not a mode, so segments must predict held-out rows better than a smooth function of the
configuration, and better than the effects that were found.

Sources: MICAH, CHAMP recursion (`changepoints`); Bishop, Pattern Recognition and Machine Learning,
section 3.5 (evidence of a linear model).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from micah_plan.arrays import ROUND_OFF, Floats, Ints, earlier_rows, robust_std
from micah_plan.changepoints import LengthPrior, length_terms, most_probable_spans
from micah_plan.residual import messages
from micah_plan.residual.coordinate_data import CoordinateData
from micah_plan.residual.likelihood import FEWEST_ROWS, FREEDOM, independent_share, robust_log_density

# Rows that the recursion reads, evenly over the configuration.
_MOST_ROWS = 800
_FEWEST_ROWS = 40
_BUMPS = 12
# Evidence by which the pieces must be ahead [nats], how many cuts there may be, and the share of the range that a piece
# must have.
_CLEARLY = 10.0
_MOST_CUTS = 4
_NARROWEST = 0.05
_OUTLIER = 12.0
_AS_THE_MODEL, _OTHERWISE = 0, 1


@dataclass(frozen=True)
class MissingMode:
    """A range of the configuration in which the part follows commands differently.

    Attributes:
        coordinate, unit: that was measured.
        low, high: of the range [rad or m]; infinite where the recording shows no end.
        gain: share of a command that is carried out there; bias: added to each step [rad or m].
        evidence: by how much held-out rows are predicted better than by a smooth change [nats].
        modes: their names in the new automaton; empty: none were added.
    """

    coordinate: str
    unit: str
    low: float
    high: float
    gain: float
    bias: float
    evidence: float
    modes: tuple[str, ...] = ()

    def __str__(self) -> str:
        low, high = (end if np.isfinite(end) else None for end in (self.low, self.high))
        return messages.mode_of_its_own(self.coordinate, self.unit, low, high, self.gain, self.bias, self.modes)


def missing_modes(
    data: CoordinateData, innovations: Floats, spread: Floats, fold: Ints, rivals: Sequence[Floats] = ()
) -> tuple[MissingMode, ...]:
    """Ranges with different motion, where changepoints are likelier than any gradual function.

    Args:
        innovations: (S, T) of the model as it is; spread: relative std of each.
        fold: (S,) that each segment is held out with.
        rivals: (S, T) innovations of other explanations.
    """
    starts = data.counted_starts
    per = earlier_rows(spread, -1)[starts]
    place = np.concatenate([data.z[:, :1], (data.z + data.u)[:, :-1]], axis=1)[starts]
    v, e = data.u[starts], earlier_rows(innovations, -1)[starts] / per
    held = np.repeat(fold[:, None], data.z.shape[1], axis=1)[starts]
    low, high = float(place.min()), float(place.max())
    if len(e) < _FEWEST_ROWS or high - low < 1e-9:
        return ()
    smooth = _smooth(place, v, low, high) / per[:, None]
    gradual = smooth @ np.linalg.lstsq(smooth, e, rcond=1e-8)[0]
    noise = max(float(robust_std(e - gradual)), ROUND_OFF)
    # Bad rows are those far from what changes gradually, not those that the model as it is misses by much.
    e = gradual / noise + np.clip((e - gradual) / noise, -_OUTLIER, _OUTLIER)
    line = np.stack([1.0 / per, v / data.command_size / per], axis=1)
    cuts, otherwise = _pieces(place, line, e, low, high)
    if not 0 < cuts.size <= _MOST_CUTS or not any(otherwise):
        return ()
    piecewise = _by_piece(place, line, cuts, otherwise)
    others = [earlier_rows(rival, -1)[starts] / per / noise for rival in rivals]
    best = max(_log_density(residual) for residual in (e, _held_out(e, smooth, held), *others))
    residual = _held_out(e, piecewise, held)
    evidence = independent_share(_correlation(residual)) * (_log_density(residual) - best)
    if evidence < _CLEARLY:
        return ()
    edges = np.concatenate([[-np.inf], cuts, [np.inf]])
    solution = np.linalg.lstsq(piecewise, e, rcond=1e-8)[0] * noise
    modes, at = [], 0
    for k, differs in enumerate(otherwise):
        if differs:
            bias, slope = (float(value) for value in solution[at : at + 2])
            gain = 1.0 + slope / data.command_size
            at += 2
            ends = float(edges[k]), float(edges[k + 1])
            modes.append(MissingMode(data.coordinate, data.unit, *ends, gain, bias, evidence))
    return tuple(modes)


def _correlation(residual: Floats) -> float:
    """Lag-1 autocorrelation of rows (N,) in time order."""
    residual = residual - residual.mean()
    return float(residual[1:] @ residual[:-1]) / max(float(residual @ residual), 1e-300)


def _smooth(place: Floats, v: Floats, low: float, high: float) -> Floats:
    """(N, k) radial basis functions of the configuration, alone and multiplied by the command."""
    spacing = (high - low) / (_BUMPS - 1)
    at = low + spacing * np.arange(_BUMPS)
    bumps = np.exp(-0.5 * ((place[:, None] - at) / spacing) ** 2)
    return np.hstack([bumps, bumps * v[:, None] / max(float(np.std(v)), 1e-12)])


def _pieces(place: Floats, line: Floats, e: Floats, low: float, high: float) -> tuple[Floats, list[bool]]:
    """(boundaries, whether each piece differs from the model) of the most probable segmentation."""
    order = np.argsort(place, kind="stable")
    order = order[np.unique(np.linspace(0, len(order) - 1, _MOST_ROWS).astype(int))]
    evidence = np.stack(_evidence(line[order], e[order]))
    terms = length_terms(LengthPrior(0.5 * len(order), 2.0), len(order)) - np.log(len(evidence))
    spans, _ = most_probable_spans(evidence.max(axis=0) + terms)
    c = place[order]
    kept: list[tuple[float, bool]] = []
    for first, last in spans:
        end = high if last == len(c) - 1 else 0.5 * float(c[last] + c[last + 1])
        width, rows = float(c[last] - c[first]), last - first + 1
        is_short = rows < FEWEST_ROWS or width < _NARROWEST * (high - low)
        differs = int(np.argmax(evidence[:, first, last])) == _OTHERWISE
        if kept and (is_short or (not differs and not kept[-1][1])):
            kept[-1] = end, kept[-1][1]
        elif not is_short or not kept:
            kept.append((end, differs and not is_short))
    return np.array([end for end, _ in kept[:-1]]), [differs for _, differs in kept]


def _by_piece(place: Floats, line: Floats, cuts: Floats, otherwise: list[bool]) -> Floats:
    """(N, k) regressors: a constant and the command, in each piece that differs from the model."""
    number = np.searchsorted(cuts, place)
    inside = [(number == k).astype(float) for k, differs in enumerate(otherwise) if differs]
    return np.hstack([indicator[:, None] * line for indicator in inside])


def _held_out(e: Floats, design: Floats, held: Ints) -> Floats:
    """(N,) residuals of each row under a regression on the other folds."""
    residual = np.empty_like(e)
    for fold in np.unique(held):
        test = held == fold
        a, b = design[~test], e[~test]
        residual[test] = e[test] - design[test] @ np.linalg.solve(a.T @ a + 1e-3 * np.eye(a.shape[1]), a.T @ b)
    return residual


def _log_density(residual: Floats) -> float:
    """Log density [nats] of residuals under Student's t with a fitted scale: the common criterion of comparison."""
    return robust_log_density(np.zeros((len(residual), 0)), residual, FREEDOM, 0.0)


def _evidence(line: Floats, e: Floats) -> tuple[Floats, Floats]:
    """(n, n) log evidence of every segment (first, last row): noise only, and a line in the command."""
    ones, v = line.T
    rows = np.stack([ones * ones, ones * v, v * v, ones * e, v * e, e * e])
    running = np.pad(np.cumsum(rows, axis=1), ((0, 0), (1, 0)))
    n, sv, svv, se, sve, see = np.triu(running[:, None, 1:] - running[:, :-1, None])
    # Prior of both coefficients: as large as ten standard deviations of the noise.
    first, second = n + 0.01, svv + 0.01
    determinant = first * second - sv**2
    fitted = (second * se**2 - 2.0 * sv * se * sve + first * sve**2) / determinant
    noise = -0.5 * see
    return noise, noise + 0.5 * fitted - 0.5 * np.log(determinant / 1e-4)
